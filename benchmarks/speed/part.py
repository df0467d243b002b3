"""One part of the measurements: ``python -m benchmarks.speed.part PART FILE [EKF2]``.

It prints its figures and writes them to the file, as JSON.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from benchmarks.speed.result import table


def main(name: str, file: str, ekf2: str = "") -> None:
    """Measure the part of the module of that name; ``ekf2`` is an option of the filter's step."""
    options = {"ekf2": Path(ekf2)} if ekf2 else {}
    results = list(import_module(f"benchmarks.speed.{name}").measure(**options))
    for line in table(results):
        print(line, flush=True)
    Path(file).write_text(json.dumps([asdict(one) for one in results]), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
