"""The guard against counting the same GNSS twice: it reads the autopilot's parameters that decide.

Until they are answered, no ODOMETRY is sent, and none to an autopilot that does not answer. A
change that a ground station makes counts when its PARAM_VALUE comes by, or else when the parameter
is read again in turn.

What is fused is read in every mode that may send: while ODOMETRY flows into the autopilot's own
estimate, that estimate is no measurement. Whether an answer is still waited for depends on what is
heard and when it came, never on ``tick``: so a replay decides the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decision import Decision, kept, shared, silent
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.event import Emit, GuardChanged, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.fusion import (
    NAMES,
    SUCCESSORS,
    Mode,
    decide,
    helpful,
    is_old,
    missing,
    watched,
)
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Handler, Service
from ekf_companion.mavlink.stamp import SECOND_NS, quantise

_TIMEOUT_NS = SECOND_NS
_TRIES = 3
_IN_FLIGHT = 4
_GIVE_UP_NS = _TRIES * _TIMEOUT_NS
"""After so long without a new answer, the missing ones are not waited for."""
ROUND_NS = SECOND_NS * 3 // 2
"""Every parameter that is watched is read again once in this time: a change counts within 2 s."""
_SLOWEST_NS = SECOND_NS // 2
"""Between two readings where few are watched."""
STALE_NS = 5 * SECOND_NS
_UNANSWERED = 10
"""Without any answer for so long, and to more requests than this, nothing is known any more. On a
link that loses a tenth of all frames, so many in a row stay unanswered once in a hundred days."""

DOES_NOT_EXIST = 1
"""In PARAM_ERROR."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardOptions:
    """What the configuration says of ODOMETRY."""

    mode: Mode = "auto"
    independent: bool = False
    """Whether our sensors are other ones than the autopilot's."""
    withhold_in_flight: bool = False
    """Whether a doubt that begins in flight stops what was streamed; else proof is needed."""
    second_source: Literal["withhold", "send"] = "withhold"
    """What becomes of ours on the ground while another source of poses is heard."""


