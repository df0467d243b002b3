"""How late ODOMETRY reaches the autopilot, by the answers to TIMESYNC; too late, it waits.

What an answer to TIMESYNC takes there and back is how old the state in an ODOMETRY is when it
arrives: its sample came one way, the message goes the other. Where that is too long, or no answer
comes any more, ODOMETRY is withheld. A constant delay the autopilot takes off, where it is set to;
on the ground nothing is begun with where it is not.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from ekf_companion.mavlink.clock import Timesync
from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.event import Advised, Emit, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.lag import CROWDED, DelaySetting, Lag
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.pacing import Pacing
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

LATE_NS = SECOND_NS // 2
"""Later than that no autopilot can take it: ArduPilot is set to 0.25 s of delay at most, PX4 to
0.3 s; a vehicle at 5 m/s is 1 m further by the rest."""
_STREAK = 2
"""Answers in a row that come so late, or one, and the next waits as long: a single one may have
stood in a stall of half a second."""
_SILENT_NS = SECOND_NS * 7 // 5
_UNANSWERED = 7
"""Without an answer for so long, and to so many requests in a row, nobody hears us. On a link that
loses a tenth of all frames either way, so many are lost together once in three hours."""
_BACK_NS = SECOND_NS * 3 // 10
"""Only faster answers end the silence,"""
_BACK_SPAN_NS = SECOND_NS
"""over so long,"""
_LONGEST_BACK_NS = 64 * SECOND_NS
"""and over twice that each time that they are late again"""
_AGAIN_NS = 20 * SECOND_NS
"""within so long."""
_UNSET_NS = SECOND_NS * 15 // 100
"""Of constant delay that the autopilot does not take off: on the ground more is not begun with. At
5 m/s it is 0.75 m."""
_SET_NS = SECOND_NS // 10
"""Less than that ends it."""
_NOTED_NS = SECOND_NS // 20
"""From such a delay on the autopilot's parameter is read,"""
_LATE_ASK_NS, _ASK_NS = 2 * SECOND_NS, 10 * SECOND_NS
"""so often: while it decides, and else."""
_ASKS = 3
"""Without an answer to so many, the parameter counts as 0."""
_KEPT = 64
"""Requests of the time whose answers are known, however late."""


