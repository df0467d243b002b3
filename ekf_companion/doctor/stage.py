"""The result of each stage, and the problems found at it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Stage(str, Enum):
    """The stages that data pass, in order."""

    LINK = "link"
    BYTES = "bytes"
    FRAMES = "frames"
    CHECKSUMS = "checksums"
    SOURCE = "source"
    MESSAGES = "messages"
    RATES = "rates"
    TIME = "time"
    VALUES = "values"
    ESTIMATE = "estimate"
    SENT = "sent"
    FUSED = "fused"


NOT_REACHED = "not reached"
"""What was seen at a stage that a failed one hides."""


class Outcome(str, Enum):
    """How well a stage works."""

    OK = "ok"
    WARNING = "warning"
    """Data pass, but fewer or worse than possible."""
    FAILED = "failed"
    """No data pass."""
    UNKNOWN = "unknown"
    """Not reached, or not visible from here."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong at a stage."""

    outcome: Outcome
    """WARNING or FAILED."""
    cause: str
    """The likely cause, a sentence."""
    remedy: str
    """What to set or to do, a sentence with the parameter's name and value."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """One stage, and what is wrong there."""

    stage: Stage
    outcome: Outcome
    saw: str
    """The numbers seen, in a line."""
    problems: tuple[Problem, ...] = ()
    """The worst first."""

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, for JSON."""
        return {
            "stage": self.stage.value,
            "verdict": self.outcome.value,
            "saw": self.saw,
            "troubles": [
                {"verdict": problem.outcome.value, "cause": problem.cause, "remedy": problem.remedy}
                for problem in self.problems
            ],
        }


def failed(cause: str, remedy: str) -> Problem:
    """Return a problem that lets no data pass."""
    return Problem(Outcome.FAILED, cause, remedy)


def warning(cause: str, remedy: str) -> Problem:
    """Return a problem that makes the data fewer or worse."""
    return Problem(Outcome.WARNING, cause, remedy)


def judged(stage: Stage, saw: str, problems: Iterable[Problem | None] = ()) -> StageResult:
    """Return the result of a stage, which is as bad as its worst problem; None is no problem."""
    found = [problem for problem in problems if problem is not None]
    found.sort(key=lambda problem: problem.outcome is not Outcome.FAILED)
    return StageResult(stage, found[0].outcome if found else Outcome.OK, saw, tuple(found))


def unknown(stage: Stage, why: str) -> StageResult:
    """Return the result of a stage that cannot be judged."""
    return StageResult(stage, Outcome.UNKNOWN, why)
