"""Announcements of what has changed in the estimate and in what is sent of it."""

from __future__ import annotations

import logging
import math

from ekf_companion.core.output.follower import (
    POSITION_LIMITS,
    VELOCITY_LIMITS,
    YAW_LIMITS,
)
from ekf_companion.engine.checkpoint import Why
from ekf_companion.engine.health import DECIMATED, Arrival, Health
from ekf_companion.engine.pilot import PilotTexts
from ekf_companion.engine.stream import WAITING, OdometryStream
from ekf_companion.engine.warm_start import Outcome
from ekf_companion.engine.wrong import PLACE, Wrong
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.mavlink.statustext import Severity
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Reason, Status

_log = logging.getLogger(__name__)

LONGEST_TEXT = 39
"""Characters: of the 50 of a STATUSTEXT, without ``Companion: ``."""
_PATIENCE = 5
"""Seconds until that is announced: at first an autopilot streams as it likes."""
STEADY_NS = 5 * SECOND_NS
"""An estimate that was degraded is called OK to the pilot when it has been so for so long: until
then it may change to and fro."""
RECOVERY_NS = 3 * SECOND_NS
"""After the companion or the samples paused, fixes take so long to come and be used again: until
then it is the pause that is told, not the GNSS that is missing."""
_FIRST_STARTS = (Why.ALIGNING, Why.REBOOTED, Why.FOREIGN)
"""Refusals after which this run is the first of a flight."""
_PASSING = (Status.DEGRADED, Status.DEAD_RECKONING)
REBOOTED = "autopilot rebooted, estimate anew"


def _size(distance: float, speed: float, angle: float) -> str:
    """Return the size of a jump (m, m/s, rad) in words, two digits or more of each."""
    numbers = (distance, "m"), (speed, "m/s"), (math.degrees(angle), "deg")
    return " ".join(f"{value:.{0 if value >= 9.95 else 1}f} {unit}" for value, unit in numbers)


def _largest(distance: float, speed: float, angle: float) -> tuple[float, str]:
    """Return the part of a jump (m, m/s, rad) that is largest beside what a follower bears.

    As a share of that, and in words.
    """
    parts = (
        (distance / POSITION_LIMITS[1], distance, "m"),
        (speed / VELOCITY_LIMITS[1], speed, "m/s"),
        (angle / YAW_LIMITS[1], math.degrees(angle), "deg"),
    )
    share, value, unit = max(parts)
    return share, f"{value:.{0 if value >= 9.95 else 1}f} {unit}"


def _short(text: str, shorter: str) -> str:
    """Return a text for the pilot, or the shorter where it is too long for one message."""
    return text if len(text) <= LONGEST_TEXT else shorter


def _cause(health: Health) -> str:
    """Return why an estimate is by dead reckoning."""
    reasons = health.reasons
    if Reason.GAP in reasons:
        return "IMU gap"
    if Reason.POSITION_REFUSED in reasons:
        return reasons[Reason.POSITION_REFUSED].removesuffix(", refused")
    if wrong := [one.words for one in health.wrong if one.source in PLACE]:
        return wrong[0]
    return "GNSS lost"


def journal_fields(event: str, reason: str) -> dict[str, str]:
    """Return the fields of a log line in the journal."""
    return {"EKF_EVENT": event, "EKF_REASON": reason}


