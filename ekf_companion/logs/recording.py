"""What every log format gives: events in the order of arrival, and what to compare with."""

from __future__ import annotations

from dataclasses import dataclass, field

from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import Trajectory


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
    """The simulator's truth, where the log holds one."""
    gnss_delay: float | None = None
    """Delay of the receiver that the log itself declares (a parameter of the autopilot), s."""
    notes: tuple[str, ...] = field(default=())
    """What the reader saw and the user should know, one sentence each."""
