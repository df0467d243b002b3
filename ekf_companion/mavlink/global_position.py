"""Whether a global position of ours is sent to the autopilot, whose filter has one of its own.

It is made of the autopilot's own GNSS. So it may reach a filter only where nothing else that is
made of that does: neither the receiver itself, nor our ODOMETRY.

**PX4** fuses GLOBAL_POSITION_SENSOR like the fixes of a receiver, if one of its four slots does
(EKF2_AGPn_CTRL) and has our component id (EKF2_AGPn_ID). It is withheld until the slots are known,
and while EKF2_GPS_CTRL is not 0.

**ArduPilot** takes MAV_CMD_EXTERNAL_POSITION_ESTIMATE from 4.5 on. It does not fuse that: it moves
to it, and only once nothing has shown its EKF3 a position for a second; else it answers FAILED.

What the autopilot has taken is part of its own position, which is then no measurement of ours.
Whether it is sent depends on what was heard and when, never on ``tick``.

Sources: PX4, ``mavlink_receiver.cpp`` (#26307), ``aux_global_position_control.cpp``; ArduPilot,
``GCS_Common.cpp``, ``NavEKF3_core::setLatLng`` (#23903, #26387).
"""

from __future__ import annotations

from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.encode import EXTERNAL_POSITION_ESTIMATE
from ekf_companion.mavlink.event import Advised, Emit, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import DOES_NOT_EXIST, ROUND_NS, STALE_NS, Guard
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Handler, Service
from ekf_companion.mavlink.stamp import quantise

MESSAGES = ("COMMAND_INT", "GLOBAL_POSITION_SENSOR")
"""As which it is sent: to ArduPilot, and to others."""
_GNSS = "EKF2_GPS_CTRL"
_SLOTS = tuple(f"EKF2_AGP{k}_CTRL" for k in range(4))
_ACCEPTED = 0


class GlobalPosition(Service):
    """Decides whether a global position is sent, by the parameters that it reads."""

    def __init__(self, outbox: Outbox, emit: Emit, guard: Guard) -> None:
        """Begin with no autopilot; ``guard`` knows whether it fuses ODOMETRY."""
        self.handles: dict[str, Handler] = {
            "PARAM_VALUE": self._take,
            "PARAM_ERROR": self._take_error,
            "COMMAND_ACK": self._take_answer,
        }
        self._outbox, self._emit, self._guard = outbox, emit, guard
        self._forget()

    def _forget(self) -> None:
        self._peer: PeerFound | None = None
        self._answers: dict[str, tuple[float, int]] = {}
        """Value of each parameter, and when it was read, ns."""
        self._is_wanted = False
        """Whether there was a position to send."""
        self._next_ns = 0
        self.refusal: str | None = None
        """Why the last was not sent; empty: it was; None: there was none."""

    def begin(self, peer: PeerFound) -> None:
        """Read all anew."""
        self._forget()
        self._peer = peer

    def end(self) -> None:
        """Forget the autopilot."""
        self._forget()

    def tick(self, now_ns: int) -> None:
        """Read PX4's parameters, each once in a round."""
        is_px4 = self._peer is not None and self._peer.family is Family.PX4
        if self._peer is None or not is_px4 or not self._is_wanted or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + ROUND_NS
        for name in (_GNSS, *_SLOTS):
            payload = pack(
                "PARAM_REQUEST_READ", **self._peer.target, param_id=name.encode(), param_index=-1
            )
            self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)

    def may_send(self, now_ns: int) -> bool:
        """Return whether a position that is there may be sent now."""
        self._is_wanted = True
        refusal, remedy = self._refuse(quantise(now_ns))
        if refusal != self.refusal:
            self.refusal = refusal
            if remedy:
                sentence = f"No global position is sent: {refusal}; {remedy}"
                self._emit(Advised(sentence, f"no global position: {remedy}"))
        return not refusal

    def _refuse(self, now_ns: int) -> tuple[str, str]:
        """Return why none may be sent, and what to do about it; both empty: it may."""
        guard, family = self._guard, self._guard.family
        if guard.is_waiting:
            return "the autopilot is being asked what it fuses", ""
        if guard.decision.is_fused:
            return "the autopilot fuses our ODOMETRY, which is the same position", ""
        if family is not Family.PX4:
            return "", ""
        values = {name: self._value(name, now_ns) for name in (*_SLOTS, _GNSS)}
        if (unread := next((one for one in values if values[one] is None), None)) is not None:
            return f"{unread} is not answered: this firmware may fuse none", ""
        slots = [name for name in _SLOTS if values[name]]
        if slots and values[_GNSS] and not guard.options.independent:
            reason = f"{slots[0]} and {_GNSS} are not 0: the GNSS that is in it would count twice"
            return reason, f"set {_GNSS} 0"
        if slots:
            guard.note_taken()
        return "", ""

    def _value(self, name: str, now_ns: int) -> float | None:
        value, read_ns = self._answers.get(name, (None, now_ns))
        return value if now_ns - read_ns <= STALE_NS else None

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        name = message.param_id.decode("ascii", "replace")
        value = value_of(message, frame, self._guard.family)
        if name in (_GNSS, *_SLOTS) and value is not None:
            self._answers[name] = value, quantise(now_ns)

    def _take_error(self, message: Any, frame: Frame, now_ns: int) -> None:
        if message.error == DOES_NOT_EXIST:
            self._answers.pop(message.param_id.decode("ascii", "replace"), None)

    def _take_answer(self, ack: Any, frame: Frame, now_ns: int) -> None:
        if ack.command == EXTERNAL_POSITION_ESTIMATE and ack.result == _ACCEPTED:
            self._guard.note_taken()
