"""Others on the link who send the autopilot a position, attitude or velocity from outside as well.

The autopilot fuses whatever comes: two sources by turns, each in a frame of its own. Flown so, an
ArduCopter was 2.8 m off and changed between its filters. So one of two must not send. On the ground
we do not. In flight we go on where the autopilot already flies by ours: silence would leave it with
the other alone, in a frame that it has not followed so far, and anybody can send such a message.
Then our counter becomes the other's, so that the autopilot stays with ours (:mod:`.reset_counter`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.event import Advised, Emit, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.reset_counter import ResetCounter
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

POSES = frozenset(
    IDS[name]
    for name in (
        "ODOMETRY",
        "VISION_POSITION_ESTIMATE",
        "GLOBAL_VISION_POSITION_ESTIMATE",
        "VISION_SPEED_ESTIMATE",
        "VISION_POSITION_DELTA",
        "VICON_POSITION_ESTIMATE",
        "ATT_POS_MOCAP",
        "GLOBAL_POSITION_SENSOR",
    )
)
"""Messages that an autopilot may fuse beside our ODOMETRY, by their ids."""
_COUNTED = frozenset(
    IDS[name]
    for name in (
        "ODOMETRY",
        "VISION_POSITION_ESTIMATE",
        "GLOBAL_VISION_POSITION_ESTIMATE",
        "VICON_POSITION_ESTIMATE",
        "ATT_POS_MOCAP",
    )
)
"""Those that go with ours to the same place; without a reset counter they count as with 0."""
_FEW = 3
_SOON_NS = 2 * SECOND_NS
"""So many within that time prove a sender that stays."""
_GONE_NS = 3 * SECOND_NS // 2
"""Without one for so long it has gone; on the ground we wait longer, see ``patience_ns``."""
_KEPT = 16
"""Senders told apart, at most: anybody may invent more."""


class SecondSource(Service):
    """Notices another source of poses, and withholds ours beside it."""

    def __init__(
        self,
        emit: Emit,
        guard: Guard,
        is_flying: Callable[[], bool] = lambda: False,
        is_read: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin with nobody.

        Args:
            emit: Where events go.
            guard: Whether the autopilot fuses poses.
            is_flying: Returns whether the vehicle is in the air.
            is_read: Returns whether poses of others are an aid of our estimate.
        """
        self._emit, self._guard, self._is_flying = emit, guard, is_flying
        self._is_read = is_read
        self.patience_ns = 10 * SECOND_NS
        """On the ground, without a message of the other for so long, we send again. No two
        companions may have the same, or both would begin at once, and hear each other."""
        self.begin(PeerFound(0, 0, guard.family))

    def begin(self, peer: PeerFound) -> None:
        """Listen anew."""
        self.hold: Hold | None = None
        self.counter = ResetCounter()
        """The reset counter of what is sent."""
        self._heard: dict[tuple[int, int, int], deque[int]] = {}
        """When the last came, by system, component and message id."""
        self._other: tuple[int, int, int] | None = None
        self._is_told = False

    def end(self) -> None:
        """Forget them: nobody listens."""
        self.begin(PeerFound(0, 0, self._guard.family))

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Note a frame that is neither ours nor the autopilot's."""
        if frame.message_id not in POSES:
            return
        if frame.message_id in _COUNTED:
            self.counter.on_other(getattr(unpack(frame), "reset_counter", 0), now_ns)
        sender = frame.system_id, frame.component_id, frame.message_id
        if sender in self._heard or len(self._heard) < _KEPT:
            self._heard.setdefault(sender, deque(maxlen=_KEPT)).append(now_ns)

    def tick(self, now_ns: int) -> None:
        """Hold while another is there, and go on when it has gone."""
        span_ns = _GONE_NS if self._is_flying() or self.hold is None else self.patience_ns
        for sender in [one for one in self._heard if now_ns - self._heard[one][-1] > span_ns]:
            del self._heard[sender]
        if not self._heard:
            self.counter.forget_other()
        there = [one for one, times in self._heard.items() if _is_steady(times)]
        self._other = self._other if self._other in there else min(there, default=None)
        if self._other is None or not self._guard.decision.is_fused:
            self.hold, self._is_told = None, False
            return
        if self.hold is not None or not self._guard.decision.is_streaming:
            return
        options = self._guard.options
        goes_on = self._is_flying() and not options.withhold_in_flight
        if options.second_source == "withhold" and not goes_on:
            self.hold = self._hold(self._other)
        elif not self._is_told:
            self._is_told = True
            system_id, component_id, _ = self._other
            self._emit(
                Advised(
                    f"{self.words}, which the autopilot may fuse by turns with our ODOMETRY, which "
                    "goes on; stop one of the two",
                    f"{system_id}/{component_id} sends poses too",
                )
            )

    def _hold(self, other: tuple[int, int, int]) -> Hold:
        system_id, component_id, _ = other
        remedy = "stop one of the two"
        if self._is_read():
            remedy = "let it reach the companion alone, by a link of its own"
        return Hold(
            reason=f"{self.words}, and the autopilot would fuse both by turns",
            remedy=f"{remedy}, or set output.odometry.second_source to send",
            text=f"{system_id}/{component_id} sends poses too",
        )

    @property
    def words(self) -> str:
        """Who sends what how often, as ``system 1, component 197 sends ...``; empty: nobody."""
        if self._other is None:
            return ""
        system_id, component_id, number = self._other
        rate = _rate(self._heard[self._other])
        name = LAYOUTS[number].name
        words = f"system {system_id}, component {component_id} sends {name} at {rate:.0f} Hz"
        return f"{words}, an aid of ours" if self._is_read() else words


def _is_steady(times: deque[int]) -> bool:
    return len(times) >= _FEW and times[-1] - times[-_FEW] <= _SOON_NS


def _rate(times: deque[int]) -> float:
    span = (times[-1] - times[0]) * 1e-9
    return (len(times) - 1) / span if span > 0.0 else 0.0
