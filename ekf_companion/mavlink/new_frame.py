"""A frame that began in the air: held back from an autopilot that follows the one before.

ODOMETRY counts from an origin, and its receiver takes a jump of it for motion: a vehicle that held
its height at 12 m climbed 12 m when the next run counted from there. Where the frame of the run
before is lost, as with a damaged checkpoint, nothing is sent until the vehicle has landed. That the
autopilot has told an origin of its own is not enough: an estimate that begins in the air is metres
off at first, and so would be what its heights are compared by.
"""

from __future__ import annotations

from collections.abc import Callable

from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_LISTEN_NS = SECOND_NS * 3 // 2
"""A heartbeat comes once a second, and tells whether the vehicle is armed."""
_LISTENING = Hold(reason="it is not known yet whether the vehicle is in the air")
_LOST = Hold(
    reason="the estimate began anew in the air, its origin of before is lost, and the autopilot "
    "still counts from that",
    remedy="land: on the ground it begins with a new origin",
    text="began anew in the air",
)


class NewFrame(Service):
    """Holds ODOMETRY back after a start in the air whose frame is not the one before."""

    def __init__(self, guard: Guard, is_flying: Callable[[], bool] = lambda: False) -> None:
        """``is_flying`` returns whether the vehicle is in the air."""
        self._guard, self._is_flying = guard, is_flying
        self._is_new = False
        self._since_ns: int | None = None

    def begin_anew(self) -> None:
        """Learn that the origin of the run before is lost."""
        self._is_new, self._since_ns, self.hold = True, None, _LISTENING

    def tick(self, now_ns: int) -> None:
        """Hold ODOMETRY back while the vehicle is in the air and its autopilot follows it."""
        if not self._is_new:
            return
        if self._since_ns is None:
            self._since_ns = now_ns
        decision = self._guard.decision
        if self._is_flying():
            is_followed = decision.is_fused or not decision.is_settled
            self.hold = _LOST if is_followed else None
        elif now_ns - self._since_ns > _LISTEN_NS:
            self._is_new, self.hold = False, None
