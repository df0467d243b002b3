"""The results as lines for a terminal: a line for each stage, then what to do."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from ekf_companion.doctor.diagnosis import first_failure
from ekf_companion.doctor.stage import NOT_REACHED, Outcome, Problem, Stage, StageResult

LABELS = {
    Outcome.OK: "ok",
    Outcome.WARNING: "warning",
    Outcome.FAILED: "FAILED",
    Outcome.UNKNOWN: "-",
}
"""Printed at the beginning of each line."""
_INDENT = 20
Line = tuple[Outcome, str]
"""A line, and the outcome that decides its colour."""


def lines(results: Sequence[StageResult], width: int = 100) -> list[Line]:
    """Return a line for each stage reached, the remedy of the first that fails, and warnings."""
    out: list[Line] = []
    hidden = [result.stage.value for result in results if result.saw == NOT_REACHED]
    for result in results:
        if result.saw == NOT_REACHED:
            continue
        head = f"{LABELS[result.outcome]:<9}{result.stage.value:<{_INDENT - 9}}"
        out += [(result.outcome, line) for line in _wrapped(head + result.saw, width, _INDENT)]
    if hidden:
        head = f"{LABELS[Outcome.UNKNOWN]:<9}{NOT_REACHED}: {', '.join(hidden)}"
        out += [(Outcome.UNKNOWN, line) for line in _wrapped(head, width, _INDENT)]
    failure = first_failure(results)
    if failure is not None:
        out += _paragraph(failure, failure.problems[0], width)
    for result in results:
        # What the estimate lacks follows from the stage that failed before it
        if failure is not None and result.stage is Stage.ESTIMATE:
            continue
        for problem in result.problems:
            if problem.outcome is Outcome.WARNING:
                out += _paragraph(result, problem, width)
    if not any(result.problems for result in results):
        well = "Nothing is wrong at any stage that can be seen here."
        out += [(Outcome.OK, ""), (Outcome.OK, well)]
    return out


def _paragraph(result: StageResult, problem: Problem, width: int) -> list[Line]:
    head = f"{result.stage.value}: {problem.cause}"
    return [
        (Outcome.UNKNOWN, ""),
        *((problem.outcome, line) for line in _wrapped(head, width, 4)),
        *((Outcome.UNKNOWN, line) for line in _wrapped(f"  -> {problem.remedy}", width, 5)),
    ]


def _wrapped(text: str, width: int, indent: int) -> list[str]:
    return textwrap.wrap(
        text, width, subsequent_indent=" " * indent, break_on_hyphens=False, break_long_words=False
    )
