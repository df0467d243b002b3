"""Our heartbeat, once a second, sent by the loop that runs the filter; and others under our ids."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from ekf_companion.mavlink import encode
from ekf_companion.mavlink.discovery import Presence
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import Clash, Emit
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_ECHOES = 32
"""An echo may be so many heartbeats old: no router holds one back for longer."""
APART_NS = SECOND_NS // 4
"""Between a requested one and the last: with those in turn, the echoes of 6 s are known."""
_AGAIN_NS = 30 * SECOND_NS
"""Between two warnings of a clash."""
_GONE_NS = 5 * SECOND_NS
"""Without another heartbeat of somebody else under our ids, that one has gone."""


class Heartbeat(Service):
    """Sends our identity and state."""

    def __init__(self, outbox: Outbox) -> None:
        self.status = SystemStatus.BOOT
        self.mode = 0
        """``custom_mode``: the ``nav.state.Status`` of the estimate."""
        self._outbox = outbox
        self._next_ns: int | None = None
        self._last_ns: int | None = None
        self._recent: deque[tuple[int, bytes]] = deque(maxlen=_ECHOES)

    def tick(self, now_ns: int) -> None:
        """Send one if it is due; those that a stall has missed are not made up for."""
        if self._next_ns is not None and now_ns < self._next_ns:
            return
        # From the plan, not from now, so that lateness does not add up
        is_stalled = self._next_ns is None or now_ns - self._next_ns > SECOND_NS
        self._next_ns = (now_ns if is_stalled else self._next_ns or 0) + SECOND_NS
        self.send(now_ns)

    def request(self, now_ns: int) -> bool:
        """Send one out of turn; False: one was sent a moment ago."""
        if self._last_ns is not None and now_ns - self._last_ns < APART_NS:
            return False
        self.send(now_ns)
        return True

    def send(self, now_ns: int) -> None:
        """Send a heartbeat."""
        self._last_ns = now_ns
        payload = encode.heartbeat(self.status, self.mode)
        self._recent.append((self._outbox.sequence, payload.rstrip(b"\0")))
        self._outbox.send("HEARTBEAT", payload, now_ns)

    def is_foreign(self, frame: Frame) -> bool:
        """Return whether a heartbeat under our ids is somebody else's, and no echo of our last.

        Return False where we have sent none, as in a replay.
        """
        is_echo = (frame.sequence, frame.payload.rstrip(b"\0")) in self._recent
        return bool(self._recent) and not is_echo


class ClashWatch(Service):
    """Notices foreign heartbeats under our ids, and leaves out the echo of our own.

    To the autopilot, two of us would look like one that jumps. One heartbeat that is not ours says
    nothing: it may be the last run's, still on its way. Somebody who is there sends another.

    Of two with the same ids one must send in the end. Who streams in flight goes on, for anybody
    can forge a heartbeat. Who does not waits while the ODOMETRY of the other is heard, and for
    some time; each waits for another time, so that the second hears the first.
    """

    def __init__(
        self,
        emit: Emit,
        heartbeat: Heartbeat,
        is_streaming_in_flight: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin with nobody.

        Args:
            emit: Takes the events.
            heartbeat: Ours, to tell its echo.
            is_streaming_in_flight: Returns whether ODOMETRY is sent and must not stop.
        """
        self._emit = emit
        self._heartbeat = heartbeat
        self._is_streaming_in_flight = is_streaming_in_flight
        self.patience_ns = 10 * SECOND_NS
        """How long nothing is sent where no ODOMETRY of the other is heard: no two of us may have
        the same, or both would begin at once."""
        self.is_clash = False
        """Whether somebody else speaks under our ids now."""
        self.is_yielding = False
        """Whether no ODOMETRY is sent because of that."""
        self._other = Presence(_GONE_NS)
        self._warned_ns: int | None = None
        self._since_ns = 0
        """When we began to wait, or when an ODOMETRY of the other last came."""

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Handle a frame that came in under our ids."""
        now_ns = quantise(now_ns)
        if frame.message_id == IDS["ODOMETRY"] and self.is_yielding:
            self._since_ns = now_ns  # no echo: we send none
        if frame.message_id != IDS["HEARTBEAT"] or not self._heartbeat.is_foreign(frame):
            return
        self._other.on_heartbeat(now_ns)
        if self._other.is_there and not self.is_clash:
            self.is_yielding = not self._is_streaming_in_flight()
            self._since_ns = now_ns
        self.is_clash = self._other.is_there
        if self.is_clash and (self._warned_ns is None or now_ns - self._warned_ns >= _AGAIN_NS):
            self._warned_ns = now_ns
            self._emit(Clash(frame.system_id, frame.component_id, self.is_yielding))

    def tick(self, now_ns: int) -> None:
        """Notice that the other has gone, or sends no ODOMETRY."""
        self._other.tick(now_ns)
        self.is_clash = self._other.is_there
        is_patient = quantise(now_ns) - self._since_ns <= self.patience_ns
        self.is_yielding = self.is_yielding and self.is_clash and is_patient