class Guard(Service):
    """Decides whether ODOMETRY is sent."""

    def __init__(
        self,
        outbox: Outbox,
        emit: Emit,
        refuse_ours: Callable[[bool, bool], None],
        options: GuardOptions | None = None,
        is_flying: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin with no autopilot.

        ``refuse_ours`` is called with whether our ODOMETRY is fused in the autopilot's own
        position, and in its yaw, as soon as that is known; ``is_flying`` returns whether the
        vehicle is in the air.
        """
        self.options = options or GuardOptions()
        self.handles: dict[str, Handler] = {
            "PARAM_VALUE": self._take,
            "PARAM_ERROR": self._take_error,
        }
        self._outbox = outbox
        self._emit = emit
        self._refuse_ours = refuse_ours
        self._is_flying = is_flying
        self._forget()
        self._other_id: int | None = None
        self._last: tuple[bool, str, str] | None = None
        self.decision: Decision = self._nobody()

    def _forget(self) -> None:
        self._peer: PeerFound | None = None
        self._answers: dict[str, float | None] = {}
        self._requests: dict[str, tuple[int, int]] = {}
        """How often each parameter was requested, and until when an answer may come, ns."""
        self._turn = self._next_ns = 0
        self.is_waiting = False
        """Whether answers that decide are waited for; ``on_frame`` must then be called."""
        self._learned_ns: int | None = None
        """When the last new one came, or else the first frame of the autopilot."""
        self._is_given_up = False
        self._answered_ns: int | None = None
        self._unanswered = 0
        self._is_silent = False
        self._is_taken = self._is_yaw_taken = False
        """Whether its position, and its yaw, are ours by other ways than parameters show."""

    # What changes

    def retune(self, options: GuardOptions) -> None:
        """Decide by other options from now on."""
        if options == self.options:
            return
        self.options = options
        self._last = None  # announce the outcome, even if it is the same
        if self._peer is None:
            self.decision = self._nobody()
        else:
            was_taken, is_yaw = self._is_taken, self._is_yaw_taken
            self.begin(self._peer)  # what was read long ago may have changed
            if was_taken:
                self.note_taken(is_yaw=is_yaw)

    def begin(self, peer: PeerFound) -> None:
        """Read all parameters again: a reboot may have changed any."""
        self._forget()
        self._peer = peer
        self._decide()

    def on_other_autopilot(self, other_id: int | None) -> None:
        """Learn that another system's autopilot is on the link too, or (None) no longer is."""
        self._other_id = other_id
        if self._peer is not None:
            self._decide()

    def end(self) -> None:
        """Forget the parameters: another autopilot may come next."""
        self._forget()
        self.decision = self._nobody()

    def note_taken(self, *, is_yaw: bool = False) -> None:
        """Learn that the autopilot has taken a position of ours, and maybe a yaw, until it reboots.

        That is what its parameters do not show.
        """
        if not self._is_taken or is_yaw > self._is_yaw_taken:
            self._is_taken, self._is_yaw_taken = True, is_yaw or self._is_yaw_taken
            self._tell_what_is_ours()

    def _tell_what_is_ours(self) -> None:
        decision = self.decision
        is_yaw = decision.is_yaw_fused or self._is_yaw_taken
        self._refuse_ours(decision.is_fused or self._is_taken, is_yaw)

    def tick(self, now_ns: int) -> None:
        """Request what is missing, then read again what could change."""
        if not self._is_asking:
            return
        family, answers = self.family, self._answers
        for name in (*missing(family, answers), *helpful(family, answers)):
            if not self._is_superseded(name, now_ns):
                self._request(name, now_ns)
        if not self.is_waiting and now_ns >= self._next_ns:
            names = watched(self.family, self._answers)
            self._next_ns = now_ns + min(ROUND_NS // len(names), _SLOWEST_NS)
            self._turn += 1
            self._unanswered += 1
            self._notice_silence(now_ns)
            self._send(names[self._turn % len(names)], now_ns)

    def _notice_silence(self, now_ns: int) -> None:
        """Stop relying on answers that are too old."""
        if self._is_silent or self._answered_ns is None or self._unanswered <= _UNANSWERED:
            return
        if now_ns - self._answered_ns > STALE_NS:
            self._is_silent = True
            self._decide()

    def on_frame(self, now_ns: int) -> None:
        """Note a frame of the autopilot; without a new answer for long, wait no more."""
        now_ns = quantise(now_ns)
        if self._learned_ns is None:
            self._learned_ns = now_ns
        elif now_ns - self._learned_ns >= _GIVE_UP_NS:
            self._is_given_up = True
            self._decide()

    # Answers

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        value = value_of(message, frame, self.family)
        if value is not None:
            self._on_answer(message.param_id.decode("ascii", "replace"), value, now_ns)

    def _take_error(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.error == DOES_NOT_EXIST:
            self._on_answer(message.param_id.decode("ascii", "replace"), None, now_ns)

    def _on_answer(self, name: str, value: float | None, now_ns: int) -> None:
        if not self._is_asking or name not in NAMES[self.family]:
            return
        if name not in self._answers:
            self._learned_ns = quantise(now_ns)
            if self._is_given_up:  # it answers after all: request the rest again
                self._requests.clear()
                self._is_given_up = False
        self._answers[name] = value
        self._requests.pop(name, None)
        self._answered_ns, self._unanswered, self._is_silent = now_ns, 0, False
        self._decide()
        self.tick(now_ns)

    # Requests

    def _is_superseded(self, name: str, now_ns: int) -> bool:
        """Return whether the parameters of newer firmware may still be answered in its place."""
        newer = SUCCESSORS.get(name, ())
        if any(self._answers.get(one) is not None for one in newer):
            return True
        open_ones = [one for one in newer if one not in self._answers]
        return any(now_ns < self._requests.get(one, (0, now_ns + 1))[1] for one in open_ones) and (
            not any(self._requests.get(one, (0, 0))[0] > 1 for one in open_ones)
        )

    def _request(self, name: str, now_ns: int) -> None:
        tries, until_ns = self._requests.get(name, (0, now_ns))
        in_flight = sum(now_ns < end_ns for _, end_ns in self._requests.values())
        if tries < _TRIES and now_ns >= until_ns and in_flight < _IN_FLIGHT:
            self._requests[name] = tries + 1, now_ns + _TIMEOUT_NS
            self._send(name, now_ns)

    def _send(self, name: str, now_ns: int) -> None:
        if self._peer is None:
            return
        payload = pack(
            "PARAM_REQUEST_READ", **self._peer.target, param_id=name.encode(), param_index=-1
        )
        self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    # Decision

    @property
    def family(self) -> Family:
        """The autopilot's."""
        return Family.UNKNOWN if self._peer is None else self._peer.family

    @property
    def is_reading(self) -> bool:
        """Whether the decision depends on any parameter."""
        is_asked = self.options.mode == "auto" and not self.options.independent
        return is_asked and bool(NAMES[self.family])

    @property
    def _is_asking(self) -> bool:
        """Whether parameters are needed, for the decision or to know what the autopilot fuses."""
        return self.options.mode != "never" and bool(NAMES[self.family])

    @property
    def is_old(self) -> bool:
        """Whether it is a PX4 before 1.14, as far as its parameters are known."""
        return is_old(self.family, self._answers)

    def _decide(self) -> None:
        options = self.options
        is_open = self._is_asking and bool(missing(self.family, self._answers))
        self.is_waiting = is_open and not self._is_given_up
        decision = decide(
            self.family,
            self._answers,
            options.mode,
            options.independent,
            is_complete=not self.is_waiting,
        )
        if options.mode == "auto" and not options.independent and decision.is_streaming:
            # Whether it fuses what it gets does not change by that
            if self._is_silent:
                decision = self._doubted(decision, silent(decision))
            elif self._other_id is not None:
                decision = self._doubted(decision, shared(decision, self._other_id))
        self.decision = decision
        if not self.is_waiting:
            self._tell_what_is_ours()
        shown = (decision.is_streaming, decision.reason, decision.remedy)
        if decision.is_settled and shown != self._last:
            self._last = shown
            self._emit(GuardChanged(decision))

    def _doubted(self, decision: Decision, doubt: Decision) -> Decision:
        """Return what to do in doubt: anybody can forge a heartbeat, and fall silent in flight."""
        is_kept = self.decision.is_streaming and self._is_flying()
        if is_kept and not self.options.withhold_in_flight:
            return kept(decision, doubt)
        return doubt

    def _nobody(self) -> Decision:
        options = self.options
        if options.mode == "auto":
            return Decision(is_streaming=False, reason="no autopilot is heard", is_settled=False)
        return decide(Family.UNKNOWN, {}, options.mode, options.independent)
