"""Judge the estimator by flights whose truth comes from elsewhere: ``make truth``.

Prints a row per case; ends with exit code 1 if an estimate that was "ok" was wrong beyond its own
sigma, or a log could not be converted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from benchmarks.document import insert, table
from benchmarks.truth.cases import CASES
from benchmarks.truth.judge import SIGMAS, Verdict
from benchmarks.truth.run import Outcome, jobs_of, run_all

MARK = "independent truth"
HEAD = (
    "case | horizontal, m | vertical, m | velocity, m/s | tilt, deg | yaw, deg"
    " | largest error / sigma | NEES position | velocity | resets | ok | lies, s | flights that lie"
)
UNITS = {"pos_h": 1.0, "pos_d": 1.0, "vel": 1.0, "tilt": 180.0 / np.pi, "yaw": 180.0 / np.pi}


def row(name: str, outcomes: Sequence[Outcome]) -> str:
    """Return the row of one case: medians over its flights, with the worst in brackets."""
    verdicts = [outcome.verdict for outcome in outcomes if outcome.verdict is not None]
    if len(verdicts) < len(outcomes):
        failure = next(outcome.failure for outcome in outcomes if outcome.verdict is None)
        return f"{name} | fails in {len(outcomes) - len(verdicts)} of {len(outcomes)}: {failure}"
    cells = [name]
    for quantity, unit in UNITS.items():
        cells.append(_median_and_worst([v.rms[quantity] * unit for v in verdicts], 2))
    ratios = [(v.worst[q], q) for v in verdicts for q in UNITS if not np.isnan(v.worst[q])]
    cells.append("{:.1f} {}".format(*max(ratios)) if ratios else "-")
    cells.append(_median_and_worst([v.nees_pos for v in verdicts], 2))
    cells.append(_median_and_worst([v.nees_vel for v in verdicts], 2))
    cells.append(_median_and_worst([v.resets for v in verdicts], 0))
    cells.append(f"{np.mean([v.ok for v in verdicts]):.0%}")
    cells.append(_lies(verdicts))
    cells.append(f"{sum(v.lie > 0.0 for v in verdicts)} of {len(verdicts)}")
    return " | ".join(cells)


def _median_and_worst(values: Sequence[float], digits: int) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return "-"
    return f"{np.median(known):.{digits}f} ({max(known):.{digits}f})"


def _lies(verdicts: Sequence[Verdict]) -> str:
    """Return all seconds of lies, then those of each quantity that has any."""
    parts = {q: sum(v.lies[q] for v in verdicts) for q in UNITS}
    told = ", ".join(f"{q} {s:.1f}" for q, s in parts.items() if s > 0.0)
    return f"{sum(v.lie for v in verdicts):.1f}" + (f" ({told})" if told else "")


def rows(outcomes: Iterator[Outcome], found: list[Outcome], is_each: bool) -> Iterator[str]:
    """Yield the row of each case as it is done; collect the outcomes."""
    for name, group in groupby(outcomes, lambda outcome: outcome.job.case):
        part = list(group)
        found += part
        if is_each:
            yield from (row(outcome.job.name, [outcome]) for outcome in part)
        yield row(name, part)


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(prog="benchmarks.truth", description=__doc__)
    add = parser.add_argument
    add("--seeds", type=int, default=20, help="flights of each case")
    add("--first", type=int, default=0, metavar="SEED", help="the first one's seed")
    add("--only", nargs="+", metavar="NAME", choices=CASES, default=list(CASES))
    add("--jobs", type=int, default=2, help="processes")
    add("--ekf", type=Path, help="judge another build: its ekf-companion program")
    add("--logs", type=Path, help="folder that keeps the logs and their truth for the next run")
    add("--keep", type=Path, help="folder that keeps the estimates")
    add("--each", action="store_true", help="a row for each flight, too")
    add("--list", action="store_true", help="print the cases and end")
    add("--write", type=Path, metavar="FILE", help=f"a document with the mark <!-- {MARK} -->")
    asked = parser.parse_args()
    if asked.list:
        for name, function in CASES.items():
            print(f"{name:28s} {function.__doc__}")
        return 0
    for folder in (asked.logs, asked.keep):
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
    seeds = range(asked.first, asked.first + asked.seeds)
    jobs = jobs_of(asked.only, seeds, asked.logs, asked.keep, asked.ekf)
    found: list[Outcome] = []
    lines = []
    for line in table(HEAD, rows(run_all(jobs, asked.jobs), found, asked.each)):
        print(line, flush=True)
        lines.append(line)
    if asked.write is not None:
        text = asked.write.read_text(encoding="utf-8")
        asked.write.write_text(insert(text, MARK, "\n".join(lines)), encoding="utf-8")
    is_honest = all(one.verdict is not None and one.verdict.lie == 0.0 for one in found)
    print(f"{len(found)} flights; a lie: ok, and beyond {SIGMAS:.0f} sigma", file=sys.stderr)
    return 0 if is_honest else 1


if __name__ == "__main__":
    sys.exit(main())
