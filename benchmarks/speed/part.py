"""One part of the measurements: ``python -m benchmarks.speed.part PART FILE [EKF2]``.

It prints its figures and writes them to the file, as JSON.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from benchmarks.speed import daemon, logs, page, steps
from benchmarks.speed.result import Result, table

PARTS: dict[str, Callable[[], Iterator[Result]]] = {
    "steps": steps.measure,
    "logs": logs.measure,
    "daemon": daemon.measure,
    "page": page.measure,
}


def main(name: str, file: str, ekf2: str = "") -> None:
    """Measure a part; ``ekf2`` is the program beside which the filter's step is timed."""
    is_beside = name == "steps" and ekf2
    results = list(steps.measure(ekf2=Path(ekf2)) if is_beside else PARTS[name]())
    for line in table(results):
        print(line, flush=True)
    Path(file).write_text(json.dumps([asdict(one) for one in results]), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
