"""Move each constant of a kernel's module by 30 % both ways: ``make sensitivity MODULE=gate``.

The last commit is checked out and built below ``build/sensitivity``; there one constant after the
other is changed, and the flights of ``make truth`` are judged: the hardest third of its cases, by
the share of the time that is ok. Each row has the seconds of lies, the share of ok and the
horizontal RMS error, with the constants as they are and with one of them smaller or larger. A
constant without effect may be superfluous; one with a large effect needs a source.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.document import table
from benchmarks.tree import build, checked_out
from benchmarks.truth.cases import CASES
from benchmarks.truth.run import Job, Outcome, run_all

CONSTANT = re.compile(r"^([A-Z][A-Z_0-9]*) = cython\.declare\(cython\.double, ([^)\n]+)\)$", re.M)
"""Its name, and its value as an expression."""
MOVES = (0.7, 1.3)
THIRD = 3
HEAD = "constant | value | lies, s | ok | horizontal, m"


class Score(NamedTuple):
    """Results of several flights."""

    lies: float
    """s."""
    ok: float
    """Share of the time."""
    rms: float
    """Of the horizontal error, m."""


def score(outcomes: Sequence[Outcome]) -> Score:
    """Return the result of flights; one that failed lies for ever."""
    verdicts = [one.verdict for one in outcomes if one.verdict is not None]
    if len(verdicts) < len(outcomes) or not verdicts:
        return Score(np.inf, 0.0, np.inf)
    errors = np.array([one.rms["pos_h"] for one in verdicts])
    return Score(
        lies=float(sum(one.lie for one in verdicts)),
        ok=float(np.mean([one.ok for one in verdicts])),
        rms=float(np.sqrt(np.nanmean(errors**2))),
    )


def constants(source: str) -> Iterator[tuple[str, str]]:
    """Yield name and value of the constants that are numbers."""
    for name, value in CONSTANT.findall(source):
        if re.search(r"[1-9]", value):  # zero and NaN stay what they are
            yield name, value


def moved(source: str, name: str, factor: float) -> str:
    """Return a module with one constant multiplied."""

    def replace(match: re.Match[str]) -> str:
        if match[1] != name:
            return match[0]
        return f"{name} = cython.declare(cython.double, {factor} * ({match[2]}))"

    return CONSTANT.sub(replace, source)


def hardest(outcomes: Sequence[Outcome]) -> list[str]:
    """Return the third of the cases that are least ok."""

    def ease(outcome: Outcome) -> float:
        return -1.0 if outcome.verdict is None else outcome.verdict.ok

    ranked = sorted(outcomes, key=ease)
    return [one.job.case for one in ranked[: max(1, len(ranked) // THIRD)]]


def program(tree: Path) -> Path:
    """Return an ``ekf-companion`` of a tree."""
    path = tree / "build" / "ekf-companion"
    path.parent.mkdir(exist_ok=True)
    python, root = shlex.quote(sys.executable), shlex.quote(str(tree))
    # Python looks first where it is started, whatever PYTHONPATH says
    words = f'cd {root} && PYTHONPATH={root} exec {python} -m ekf_companion "$@"'
    path.write_text(f"#!/bin/sh\n{words}\n")
    path.chmod(0o755)
    return path


def rows(asked: argparse.Namespace) -> Iterator[str]:
    """Yield a row for each move of a constant."""
    tree = checked_out("HEAD", "sensitivity")
    file = tree / "ekf_companion" / "core" / f"{asked.module}.py"
    source, ekf = file.read_text(encoding="utf-8"), program(tree)

    def judged(cases: Sequence[str]) -> list[Outcome]:
        jobs = [Job(c, seed, ekf=ekf) for c in cases for seed in range(asked.seeds)]
        return list(run_all(jobs, asked.jobs))

    cases = asked.only or hardest(list(run_all((Job(c, 0, ekf=ekf) for c in CASES), asked.jobs)))
    yield f"as it is | | {_cells(score(judged(cases)))}"
    try:
        for name, value in constants(source):
            for factor in MOVES:
                file.write_text(moved(source, name, factor), encoding="utf-8")
                build(tree)
                yield f"{name} | {factor:g} * {value} | {_cells(score(judged(cases)))}"
    finally:
        file.write_text(source, encoding="utf-8")
        build(tree)


def _cells(found: Score) -> str:
    return f"{found.lies:.1f} | {found.ok:.1%} | {found.rms:.3f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="benchmarks.sensitivity", description=__doc__)
    parser.add_argument("module", help="of ekf_companion/core, as gate")
    parser.add_argument("--seeds", type=int, default=1, help="flights of each case")
    parser.add_argument("--only", nargs="+", choices=CASES, help="cases instead of the hardest")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    for line in table(HEAD, rows(parser.parse_args())):
        print(line, flush=True)


if __name__ == "__main__":
    main()
