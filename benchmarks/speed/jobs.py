"""Work in processes of its own, so that time and peak memory are those of the work alone."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median


@dataclass(frozen=True, slots=True)
class Cost:
    """The cost of one job."""

    seconds: float
    """By the clock."""
    cpu: float
    """Of all processors, s."""
    peak: float
    """Largest resident memory, MB."""


def run(arguments: Sequence[str]) -> Cost:
    """Run a command and return its cost.

    Raises:
        RuntimeError: It failed.
    """
    began = time.perf_counter()
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        said = process.stderr.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    spent = time.perf_counter() - began
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {said.decode(errors='replace')[-500:]}")
    return Cost(spent, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0)


def interleaved(
    jobs: Mapping[str, Sequence[str]], rounds: int, outs: Collection[Path] = ()
) -> dict[str, Cost]:
    """Run all jobs in turn, several times; return the median cost of each.

    ``outs`` are the files that they write: to delete those of the round before is no part of the
    work.
    """
    costs: dict[str, list[Cost]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, arguments in jobs.items():
            for out in outs:
                out.unlink(missing_ok=True)
            costs[name].append(run(arguments))
    return {
        name: Cost(*(median(getattr(one, field) for one in found) for field in Cost.__slots__))
        for name, found in costs.items()
    }


def python(code: str, *arguments: str) -> list[str]:
    """Return the command that runs code in this interpreter."""
    return [sys.executable, "-c", code, *arguments]