class EstimateAnnouncer:
    """Announces each change once to the log, and as rarely as :mod:`.pilot` says to the pilot."""

    def __init__(self, session: Session, pilot: PilotTexts) -> None:
        """Begin with nothing estimated."""
        self._session, self._pilot = session, pilot
        self._now_ns = 0
        self._status = Status.INIT
        self._reason = ""
        self._status_ns = 0
        """Since when it is that."""
        self._recovering_ns = 0
        """Until when a pause explains that GNSS is not used."""
        self.on_begin()

    def on_begin(self) -> None:
        """Begin with an estimator that begins anew."""
        self._resets, self._imu_source, self._strays = 0, "", 0
        self._jumps, self._silence = 0, ""
        self._receiver = self._compass = 0
        self._unit = self._session.decoder.inertial.unit
        self._decimated, self._is_position_autopilots = 0, False
        self._odd: set[str] = set()
        self._wrong: dict[str, Wrong] = {}
        """What was wrong when that was looked at last, by source."""
        self._over_ns: dict[str, int] = {}
        """Since when a source is right again, which the pilot is told once it has lasted."""

    def _tell(self, subject: str, severity: Severity, text: str) -> None:
        """Send the pilot the state of a subject, which the text itself names."""
        self._pilot.on_state(subject, text, severity, text, self._now_ns)

    def on_start(self, outcome: Outcome, now_ns: int) -> None:
        """Report to the pilot how a run goes on from the one before, which the log already has."""
        self._now_ns = now_ns
        if outcome.lost is not None:
            self._recovering_ns = now_ns + RECOVERY_NS
            ago = f"{outcome.lost:.1f} s ago"
            self._pilot.on_occurrence(
                "restart", Severity.NOTICE, f"restarted, going on from {ago}", now_ns
            )
        elif outcome.why is not None and outcome.why not in _FIRST_STARTS:
            frame = "same origin" if outcome.is_origin_kept else "new origin"
            words = f"restarted: {outcome.why.short}, {frame}"
            self._pilot.on_occurrence("restart", Severity.WARNING, words, now_ns)

    def on_reboot(self, now_ns: int) -> None:
        """Report to the pilot that the autopilot has rebooted, which the log already has."""
        self._pilot.on_state("estimate", "rebooted", Severity.WARNING, REBOOTED, now_ns)

    def on_pause(self, seconds: float, now_ns: int) -> None:
        """Announce that this process did not run for a while: nothing else is to blame."""
        self._now_ns = now_ns
        self._recovering_ns = now_ns + RECOVERY_NS
        _log.warning(
            "The companion stood still for %.1f s: it was stopped, or the board is overloaded",
            seconds,
            extra=journal_fields("stall", "process"),
        )
        self._pilot.on_occurrence(
            "stall",
            Severity.WARNING,
            f"the companion stood still for {seconds:.1f} s",
            now_ns,
            many=f"stood still {{}} times, {seconds:.1f} s at most",
            size=seconds,
        )

    def on_health(self, health: Health, now_ns: int = 0) -> None:
        """Announce what has changed in the filter; to be called once a second."""
        self._now_ns = max(now_ns, self._now_ns)
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
            words = f"IMU is {imu_source}, was {self._imu_source}"
            self._tell("imu", Severity.WARNING, words)
        self._imu_source = imu_source
        unit, was = self._session.decoder.inertial.unit, self._unit
        if unit != was:
            self._tell("unit", Severity.WARNING, f"IMU {unit} is used, was {was}")
        self._unit = unit
        if health.is_position_autopilots and not self._is_position_autopilots:
            _log.warning(
                "No fix of the receiver (GPS_RAW_INT) comes: the position is the autopilot's own "
                "estimate (GLOBAL_POSITION_INT), which is no independent measurement"
            )
            self._tell("source", Severity.WARNING, "position is the autopilot's own")
        if self._is_position_autopilots and not health.is_position_autopilots:
            self._pilot.assume("source", "receiver")
        self._is_position_autopilots = health.is_position_autopilots
        for words in health.oddities:
            subject = words.split(":")[0]
            if subject not in self._odd:
                self._odd.add(subject)
                _log.warning("%s", words)
        self._announce_sensors(health)
        self._announce_wrong(health)
        self._announce_status(health)

    def _announce_wrong(self, health: Health) -> None:
        """Announce what is found to be wrong, or is suspected at two looks, and that it is over."""
        wrong = {one.name: one for one in health.wrong}
        for name, one in wrong.items():
            was = self._wrong.get(name)
            if was is None or was.is_found != one.is_found:
                _log.warning("%s", one.sentence, extra=journal_fields("fault", one.source.name))
            if one.is_found or was is not None:
                severity = Severity.WARNING if one.is_found else Severity.NOTICE
                key = "found" if one.is_found else "suspected"
                self._pilot.on_state(f"fault {name}", key, severity, one.sentence, self._now_ns)
        for name in self._wrong.keys() - wrong.keys():
            _log.info("%s right again", name, extra=journal_fields("fault", "over"))
            self._over_ns[name] = self._now_ns
            self._pilot.withdraw(f"fault {name}")
        for name, since_ns in list(self._over_ns.items()):
            if name in wrong:
                del self._over_ns[name]
            elif self._now_ns - since_ns >= STEADY_NS:
                del self._over_ns[name]
                subject, text = f"fault {name}", f"{name} right again"
                if self._pilot.shown(subject):
                    self._pilot.on_state(
                        subject, "right", Severity.INFO, text, self._now_ns, is_end=True
                    )
        self._wrong = wrong

    def _announce_sensors(self, health: Health) -> None:
        """Announce that another receiver or another compass is used."""
        for name, was, now in (
            ("receiver", self._receiver, health.receiver),
            ("compass", self._compass, health.compass),
        ):
            if was != now:
                _log.warning("The %s in use is number %d, was %d", name, now + 1, was + 1)
                self._tell(name, Severity.WARNING, f"{name} {now + 1} is used, was {was + 1}")
        self._receiver, self._compass = health.receiver, health.compass

    def _announce_status(self, health: Health) -> None:
        """Log each change of the status and of its foremost reason; tell the pilot what lasts."""
        status, reasons = health.status, health.reasons
        reason = next(iter(reasons)).name if reasons else ""
        if (status, reason) != (self._status, self._reason):
            words = ", ".join(reasons.values())
            _log.info(
                "Estimate is %s%s, was %s",
                status.name,
                f" ({words})" if words else "",
                self._status.name,
                extra=journal_fields("status", status.name.lower()),
            )
            if status != self._status:
                self._status_ns = self._now_ns
            self._status, self._reason = status, reason or ""
        self._tell_status(health)

    def _tell_status(self, health: Health) -> None:
        pilot, now_ns, words = self._pilot, self._now_ns, next(iter(health.reasons.values()), "")
        shown = pilot.shown("estimate")
        if now_ns < self._recovering_ns and health.status in _PASSING:
            return
        if health.status is Status.INVALID:
            text = "estimate invalid, not sent"
            pilot.on_state("estimate", "invalid", Severity.CRITICAL, text, now_ns, is_grave=True)
        elif health.status is Status.DEAD_RECKONING:
            text = f"{_cause(health)}, dead reckoning"
            pilot.on_state("estimate", "lost", Severity.WARNING, text, now_ns, is_grave=True)
        elif health.status is Status.DEGRADED:
            key = f"degraded {self._reason}"
            text = f"degraded: {words}" if words else "estimate degraded"
            pilot.on_state("estimate", key, Severity.NOTICE, text, now_ns)
        elif health.status is Status.OK and shown != "found again":
            if shown.startswith("degraded") and now_ns - self._status_ns < STEADY_NS:
                pilot.withdraw("estimate")
                return
            key = "found again" if shown in ("lost", "invalid", "rebooted") else "ok"
            text = "estimate OK"
            pilot.on_state("estimate", key, Severity.INFO, text, now_ns, is_end=True)

    def _announce_reset(self, health: Health) -> None:
        moved, reason = health.reset_delta, health.reset_reason
        sizes = math.hypot(*moved[:3]), math.hypot(*moved[3:6]), abs(moved[6])
        size = _size(*sizes)
        _log.warning(
            "Reset %d: %s; moved by %s of yaw",
            health.resets,
            reason,
            size,
            extra=journal_fields("reset", reason),
        )
        count, self._resets = health.resets - self._resets, health.resets
        if reason == "restart":
            return  # it was told as such
        if reason == "inertial gap":
            is_told = self._now_ns < self._recovering_ns
            self._recovering_ns = self._now_ns + RECOVERY_NS
            if is_told:
                return
        share, largest = _largest(*sizes)
        self._pilot.on_occurrence(
            f"reset {reason}",
            Severity.WARNING,
            _short(f"reset {size}, {reason}", f"reset {largest}, {reason}"),
            self._now_ns,
            many=f"{{}} resets up to {largest}, {reason}",
            size=share,
            count=max(count, 1),
        )

    def on_stream(self, stream: OdometryStream, *, is_sent: bool = True, now_ns: int = 0) -> None:
        """Announce a jump of ODOMETRY, and that it stops or comes again; once a second.

        ``is_sent`` is whether the autopilot gets what the stream lets through; of what it does not
        get there is nothing to announce.
        """
        self._now_ns = max(now_ns, self._now_ns)
        jumps, self._jumps = stream.jumps - self._jumps, stream.jumps
        if not is_sent:
            return
        if stream.jump is not None and jumps > 0:
            sizes = stream.jump.sizes
            size, (share, largest) = _size(*sizes), _largest(*sizes)
            what = "told by reset_counter" if stream.jump.is_told else "kept from the autopilot"
            _log.warning(
                "ODOMETRY jumps by %s of yaw: %s", size, what, extra=journal_fields("jump", what)
            )
            self._pilot.on_occurrence(
                "jump",
                Severity.WARNING,
                f"ODOMETRY jumps {size}",
                self._now_ns,
                many=f"ODOMETRY jumped {{}} times, up to {largest}",
                size=share,
                count=jumps,
            )
        if stream.silence == self._silence or stream.silence == WAITING:
            return
        if stream.silence:
            _log.warning(
                "No ODOMETRY: %s", stream.silence, extra=journal_fields("stream", "silent")
            )
            self._tell("stream", Severity.WARNING, f"no ODOMETRY: {stream.silence}")
        else:
            _log.info("ODOMETRY is sent again", extra=journal_fields("stream", "sent"))
            self._tell("stream", Severity.INFO, "ODOMETRY is sent again")
        self._silence = stream.silence
