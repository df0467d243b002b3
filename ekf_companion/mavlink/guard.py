"""The guard against counting the same GNSS twice: asks the autopilot for what decides, and watches.

Until the answers are there, nothing is sent; what does not answer is not told. A change that a
ground station makes counts when its PARAM_VALUE comes by, and otherwise when the parameter's turn
comes to be read again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from struct import Struct
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, GuardChanged, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.fusion import NAMES, Mode, decide, missing, watched
from ekf_companion.mavlink.layout import IDS
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Handler, Service
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.verdict import Verdict

_TIMEOUT_NS = SECOND_NS
_TRIES = 3
_IN_FLIGHT = 4
_ROUND_NS = SECOND_NS * 3 // 2
"""In which every parameter that is watched is read again: a change counts within two seconds."""
_SLOWEST_NS = SECOND_NS // 2
"""Between two readings where few are watched."""
_STALE_NS = 5 * SECOND_NS
_UNANSWERED = 10
"""Without any answer for so long, and to so many questions, nothing is known any more. On a link
that loses a tenth of all frames so many in a row have no answer once in a hundred days."""

_REAL32 = 9
DOES_NOT_EXIST = 1
"""In PARAM_ERROR."""
_INT32 = Struct("<i")


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardOptions:
    """What the configuration says of ODOMETRY."""

    mode: Mode = "auto"
    independent: bool = False
    """Whether our sensors are none of the autopilot's."""


@dataclass(slots=True)
class _Question:
    tries: int = 0
    deadline_ns: int = 0

    def is_open(self, now_ns: int) -> bool:
        """Whether an answer may still come."""
        return self.tries > 0 and now_ns < self.deadline_ns

    def is_given_up(self, now_ns: int) -> bool:
        return self.tries >= _TRIES and now_ns >= self.deadline_ns


