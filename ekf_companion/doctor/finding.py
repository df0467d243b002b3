"""What the doctor says of a stage."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Any


class Stage(str, Enum):
    """The stages of the way, in order; each names what it asks for."""

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


class Mark(str, Enum):
    """How a stage does."""

    OK = "ok"
    WARNING = "warning"
    """Data passes, but fewer or worse than could be."""
    FAILED = "failed"
    """The data end here."""
    UNKNOWN = "unknown"
    """Not reached, or not to be seen from here."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """One thing that is wrong at a stage."""

    mark: Mark
    """WARNING or FAILED."""
    cause: str
    """What is likely behind it, a sentence."""
    remedy: str
    """What to set or to do, a sentence with the parameter's name and value."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One stage."""

    stage: Stage
    mark: Mark
    saw: str
    """Numbers, in a line."""
    troubles: tuple[Trouble, ...] = ()
    """The worst first."""

    def to_dict(self) -> dict[str, Any]:
        """Give it as plain data, for JSON."""
        return {
            "stage": self.stage.value,
            "verdict": self.mark.value,
            "saw": self.saw,
            "troubles": [
                {"verdict": t.mark.value, "cause": t.cause, "remedy": t.remedy}
                for t in self.troubles
            ],
        }


def failed(cause: str, remedy: str) -> Trouble:
    """Give what ends the way of the data."""
    return Trouble(Mark.FAILED, cause, remedy)


def warning(cause: str, remedy: str) -> Trouble:
    """Give what makes the data fewer or worse."""
    return Trouble(Mark.WARNING, cause, remedy)


def found(stage: Stage, saw: str, troubles: Iterable[Trouble | None] = ()) -> Finding:
    """Give a stage's finding: as bad as the worst of its troubles."""
    real = [trouble for trouble in troubles if trouble is not None]
    real.sort(key=lambda trouble: trouble.mark is not Mark.FAILED)
    return Finding(stage, real[0].mark if real else Mark.OK, saw, tuple(real))


def unknown(stage: Stage, why: str) -> Finding:
    """Give a stage of which nothing can be said."""
    return Finding(stage, Mark.UNKNOWN, why)
