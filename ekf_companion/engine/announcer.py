"""Announcements of what has changed: in full to the log, and in short to the pilot."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable

from ekf_companion.engine.health import DECIMATED, Arrival, Health
from ekf_companion.engine.stream import WAITING, OdometryStream
from ekf_companion.mavlink.event import (
    Advised,
    Clash,
    Event,
    FirmwareReported,
    FollowingChanged,
    GuardChanged,
    HoldChanged,
    IntervalSet,
    Noted,
    ParameterSet,
    PeerChanged,
    PeerFound,
    PeerLost,
    RateTooLow,
    Rebooted,
    RequestAnswered,
    SeveralAutopilots,
)
from ekf_companion.mavlink.request import ACCEPTED
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.statustext import Severity
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status

_log = logging.getLogger(__name__)

_PATIENCE = 5
"""Seconds until that is announced: at first an autopilot streams as it likes."""
SILENCE_NS = 10 * SECOND_NS
"""Without an autopilot for so long, a human should look: it sends its heartbeat once a second."""

_STATUS_TEXTS = {
    Status.OK: (Severity.INFO, "estimate OK"),
    Status.DEGRADED: (Severity.NOTICE, "estimate degraded"),
    Status.DEAD_RECKONING: (Severity.WARNING, "GNSS lost, dead reckoning"),
    Status.INVALID: (Severity.CRITICAL, "estimate invalid, not sent"),
}
"""What the pilot reads when the status changes; the others come before there is an estimate."""

_SPARE = {
    "SCALED_PRESSURE": "autopilots whose inertial message has no pressure need it",
    "GLOBAL_POSITION_INT": "autopilots without fixes of their receiver need it",
    "GPS2_RAW": "vehicles with two receivers have it",
    "SCALED_IMU2": "vehicles with two compasses have it",
    "SCALED_IMU3": "vehicles with three compasses have it",
}
"""Messages that a vehicle may do without, and who may not."""


def _size(distance: float, speed: float, angle: float) -> str:
    """Return the size of a jump (m, m/s, rad) in words, two digits or more of each."""
    numbers = (distance, "m"), (speed, "m/s"), (math.degrees(angle), "deg")
    return " ".join(f"{value:.{0 if value >= 9.95 else 1}f} {unit}" for value, unit in numbers)


def _fields(event: str, reason: str) -> dict[str, str]:
    """Return the fields of a log line in the journal."""
    return {"EKF_EVENT": event, "EKF_REASON": reason}


class Announcer:
    """Announces each change once."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._status = Status.INIT
        self._resets = 0
        self._decimated = 0
        self._imu_source = ""
        self._jumps = 0
        self._silence = ""
        self._is_position_autopilots = False
        self._receiver = self._compass = 0
        self._strays = 0
        self._next_ns: dict[str, int] = {}
        self._waiting: dict[str, Event] = {}
        self._silent_from_ns: int | None = None
        self._is_heard = False
        """Whether an autopilot was found, or its absence announced."""

    def on_begin(self, warnings: Iterable[str]) -> None:
        """Begin with an estimator that begins anew, and the warnings about its output."""
        self._resets, self._imu_source, self._strays = 0, "", 0
        self._receiver = self._compass = 0
        self._jumps, self._silence = 0, ""
        for warning in warnings:
            _log.warning("%s", warning)

    def _text(self, severity: Severity, text: str) -> None:
        """Send the pilot a text that names its sender."""
        self._session.statustext.send(severity, f"Companion: {text}")

    def on_health(self, health: Health) -> None:
        """Announce what has changed in the filter; to be called once a second."""
        imu_source = self._session.decoder.imu_source
        if health.resets != self._resets:
            self._announce_reset(health)
        self._decimated = self._decimated + 1 if 0.0 < health.imu_rate < DECIMATED else 0
        if self._decimated == _PATIENCE:
            _log.warning(
                "Inertial samples come at %.0f Hz: fast motion is missed, so the noise is taken "
                "for larger; ask for %.0f Hz or more",
                health.imu_rate,
                DECIMATED,
            )
        strays = health.arrivals[Kind.IMU][Arrival.STRAY]
        if strays and not self._strays:
            _log.warning(
                "An inertial sample was stamped ahead of those after it; it is not used, nor are "
                "others of its kind, which are counted as stray"
            )
        self._strays = strays
        if self._imu_source and imu_source != self._imu_source:
            _log.warning("Inertial samples are of %s, were of %s", imu_source, self._imu_source)
            self._text(Severity.WARNING, f"IMU is {imu_source}, was {self._imu_source}")
        self._imu_source = imu_source
        if health.is_position_autopilots and not self._is_position_autopilots:
            _log.warning(
                "No fix of the receiver (GPS_RAW_INT) comes: the position is the autopilot's own "
                "estimate (GLOBAL_POSITION_INT), which is no independent measurement"
            )
            self._text(Severity.WARNING, "position is the autopilot's own")
        self._is_position_autopilots = health.is_position_autopilots
        self._announce_sensors(health)
        if health.status != self._status:
            _log.info(
                "Estimate is %s, was %s",
                health.status.name,
                self._status.name,
                extra=_fields("status", health.status.name.lower()),
            )
            self._status = health.status
            if health.status in _STATUS_TEXTS:
                self._text(*_STATUS_TEXTS[health.status])

    def _announce_sensors(self, health: Health) -> None:
        """Announce that another receiver or another compass is used."""
        for name, was, now in (
            ("receiver", self._receiver, health.receiver),
            ("compass", self._compass, health.compass),
        ):
            if was != now:
                _log.warning("The %s in use is number %d, was %d", name, now + 1, was + 1)
                self._text(Severity.WARNING, f"{name} {now + 1} is used, was {was + 1}")
        self._receiver, self._compass = health.receiver, health.compass

    def _announce_reset(self, health: Health) -> None:
        moved, reason = health.reset_delta, health.reset_reason
        size = _size(math.hypot(*moved[:3]), math.hypot(*moved[3:6]), abs(moved[6]))
        _log.warning(
            "Reset %d: %s; moved by %s of yaw",
            health.resets,
            reason,
            size,
            extra=_fields("reset", reason),
        )
        self._text(Severity.WARNING, f"reset {size}, {reason}")
        self._resets = health.resets

    def on_stream(self, stream: OdometryStream) -> None:
        """Announce a jump of ODOMETRY, and that it stops or comes again; once a second."""
        if stream.jump is not None and stream.jumps != self._jumps:
            size = _size(*stream.jump.step.sizes)
            what = "told by reset_counter" if stream.jump.is_told else "kept from the autopilot"
            _log.warning("ODOMETRY jumps by %s of yaw: %s", size, what, extra=_fields("jump", what))
            self._text(Severity.WARNING, f"ODOMETRY jumps {size}")
        self._jumps = stream.jumps
        if stream.silence == self._silence or stream.silence == WAITING:
            return
        if stream.silence:
            _log.warning("No ODOMETRY: %s", stream.silence, extra=_fields("stream", "silent"))
            self._text(Severity.WARNING, f"no ODOMETRY: {stream.silence}")
        else:
            _log.info("ODOMETRY is sent again", extra=_fields("stream", "sent"))
            self._text(Severity.INFO, "ODOMETRY is sent again")
        self._silence = stream.silence

    def on_event(self, event: Event, now_ns: int) -> None:
        """Announce an event on the link; one that anybody can cause, once a second at most."""
        subject = _subject(event)
        if subject and now_ns < self._next_ns.get(subject, now_ns):
            self._waiting[subject] = event
            return
        if subject:
            self._next_ns[subject] = now_ns + SECOND_NS
        self._announce(event)

    def tick(self, now_ns: int) -> None:
        """Announce the last of the events that came too often, and that no autopilot is heard."""
        due = [subject for subject in self._waiting if now_ns >= self._next_ns[subject]]
        for subject in due:
            self.on_event(self._waiting.pop(subject), now_ns)
        if self._is_heard:
            return
        if self._silent_from_ns is None:
            self._silent_from_ns = now_ns
        if now_ns - self._silent_from_ns >= SILENCE_NS:
            self._is_heard = True
            self._announce_silence()

    def _announce_silence(self) -> None:
        """Log that no autopilot has been heard, and what to check."""
        if refused := self._session.admission.refused:
            why, count = refused.most_common(1)[0]
            _log.warning(
                "No heartbeat of an autopilot was let in: %d frames: %s; "
                "link.allow_systems, link.allow_components and signing decide",
                count,
                why,
            )
        elif count := self._session.received_bytes:
            _log.warning(
                "No heartbeat of an autopilot in %d bytes; check the baud rate and link.autopilot",
                count,
            )
        else:
            _log.warning("Nothing heard for 10 s; check the wire, the port and the autopilot's")

    def _announce(self, event: Event) -> None:
        match event:
            case PeerFound(system_id, component_id, family):
                self._is_heard = True
                _log.info(
                    "Autopilot found: system %d, component %d, %s",
                    system_id,
                    component_id,
                    family.value,
                    extra=_fields("autopilot", "found"),
                )
            case PeerLost():
                _log.warning(
                    "Autopilot lost: no heartbeat for 5 s; check the link",
                    extra=_fields("autopilot", "lost"),
                )
            case Rebooted():
                _log.warning(
                    "Autopilot rebooted: its clock began anew, and so does the estimate",
                    extra=_fields("autopilot", "rebooted"),
                )
            case Noted(text):
                _log.warning("%s", text)
            case RequestAnswered(message, result) if result != ACCEPTED and message in _SPARE:
                _log.info("Request for %s: not offered; only %s", message, _SPARE[message])
            case RequestAnswered(message, result):
                _log.info("Request for %s: %s", message, result)
            case FirmwareReported(version):
                _log.info("Autopilot's firmware: %s", version)
            case _:
                self._announce_to_pilot(event)

    def _announce_to_pilot(self, event: Event) -> None:
        """Announce what the pilot should read too."""
        match event:
            case SeveralAutopilots(system_id, other_id):
                _log.warning(
                    "Several autopilots heard (systems %d and %d): listening to system %d; set "
                    "link.autopilot",
                    system_id,
                    other_id,
                    system_id,
                )
                self._text(Severity.WARNING, f"several autopilots, using {system_id}")
            case PeerChanged(was, now, is_lost):
                reason = (
                    "which has fallen silent" if is_lost else "which is less likely the vehicle's"
                )
                _log.warning(
                    "Listening to system %d, component %d instead of system %d, component %d, %s; "
                    "link.autopilot names the one that is meant",
                    *now,
                    *was,
                    reason,
                )
                self._text(
                    Severity.WARNING, f"using autopilot {now[0]}/{now[1]}, not {was[0]}/{was[1]}"
                )
            case Clash(system_id, component_id, is_yielding):
                does = "no ODOMETRY while it sends any" if is_yielding else "ODOMETRY goes on"
                _log.warning(
                    "Somebody else speaks as system %d, component %d: %s; give one of us another "
                    "link.component_id",
                    system_id,
                    component_id,
                    does,
                )
                does = "not sending" if is_yielding else "still sending"
                self._text(Severity.CRITICAL, f"id {component_id} is taken twice, {does}")
            case RateTooLow(message, asked, measured, cause):
                _log.warning(
                    "%s comes at %.1f Hz, asked for %.0f: %s", message, measured, asked, cause
                )
                self._text(Severity.WARNING, f"{message} {measured:.0f} of {asked:.0f} Hz: {cause}")
            case GuardChanged(decision):
                is_bad = decision.is_warning
                _log.log(
                    logging.WARNING if is_bad else logging.INFO,
                    "%s",
                    decision.sentence,
                    extra=_fields("guard", "streaming" if decision.is_streaming else "withheld"),
                )
                self._text(Severity.WARNING if is_bad else Severity.INFO, decision.text)
            case FollowingChanged(apart=""):
                _log.info("The autopilot's own estimate is ours again")
                self._text(Severity.INFO, "autopilot follows again")
            case FollowingChanged(apart, may_be_own):
                _log.warning(
                    "The autopilot's own estimate is not what ODOMETRY says: %s%s",
                    apart,
                    "; it may be on its own receiver" if may_be_own else "",
                    extra=_fields("following", apart),
                )
                what = "is" if may_be_own else "does not follow:"
                self._text(Severity.WARNING, f"autopilot {what} {apart}")
            case HoldChanged(hold=None):
                _log.info("ODOMETRY is sent again", extra=_fields("stream", "sent"))
                self._text(Severity.INFO, "ODOMETRY is sent again")
            case HoldChanged(hold) if hold is not None:
                _log.warning(
                    "No ODOMETRY: %s%s",
                    hold.reason,
                    f"; {hold.remedy}" if hold.remedy else "",
                    extra=_fields("stream", "held"),
                )
                self._text(Severity.WARNING, f"no ODOMETRY: {hold.text}")
            case Advised(sentence, text):
                _log.warning("%s", sentence)
                self._text(Severity.WARNING, text)
            case ParameterSet(name, key, value, is_late):
                since = " from the next start" if is_late else ""
                _log.info("Parameter %s set to %g (%s)%s", name, value, key, since)
                self._text(Severity.INFO, f"{name} is {value:g}{since}")
            case IntervalSet(message, rate):
                _log.info("%s asked for at %g Hz", message, rate)
            case _:
                pass


def _subject(event: Event) -> str:
    """Return the subject of an event that a command can cause; empty for other events."""
    match event:
        case ParameterSet(name=name):
            return name
        case IntervalSet(message=message):
            return message
        case GuardChanged():
            return "guard"
        case _:
            return ""
