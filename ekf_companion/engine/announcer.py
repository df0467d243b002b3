"""Announcements of what has changed: in full to the log, and in short to the pilot."""

from __future__ import annotations

import logging
from collections.abc import Iterable

from ekf_companion.engine.estimate_announcer import EstimateAnnouncer, journal_fields
from ekf_companion.engine.pilot import PilotTexts
from ekf_companion.mavlink.audit import no_samples_cause
from ekf_companion.mavlink.decode import aids
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

_log = logging.getLogger(__name__)

SILENCE_NS = 10 * SECOND_NS
"""Without an autopilot for so long, or samples of one, a human should look: it sends its heartbeat
once a second, and requests have been answered by then, or never are."""

_SPARE = {
    "SCALED_PRESSURE": "autopilots whose inertial message has no pressure need it",
    "GLOBAL_POSITION_INT": "autopilots without fixes of their receiver need it",
    "GPS2_RAW": "vehicles with two receivers have it",
    "SCALED_IMU2": "vehicles with two compasses have it",
    "SCALED_IMU3": "vehicles with three compasses have it",
    **dict.fromkeys(aids.RATES, "vehicles with such a sensor have it"),
}
"""Messages that a vehicle may do without, and who may not."""


class Announcer:
    """Announces each change once to the log, and as rarely as :mod:`.pilot` says to the pilot."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self.pilot = PilotTexts(self._send_text)
        self.estimate = EstimateAnnouncer(session, self.pilot)
        """For what changes in the estimate and in what is sent of it."""
        self._now_ns = 0
        self._next_ns: dict[str, int] = {}
        self._waiting: dict[str, Event] = {}
        self._silent_from_ns: int | None = None
        self._is_heard = False
        """Whether an autopilot was found, or its absence announced."""
        self._found_ns: int | None = None
        """When one was found that has sent no inertial sample; None: or that was announced."""

    def on_begin(self, warnings: Iterable[str]) -> None:
        """Begin with an estimator that begins anew, and the warnings about its output."""
        self.estimate.on_begin()
        for warning in warnings:
            _log.warning("%s", warning)

    def _send_text(self, severity: Severity, text: str) -> None:
        """Send the pilot a text that names its sender."""
        self._session.statustext.send(severity, f"Companion: {text}")

    def _tell(self, subject: str, severity: Severity, text: str) -> None:
        """Send the pilot the state of a subject, which the text itself names."""
        self.pilot.on_state(subject, text, severity, text, self._now_ns)

    def _repeat(self, subject: str, severity: Severity, text: str) -> None:
        """Send the pilot what may come again soon, and then of several the last."""
        self.pilot.on_occurrence(subject, severity, text, self._now_ns)

    def on_event(self, event: Event, now_ns: int) -> None:
        """Announce an event on the link; one that anybody can cause, once a second at most."""
        self._now_ns = now_ns
        subject = _subject(event)
        if subject and now_ns < self._next_ns.get(subject, now_ns):
            self._waiting[subject] = event
            return
        if subject:
            self._next_ns[subject] = now_ns + SECOND_NS
        self._announce(event)

    def tick(self, now_ns: int) -> None:
        """Announce what came too often, and that no autopilot is heard."""
        self._now_ns = now_ns
        self.pilot.tick(now_ns)
        due = [subject for subject in self._waiting if now_ns >= self._next_ns[subject]]
        for subject in due:
            self.on_event(self._waiting.pop(subject), now_ns)
        if self._is_heard:
            self._await_samples()
            return
        if self._silent_from_ns is None:
            self._silent_from_ns = now_ns
        if now_ns - self._silent_from_ns >= SILENCE_NS:
            self._is_heard = True
            self._announce_silence()

    def _await_samples(self) -> None:
        """Announce once that an autopilot sends no inertial sample, and the probable reason."""
        session = self._session
        peer = session.discovery.peer
        if self._found_ns is None or peer is None or session.discovery.is_lost:
            return
        if peer[0] in session.discovery.sampled:
            self._found_ns = None
        elif self._now_ns - self._found_ns >= SILENCE_NS:
            self._found_ns = None
            cause = no_samples_cause(session.requests.results, session.discovery.family)
            _log.warning("No inertial sample of the autopilot has come in 10 s: %s", cause)
            self._tell("samples", Severity.WARNING, "no inertial samples")

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
                self._is_heard, self._found_ns = True, self._now_ns
                self.pilot.forget()
                _log.info(
                    "Autopilot found: system %d, component %d, %s",
                    system_id,
                    component_id,
                    family.value,
                    extra=journal_fields("autopilot", "found"),
                )
            case PeerLost():
                _log.warning(
                    "Autopilot lost: no heartbeat for 5 s; check the link",
                    extra=journal_fields("autopilot", "lost"),
                )
            case Rebooted():
                _log.warning(
                    "Autopilot rebooted: its clock began anew, and so does the estimate",
                    extra=journal_fields("autopilot", "rebooted"),
                )
                self.estimate.on_reboot(self._now_ns)
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
                self._tell("several", Severity.WARNING, f"several autopilots, using {system_id}")
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
                words = f"using autopilot {now[0]}/{now[1]}, not {was[0]}/{was[1]}"
                self._tell("autopilot", Severity.WARNING, words)
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
                self._tell("clash", Severity.CRITICAL, f"id {component_id} is taken twice, {does}")
            case RateTooLow(message, asked, measured, cause):
                _log.warning(
                    "%s comes at %.1f Hz, asked for %.0f: %s", message, measured, asked, cause
                )
                words = f"{message} {measured:.0f} of {asked:.0f} Hz: {cause}"
                self._repeat(f"rate {message}", Severity.WARNING, words)
            case GuardChanged(decision):
                is_bad = decision.is_warning
                _log.log(
                    logging.WARNING if is_bad else logging.INFO,
                    "%s",
                    decision.sentence,
                    extra=journal_fields(
                        "guard", "streaming" if decision.is_streaming else "withheld"
                    ),
                )
                severity, text = Severity.WARNING if is_bad else Severity.INFO, decision.text
                # Each time that somebody lifts the guard, however often
                is_lifted = is_bad and decision.is_streaming
                if is_lifted:
                    self.pilot.assume("guard", "")
                at_ns = self._now_ns
                # A warning that was sent, once a minute at most, is taken back at once
                is_grave = is_lifted or not is_bad
                self.pilot.on_state("guard", text, severity, text, at_ns, is_grave=is_grave)
            case FollowingChanged(apart=""):
                _log.info("The autopilot's own estimate is ours again")
                self._tell("following", Severity.INFO, "autopilot follows again")
            case FollowingChanged(apart, may_be_own):
                _log.warning(
                    "The autopilot's own estimate is not what ODOMETRY says: %s%s",
                    apart,
                    "; it may be on its own receiver" if may_be_own else "",
                    extra=journal_fields("following", apart),
                )
                what = "is" if may_be_own else "does not follow:"
                self._tell("following", Severity.WARNING, f"autopilot {what} {apart}")
            case HoldChanged(hold=None):
                _log.info("ODOMETRY is sent again", extra=journal_fields("stream", "sent"))
                self._tell("hold", Severity.INFO, "ODOMETRY is sent again")
            case HoldChanged(hold) if hold is not None:
                _log.warning(
                    "No ODOMETRY: %s%s",
                    hold.reason,
                    f"; {hold.remedy}" if hold.remedy else "",
                    extra=journal_fields("stream", "held"),
                )
                self._tell("hold", Severity.WARNING, f"no ODOMETRY: {hold.text}")
            case Advised(sentence, text):
                _log.warning("%s", sentence)
                self._tell("advice", Severity.WARNING, text)
            case ParameterSet(name, key, value, is_late):
                since = " from the next start" if is_late else ""
                _log.info("Parameter %s set to %g (%s)%s", name, value, key, since)
                self._repeat(f"set {name}", Severity.INFO, f"{name} is {value:g}{since}")
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
