"""The findings as lines for a terminal: a mark a stage, then what to do."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from ekf_companion.doctor.diagnosis import first_failure
from ekf_companion.doctor.finding import Finding, Mark, Stage, Trouble

MARKS = {Mark.OK: "ok", Mark.WARNING: "warning", Mark.FAILED: "FAILED", Mark.UNKNOWN: "-"}
"""At the beginning of each line."""
_INDENT = 20
Line = tuple[Mark, str]
"""A line, and the mark whose colour it has."""


def lines(findings: Sequence[Finding], width: int = 100) -> list[Line]:
    """Give one line a stage, the remedy of the first that fails, and the warnings."""
    out: list[Line] = []
    for finding in findings:
        head = f"{MARKS[finding.mark]:<9}{finding.stage.value:<{_INDENT - 9}}"
        out += [(finding.mark, line) for line in _wrapped(head + finding.saw, width, _INDENT)]
    failure = first_failure(findings)
    if failure is not None:
        out += _paragraph(failure, failure.troubles[0], width)
    for finding in findings:
        # What the estimate lacks follows from the stage that failed before it
        if failure is not None and finding.stage is Stage.ESTIMATE:
            continue
        for trouble in finding.troubles:
            if trouble.mark is Mark.WARNING:
                out += _paragraph(finding, trouble, width)
    if not any(finding.troubles for finding in findings):
        out += [(Mark.OK, ""), (Mark.OK, "Nothing is wrong at any stage that can be seen here.")]
    return out


def _paragraph(finding: Finding, trouble: Trouble, width: int) -> list[Line]:
    head = f"{finding.stage.value}: {trouble.cause}"
    return [
        (Mark.UNKNOWN, ""),
        *((trouble.mark, line) for line in _wrapped(head, width, 4)),
        *((Mark.UNKNOWN, line) for line in _wrapped(f"  -> {trouble.remedy}", width, 5)),
    ]


def _wrapped(text: str, width: int, indent: int) -> list[str]:
    return textwrap.wrap(
        text, width, subsequent_indent=" " * indent, break_on_hyphens=False, break_long_words=False
    )
