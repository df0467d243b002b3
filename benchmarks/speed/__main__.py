"""Time everything that has an aim, in one run: ``python -m benchmarks.speed [--json FILE]``."""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.speed import daemon, logs, page, steps
from benchmarks.speed.result import Result, table
from ekf_companion import __version__
from ekf_companion.core import kernel

PARTS = {
    "steps": steps.measure,
    "logs": logs.measure,
    "daemon": daemon.measure,
    "page": page.measure,
}
TITLES = {
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
    parts = PARTS | {"steps": partial(steps.measure, ekf2=asked.ekf2)}
    if unknown := set(asked.parts) - set(PARTS):
        parser.error(f"{', '.join(sorted(unknown))}: no such part; known are {', '.join(PARTS)}")

    where = machine()
    print(", ".join(f"{key} {value}" for key, value in where.items()))
    figures: dict[str, list[Result]] = {}
    for part in asked.parts or PARTS:
        print(f"\n{TITLES[part]}")
        figures[part] = list(parts[part]())
        for line in table(figures[part]):
            print(line, flush=True)
    if asked.json is not None:
        content = {"machine": where} | {
            part: [asdict(one) for one in results] for part, results in figures.items()
        }
        asked.json.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


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
    return not (kernel.__file__ or "").endswith(".py")


if __name__ == "__main__":
    main()
