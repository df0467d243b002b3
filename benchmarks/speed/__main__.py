"""Time everything that has an aim, in one run: ``python -m benchmarks.speed [--json FILE]``."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np

from ekf_companion import __version__
from ekf_companion.core.order import step

PARTS = {  # by the module that measures each
    "steps": "The filter's step (one thread, this machine)",
    "logs": "Recorded flights",
    "daemon": "The daemon over loopback UDP",
    "page": "The daemon's page, with inertial samples at 250 Hz",
}


def main() -> None:
    """Run the parts that were asked for, and print each as it ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)}; all by default"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument(
        "--ekf2", type=Path, metavar="PROGRAM", help="runs EKF2 over a .csv: benchmarks/speed/steps"
    )
    asked = parser.parse_args()
    chosen = asked.parts or list(PARTS)
    if unknown := set(chosen) - set(PARTS):
        parser.error(f"{', '.join(sorted(unknown))}: no such part; known are {', '.join(PARTS)}")

    where = machine()
    print(", ".join(f"{key} {value}" for key, value in where.items()), flush=True)
    content: dict[str, Any] = {"machine": where}
    for part in chosen:
        print(f"\n{PARTS[part]}", flush=True)
        content[part] = _measure(part, asked.ekf2)
    if asked.json is not None:
        asked.json.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def _measure(part: str, ekf2: Path | None) -> list[dict[str, Any]]:
    """Measure a part in a process of its own, which prints the figures; return them.

    A process that is started begins with the peak memory of the one that starts it.
    """
    with NamedTemporaryFile(suffix=".json") as file:
        options = [part, file.name]
        if part == "steps" and ekf2 is not None:
            options.append(str(ekf2))
        subprocess.run([sys.executable, "-m", "benchmarks.speed.part", *options], check=True)
        figures: list[dict[str, Any]] = json.loads(Path(file.name).read_bytes())
        return figures


def machine() -> dict[str, str]:
    """Return what it runs on, and how busy that is."""
    models = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if line.startswith(("model name", "Model"))
    ]
    return {
        "ekf-companion": __version__,
        "kernel": "compiled" if is_compiled() else "NOT COMPILED",
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "processor": models[0] if models else platform.machine(),
        "cores": str(os.cpu_count()),
        "load": f"{os.getloadavg()[0]:.2f}",
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
    }


def is_compiled() -> bool:
    """Return whether the step is machine code, not Python that nobody has compiled."""
    return not (step.__file__ or "").endswith(".py")


if __name__ == "__main__":
    main()