class Guard(Service):
    """Decides whether ODOMETRY is sent."""

    def __init__(self, outbox: Outbox, emit: Emit, options: GuardOptions | None = None) -> None:
        self.options = options or GuardOptions()
        # A dialect from before PARAM_ERROR lacks its layout, and silence says the same
        handlers: dict[str, Handler] = {"PARAM_VALUE": self._take, "PARAM_ERROR": self._take_error}
        self.handles = {name: handler for name, handler in handlers.items() if name in IDS}
        self._outbox = outbox
        self._emit = emit
        self._peer: PeerFound | None = None
        self._answers: dict[str, float | None] = {}
        self._questions: dict[str, _Question] = {}
        self._turn = 0
        self._next_ns = 0
        self._answered_ns: int | None = None
        self._unanswered = 0
        self._is_silent = False
        self._other_id: int | None = None
        self._told: tuple[bool, str, str] | None = None
        self.verdict: Verdict = self._nobody()

    @property
    def is_streaming(self) -> bool:
        """Whether ODOMETRY may be sent now."""
        return self.verdict.is_streaming

    # What changes

    def retune(self, options: GuardOptions) -> None:
        """Decide by other options from now on."""
        if options == self.options:
            return
        self.options = options
        self._told = None  # each choice is answered aloud
        if self._peer is None:
            self.verdict = self._nobody()
        else:
            self.begin(self._peer)  # what was read long ago may hold no more

    def begin(self, peer: PeerFound) -> None:
        """Ask anew: a reboot may have changed anything."""
        self._forget()
        self._peer = peer
        self._judge(is_complete=False)

    def share(self, other_id: int | None) -> None:
        """Learn that another system's autopilot is on the link too, or (None) is no more."""
        self._other_id = other_id
        if self._peer is not None:
            self._judge(is_complete=self.verdict.is_settled)

    def end(self) -> None:
        """Nobody is there: what has been read says nothing of who comes next."""
        self._forget()
        self.verdict = self._nobody()

    def tick(self, now_ns: int) -> None:
        """Ask for what is missing, then read again what could change."""
        if not self.is_reading:
            return
        for name in missing(self._family, self._answers):
            self._ask_for(name, now_ns)
        if not self.verdict.is_settled and self._is_complete(now_ns):
            self._judge(is_complete=True)
        if self.verdict.is_settled and now_ns >= self._next_ns:
            names = watched(self._family, self._answers)
            self._next_ns = now_ns + min(_ROUND_NS // len(names), _SLOWEST_NS)
            self._turn += 1
            self._unanswered += 1
            self._notice_silence(now_ns)
            self._send(names[self._turn % len(names)], now_ns)

    def _notice_silence(self, now_ns: int) -> None:
        """Count no more on answers that are too old."""
        if self._is_silent or self._answered_ns is None or self._unanswered <= _UNANSWERED:
            return
        if now_ns - self._answered_ns > _STALE_NS:
            self._is_silent = True
            self._judge(is_complete=True)

    # What is answered

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        value = value_of(message, frame, self._family)
        if value is not None:
            self._note(message.param_id.decode("ascii", "replace"), value, now_ns)

    def _take_error(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.error == DOES_NOT_EXIST:
            self._note(message.param_id.decode("ascii", "replace"), None, now_ns)

    def _note(self, name: str, value: float | None, now_ns: int) -> None:
        if not self.is_reading or name not in NAMES[self._family]:
            return
        self._answers[name] = value
        self._questions.pop(name, None)
        self._answered_ns, self._unanswered, self._is_silent = now_ns, 0, False
        self._judge(is_complete=self._is_complete(now_ns))
        self.tick(now_ns)

    # How it is asked

    def _ask_for(self, name: str, now_ns: int) -> None:
        question = self._question(name)
        in_flight = sum(other.is_open(now_ns) for other in self._questions.values())
        if question.tries >= _TRIES or question.is_open(now_ns) or in_flight >= _IN_FLIGHT:
            return
        question.tries += 1
        question.deadline_ns = now_ns + _TIMEOUT_NS
        self._questions[name] = question
        self._send(name, now_ns)

    def _send(self, name: str, now_ns: int) -> None:
        if self._peer is None:
            return
        payload = pack(
            "PARAM_REQUEST_READ",
            target_system=self._peer.system_id,
            target_component=self._peer.component_id,
            param_id=name.encode(),
            param_index=-1,
        )
        self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    def _is_complete(self, now_ns: int) -> bool:
        """Whether all is answered or given up; of who answers nothing, the first is enough."""
        wanted = missing(self._family, self._answers)
        given_up = [self._question(name).is_given_up(now_ns) for name in wanted]
        return all(given_up) or (any(given_up) and not self._answers)

    def _question(self, name: str) -> _Question:
        return self._questions.get(name, _Question())

    # What follows

    @property
    def _family(self) -> Family:
        return Family.UNKNOWN if self._peer is None else self._peer.family

    @property
    def is_reading(self) -> bool:
        """Whether the answer depends on any parameter."""
        is_asked = self.options.mode == "auto" and not self.options.independent
        return is_asked and bool(NAMES[self._family])

    def _judge(self, *, is_complete: bool) -> None:
        options = self.options
        verdict = decide(
            self._family, self._answers, options.mode, options.independent, is_complete
        )
        if options.mode == "auto" and not options.independent and verdict.is_streaming:
            # Whether it fuses what it gets stays as it was
            if self._is_silent:
                verdict = replace(verdict, **_SILENT)
            elif self._other_id is not None:
                verdict = replace(verdict, **_shared(self._other_id))
        self.verdict = verdict
        said = (verdict.is_streaming, verdict.reason, verdict.remedy)
        if verdict.is_settled and said != self._told:
            self._told = said
            self._emit(GuardChanged(verdict))

    def _forget(self) -> None:
        self._peer = None
        self._answers.clear()
        self._questions.clear()
        self._turn = 0
        self._next_ns = 0
        self._answered_ns, self._unanswered, self._is_silent = None, 0, False

    def _nobody(self) -> Verdict:
        options = self.options
        if options.mode == "auto":
            return Verdict(
                is_streaming=False,
                reason="no autopilot is heard",
                parameters={},
                is_settled=False,
            )
        return decide(Family.UNKNOWN, {}, options.mode, options.independent)


def value_of(message: Any, frame: Frame, family: Family) -> float | None:
    """Give the number in an autopilot's PARAM_VALUE; None: it is none.

    Source: MAVLink guide, "Parameter Protocol", on both encodings of the value.
    """
    value = message.param_value
    if family is Family.PX4 and message.param_type != _REAL32:
        # It lays the integer's bytes where the float's would be
        (value,) = _INT32.unpack(frame.payload.ljust(4, b"\0")[:4])
    return float(value) if math.isfinite(value) else None


_SILENT: dict[str, Any] = {
    "is_streaming": False,
    "is_warning": True,
    "reason": "the autopilot answers no request for a parameter any more, and what it fuses by now "
    "cannot be known",
    "remedy": "check that it still hears us on this link, or set output.odometry.mode to always",
    "text": "no ODOMETRY: no parameter is answered",
}


def _shared(other_id: int) -> dict[str, Any]:
    """Say that what has no address would be taken by others too."""
    return {
        "is_streaming": False,
        "is_warning": True,
        "reason": f"the autopilot of system {other_id} is on this link too: ODOMETRY bears no "
        "address, and that one was not asked whether it fuses GNSS",
        "remedy": "give each autopilot a link of its own, or set output.odometry.mode to always",
        "text": f"no ODOMETRY: system {other_id} on the link",
    }