class Delivery(Service):
    """Watches how late our messages arrive, and withholds ODOMETRY, or some of them."""

    def __init__(
        self,
        outbox: Outbox,
        emit: Emit,
        guard: Guard,
        timesync: Timesync,
        is_flying: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin with nothing known; ``is_flying`` returns whether the vehicle is in the air."""
        self.handles = {"TIMESYNC": self._take, "PARAM_VALUE": self._take_parameter}
        self._outbox, self._emit, self._guard = outbox, emit, guard
        self._timesync, self._is_flying = timesync, is_flying
        timesync.on_request = self._on_request
        self.lag = Lag()
        """What the answers have taken."""
        self.pacing = Pacing(self.lag, emit)
        """How many ODOMETRY are sent."""
        self.begin(PeerFound(0, 0, Family.UNKNOWN))

    def begin(self, peer: PeerFound) -> None:
        """Measure anew; how many the line takes stays known."""
        self._peer = peer
        self.hold: Hold | None = None
        self.lag.clear()
        self.setting = DelaySetting.of(peer.family)
        """The autopilot's parameter that takes a constant delay off."""
        self._asks = self._next_ask_ns = 0
        self._open: deque[int] = deque(maxlen=_KEPT)
        """Requests of the time that may be answered yet, by when they left."""
        self._unanswered = 0
        """Of them, those since the last answer."""
        self._note_oldest()
        self._late = 0
        self._is_constant = False
        """Whether it is held as a constant delay is not set."""
        self._is_advised = False
        self._good_ns: int | None = None
        """Since when all answers have come soon enough to send again."""
        self._back_ns = _BACK_SPAN_NS
        self._freed_ns: int | None = None

    def end(self) -> None:
        """Forget what was measured: nobody answers."""
        self.begin(PeerFound(0, 0, Family.UNKNOWN))

    # What the answers tell

    def _on_request(self, ts1: int) -> None:
        """Note a request of ours, by the time of ours that it bears."""
        self._open.append(ts1)
        self._unanswered += 1
        self._note_oldest()

    def _note_oldest(self) -> None:
        """Note when the oldest request left that is open since the last answer."""
        is_open = self._unanswered > 0
        self.pacing.asked_ns = (
            self._open[-min(self._unanswered, len(self._open))] if is_open else None
        )

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.tc1 == 0 or message.ts1 not in self._open or now_ns < message.ts1:
            return
        # What was asked before it is lost, or overtaken
        while self._open.popleft() != message.ts1:
            pass
        self._unanswered = len(self._open)
        self._note_oldest()
        self.lag.add(now_ns, message.ts1, message.tc1)
        self._judge_answer(now_ns)
        self.pacing.on_answer(now_ns)

    def _judge_answer(self, now_ns: int) -> None:
        """Hold where answers are late; go on where all of a second were soon enough."""
        rtt = self.lag.last_ns
        self._late = self._late + 1 if rtt > LATE_NS else 0
        if self._late >= _STREAK and self._is_harmful and self._is_free:
            self._hold_late(rtt * 1e-9, now_ns)
        if rtt > max(_BACK_NS, self.setting.compensated_ns + _UNSET_NS):
            self._good_ns = None
        elif self._good_ns is None:
            self._good_ns = now_ns
        if self.hold is None or self._is_constant or self._good_ns is None:
            return
        if now_ns - self._good_ns >= self._back_ns:
            self.hold, self._freed_ns = None, now_ns

    @property
    def _is_harmful(self) -> bool:
        """Whether the autopilot flies by what comes late, or may."""
        return self._guard.decision.is_streaming and self._guard.decision.is_fused

    @property
    def _is_free(self) -> bool:
        """Whether nothing holds it yet, or only a constant delay."""
        return self.hold is None or self._is_constant

    def _hold_late(self, seconds: float, now_ns: int) -> None:
        self._begin_hold(now_ns)
        cause, remedy, text = (
            ("this board lets the daemon wait", CROWDED, "companion")
            if self.lag.is_loop(seconds)
            else (
                "the link to the autopilot is too slow",
                "raise the baud rate or take a faster link",
                "link",
            )
        )
        self.hold = Hold(
            reason=f"it would arrive {seconds:.1f} s after its state was true: {cause}",
            remedy=f"{remedy}; it is sent again when answers come within {_BACK_NS * 1e-9:.1f} s",
            text=f"{text} {seconds:.1f} s late",
        )

    def _begin_hold(self, now_ns: int) -> None:
        """Wait the longer to send again, the oftener it has been in vain."""
        self._is_constant, self._good_ns = False, None
        is_again = self._freed_ns is not None and now_ns - self._freed_ns < _AGAIN_NS
        self._back_ns = min(2 * self._back_ns, _LONGEST_BACK_NS) if is_again else _BACK_SPAN_NS

    # What time tells

    def tick(self, now_ns: int) -> None:
        """Notice that no answer comes, or that a constant delay is not set."""
        self._timesync.watch_ns = (
            self.pacing.watch_ns if self._guard.decision.is_streaming else None
        )
        if not self._is_harmful:
            self.hold, self._is_constant = None, False
            return
        self._notice_silence(now_ns)
        self._ask_setting(now_ns)
        self._judge_constant(now_ns)

    def _notice_silence(self, now_ns: int) -> None:
        """Hold where an autopilot that has answered no longer does."""
        last = self.lag.answered_ns
        asked_ns = self.pacing.asked_ns
        waits_ns = 0 if asked_ns is None else now_ns - asked_ns
        if self._late and waits_ns > LATE_NS and self._is_free:
            self._hold_late(max(waits_ns, self.lag.last_ns) * 1e-9, now_ns)
        if last is None or self._unanswered < _UNANSWERED or now_ns - last <= _SILENT_NS:
            return
        self._good_ns = None
        if self._is_free:
            self._begin_hold(now_ns)
            self.hold = Hold(
                reason="the autopilot has answered no TIMESYNC for "
                f"{(now_ns - last) * 1e-9:.1f} s: what is sent waits somewhere, or is lost",
                remedy="check the line to the autopilot, and its baud rate",
                text="autopilot answers no more",
            )

    def _judge_constant(self, now_ns: int) -> None:
        """Hold on the ground where the autopilot does not take off a delay that it could."""
        unset = self._unset_ns
        if unset < _SET_NS:
            self._is_advised = False
            if self._is_constant:
                self.hold, self._is_constant = None, False
        is_read = self.setting.value is not None or self._asks >= _ASKS
        if unset <= _UNSET_NS or self.hold is not None or not is_read:
            return
        late_ms = (self.lag.fastest_ns or 0) * 1e-6
        words = self.setting.advice(self.lag, now_ns)
        if not self._is_flying():
            self._is_constant = True
            taken = f"{self.setting.compensated_ns * 1e-6:.0f} ({self.setting.name})"
            self.hold = Hold(
                reason=f"it would arrive {late_ms:.0f} ms after its state was true, of which the "
                f"autopilot takes off {taken}",
                remedy=words,
                text=self.setting.text(self.lag, now_ns),
            )
        elif not self._is_advised:
            self._is_advised = True
            sentence = f"ODOMETRY arrives {late_ms:.0f} ms after its state was true: {words}"
            self._emit(Advised(sentence, f"ODOMETRY {late_ms:.0f} ms late, still sent"))

    @property
    def _unset_ns(self) -> float:
        """The constant delay that the autopilot does not take off, ns; 0: not known yet."""
        if self.lag.is_few or (self._peer.family is Family.PX4 and self._timesync.is_locked):
            return 0.0  # PX4 goes by our stamps, which are of its own time
        return (self.lag.fastest_ns or 0.0) - self.setting.compensated_ns

    def advice(self, now_ns: int) -> str:
        """Return what to set for the delay that is measured; empty: nothing need be."""
        is_by_stamps = self._peer.family is Family.PX4 and self._timesync.is_locked
        return "" if is_by_stamps else self.setting.advice(self.lag, now_ns)

    def _ask_setting(self, now_ns: int) -> None:
        """Read the parameter; what a ground station sets comes by as well."""
        is_late = not self.lag.is_few and (self.lag.fastest_ns or 0) > _NOTED_NS
        if not self.setting.name or not is_late or now_ns < self._next_ask_ns:
            return
        is_deciding = self._unset_ns > _SET_NS or self.setting.value is None
        self._next_ask_ns = now_ns + (_LATE_ASK_NS if is_deciding else _ASK_NS)
        self._asks += 1
        name = self.setting.name.encode()
        payload = pack("PARAM_REQUEST_READ", **self._peer.target, param_id=name, param_index=-1)
        self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    def _take_parameter(self, message: Any, frame: Frame, now_ns: int) -> None:
        name = message.param_id.decode("ascii", "replace")
        if name == self.setting.name:
            value = value_of(message, frame, self._peer.family)
            self.setting = self.setting.read(value)
