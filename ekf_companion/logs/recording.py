"""What every log format gives: events in the order of arrival, and what to compare with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Trajectory


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Counted:
    """Which part of a recording its authors let count in errors."""

    t_ns: npt.NDArray[np.int64]
    """Ascending, shape (n,)."""
    is_counted: npt.NDArray[np.bool_]
    """From each stamp on until the next, shape (n,)."""

    def at(self, t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Give whether each of some times counts; none before the first stamp does."""
        last = np.searchsorted(self.t_ns, t_ns, side="right") - 1
        return np.asarray((last >= 0) & self.is_counted[np.maximum(last, 0)])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Recording:
    """A log, read."""

    family: str
    """``px4``, ``ardupilot`` or ``unknown``: which autopilot's delays and habits apply."""
    events: Events
    """Everything that the estimator takes, in the order of arrival, stamps as the log has them."""
    reference: Trajectory | None = None
    """The autopilot's own estimate."""
    truth: Trajectory | None = None
    """Of a simulator or an optical system, where the log holds one."""
    counted: Counted | None = None
    """Which times count in errors; None: all."""
    gnss_delay: float | None = None
    """Delay of the receiver that the log itself declares (a parameter of the autopilot), s."""
    notes: tuple[str, ...] = field(default=())
    """What the reader saw and the user should know, one sentence each."""


def one_course(events: Events) -> tuple[Events, tuple[str, ...]]:
    """Give the longest part of events within which the autopilot's clock goes on, and a note."""
    restarts = np.flatnonzero(events.kind == Kind.RESTART)
    if not len(restarts):
        return events, ()
    longest = events.take(max(np.split(np.arange(len(events)), restarts), key=len))
    return longest.take(longest.kind != Kind.RESTART), (
        "the autopilot's clock begins anew in this log; the longest part counts",
    )
