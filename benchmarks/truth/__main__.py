"""Judge the estimator by flights whose truth comes from elsewhere: ``make truth``.

Prints a row per case; ends with exit code 1 if an estimate that was "ok" was wrong beyond its own
sigma, or a log could not be converted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby, product
from pathlib import Path

import numpy as np

from benchmarks.document import table, write
from benchmarks.truth.cases import CASES, USUAL
from benchmarks.truth.cases.sources import KINDS
from benchmarks.truth.run import Job, Outcome, run_all

MARKS = {"independent truth": False, "independent sources": True}
"""Of the tables, and whether they are of sources beside the usual sensors."""
HEAD = (
    "case | horizontal, m | vertical, m | velocity, m/s | tilt, deg | yaw, deg"
    " | largest error / sigma | NEES position | velocity | resets | ok | flights that lie | lies, s"
)
BEFORE = " | before: flights that lie | lies, s"
UNITS = {"pos_h": 1.0, "pos_d": 1.0, "vel": 1.0, "tilt": 180.0 / np.pi, "yaw": 180.0 / np.pi}
"""The units of the table, per quantity of a verdict."""


def row(outcomes: Sequence[Outcome]) -> str:
    """Return the cells of one case: medians over its flights, with the worst in brackets."""
    verdicts = [outcome.verdict for outcome in outcomes if outcome.verdict is not None]
    if len(verdicts) < len(outcomes):
        failure = next(outcome.failure for outcome in outcomes if outcome.verdict is None)
        return f"fails in {len(outcomes) - len(verdicts)} of {len(outcomes)}: {failure}" + " | " * 9
    cells = []
    for quantity, unit in UNITS.items():
        cells.append(_median_and_worst([v.rms[quantity] * unit for v in verdicts], 2))
    ratios = [(v.worst[q], q) for v in verdicts for q in UNITS if not np.isnan(v.worst[q])]
    cells.append("{:.1f} {}".format(*max(ratios)) if ratios else "-")
    cells.append(_median_and_worst([v.nees_pos for v in verdicts], 2))
    cells.append(_median_and_worst([v.nees_vel for v in verdicts], 2))
    cells.append(_median_and_worst([v.resets for v in verdicts], 0))
    cells.append(f"{np.mean([v.ok for v in verdicts]):.0%}")
    return " | ".join(cells)


def _median_and_worst(values: Sequence[float], digits: int) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return "-"
    return f"{np.median(known):.{digits}f} ({max(known):.{digits}f})"


def lies(outcomes: Sequence[Outcome]) -> str:
    """Return how many flights lie, and the seconds of lies of each quantity that has any."""
    verdicts = [outcome.verdict for outcome in outcomes if outcome.verdict is not None]
    parts = {quantity: sum(v.lies[quantity] for v in verdicts) for quantity in UNITS}
    each = ", ".join(f"{quantity} {s:.1f}" for quantity, s in parts.items() if s > 0.0)
    count = f"{sum(v.lie > 0.0 for v in verdicts)} of {len(outcomes)}"
    return f"{count} | {sum(v.lie for v in verdicts):.1f}" + (f" ({each})" if each else "")


def rows(outcomes: Iterable[Outcome], asked: argparse.Namespace) -> Iterator[str]:
    """Yield the row of each case as soon as it is done."""
    for name, group in groupby(outcomes, lambda outcome: outcome.job.case):
        by_build: dict[Path | None, list[Outcome]] = {asked.ekf: [], asked.before: []}
        for outcome in group:
            by_build[outcome.job.ekf].append(outcome)
        new = by_build[asked.ekf]
        if asked.each:
            yield from (f"{one.job.name} | {row([one])} | {lies([one])}" for one in new)
        before = f" | {lies(by_build[asked.before])}" if asked.before else ""
        yield f"{name} | {row(new)} | {lies(new)}{before}"


def is_of_source(line: str) -> bool:
    """Return whether a row is of a source beside the usual sensors."""
    return line.removeprefix("| ").split(" ")[0].split("-")[0] in KINDS


def options() -> argparse.Namespace:
    """Return what is asked for on the command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.truth", description=__doc__)
    add = parser.add_argument
    add("--seeds", type=int, default=20, help="flights of each case")
    add("--first", type=int, default=0, metavar="SEED", help="the first one's seed")
    add("--only", nargs="+", metavar="NAME", choices=CASES, default=USUAL)
    add("--all", action="store_const", dest="only", const=list(CASES), help="outages, too")
    add("--list", action="store_true", help="print the cases and end")
    add("--each", action="store_true", help="a row for each flight, too")
    add("--jobs", type=int, default=2, help="processes")
    add("--ekf", type=Path, help="judge another build: its ekf-companion program")
    add("--before", type=Path, metavar="EKF", help="another build to compare the lies with")
    add("--logs", type=Path, help="folder that keeps the logs and their truth for the next run")
    add("--keep", type=Path, help="folder that keeps the estimates")
    marks = " and ".join(f"<!-- {mark} -->" for mark in MARKS)
    add("--write", type=Path, metavar="FILE", help=f"a document with the marks {marks}")
    return parser.parse_args()


def jobs_of(asked: argparse.Namespace) -> Iterator[Job]:
    """Yield the jobs of each case and seed: one, or one for each build."""
    for name, seed in product(asked.only, range(asked.first, asked.first + asked.seeds)):
        job = Job(name, seed, asked.logs, asked.keep, asked.ekf)
        yield job
        if asked.before is not None:
            yield replace(job, keep=None, ekf=asked.before)


def main() -> int:
    """Run what is asked for."""
    asked = options()
    if asked.list:
        for name, function in CASES.items():
            print(f"{name:30s} {function.__doc__}")
        return 0
    for folder in (asked.logs, asked.keep):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    found: list[Outcome] = []
    lines: list[str] = []
    head = HEAD + (BEFORE if asked.before else "")
    for line in table(head, rows(_collected(run_all(jobs_of(asked), asked.jobs), found), asked)):
        print(line, flush=True)
        lines.append(line)
    if asked.write is not None:
        head, rule, *found_rows = lines
        for mark, is_of_sources in MARKS.items():
            kept = [one for one in found_rows if is_of_source(one) == is_of_sources]
            if kept:
                write(asked.write, mark, "\n".join([head, rule, *kept]))
    return 0 if all(one.is_honest for one in found if one.job.ekf == asked.ekf) else 1


def _collected(outcomes: Iterable[Outcome], found: list[Outcome]) -> Iterator[Outcome]:
    for outcome in outcomes:
        found.append(outcome)
        yield outcome


if __name__ == "__main__":
    sys.exit(main())
