"""The reset counter that is sent beside a second source of poses: the same as that one's.

An autopilot keeps one counter for all poses from outside, and takes the position of a message that
moves it. Two sources with counters of their own throw it from one to the other with every message:
an ArduCopter's estimate went 2.8 m to and fro, and the vehicle followed by 3 m. With one counter
its gates decide, and they refuse the source that is not where the autopilot is.

So ours becomes the other's, at a moment when the autopilot is at ours: where two messages of ours
follow each other without one of the other's between them, of which the first had still moved the
counter. A source that is as fast as ours leaves no such moment.

Sources: ArduPilot, ``AP_VisualOdom_Backend::get_reset_timestamp_ms``,
``NavEKF3_core::SelectVelPosFusion``; PX4, ``ev_pos_control.cpp``.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise

from ekf_companion.mavlink.stamp import SECOND_NS

_KEPT = 4
"""Of the other's messages; the shortest of the intervals between them counts, less their spread."""
_AGAIN_NS = 3 * SECOND_NS
"""Whoever follows the other one is told by the autopilot's position; that takes one or two."""


class ResetCounter:
    """Decides which counter goes with each pose."""

    def __init__(self) -> None:
        """Begin with nothing sent and nobody else there."""
        self.usual: int | None = None
        """What it would be without others, at the last that was sent."""
        self.sent = 0
        """What that bore."""
        self.other: int | None = None
        """The counter of the other; None: there is none."""
        self._heard: deque[int] = deque(maxlen=_KEPT)
        """When the other's last came, ns."""
        self.last_ns = 0
        """When our last was sent."""
        self._shared_ns = 0
        """When ours became the other's."""

    def on_other(self, counter: int, now_ns: int) -> None:
        """Note a pose of another source, and its counter."""
        self.other = counter
        self._heard.append(now_ns)

    def forget_other(self) -> None:
        """Go on as nobody else sends: the counter stays until the next jump."""
        self.other = None
        self._heard.clear()

    def choose(self, usual: int, now_ns: int, way_ns: int = 0, *, is_followed: bool = True) -> int:
        """Return the counter for the pose that is sent now.

        Args:
            usual: What it would be without others, 1 to 255.
            now_ns: The time of ours.
            way_ns: What the way to the autopilot and back takes.
            is_followed: Whether the autopilot is where ours says.
        """
        if usual != self.usual:
            self.usual = usual
            self._move(usual)
        elif self.other is not None and self.sent != self.other:
            if self._follows_ours(now_ns, way_ns):
                self.sent, self._shared_ns = self.other, now_ns
        elif self.other is not None and not is_followed and now_ns - self._shared_ns > _AGAIN_NS:
            self._move(usual)
        self.last_ns = now_ns
        return self.sent

    def _follows_ours(self, now_ns: int, way_ns: int) -> bool:
        """Whether what is sent now is the next at the autopilot after our last."""
        if len(self._heard) < 3:
            return False  # how fast and how even it is is not known yet
        intervals = [after - before for before, after in pairwise(self._heard)]
        next_ns = self._heard[-1] + 2 * min(intervals) - max(intervals)
        return self._heard[-1] <= self.last_ns + way_ns and now_ns + way_ns < next_ns

    def _move(self, usual: int) -> None:
        """Send another counter than before, and than the other's: the autopilot comes to ours."""
        taken = (self.sent, self.other)
        self.sent = next(
            k for k in (usual, usual % 255 + 1, (usual + 1) % 255 + 1) if k not in taken
        )
