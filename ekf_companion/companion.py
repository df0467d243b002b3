"""A session and a pipeline joined: bytes in, bytes out, no socket and no clock.

The service runs it live and the converter over a recorded .tlog. What is sent is decided by the
stamps of the inertial samples, so both send the same.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from ekf_companion.checkpoint import Clocks, Vehicle
from ekf_companion.config import Config
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.clock import TimesyncOptions
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import EstimatorHealth, EstimatorType, StatusFlag, SystemStatus
from ekf_companion.mavlink.session import (
    RATES,
    Answered,
    Noted,
    PeerFound,
    PeerLost,
    Rebooted,
    Session,
    SessionOptions,
)
from ekf_companion.nav.measurements import ImuSample, Measurement
from ekf_companion.nav.state import Status
from ekf_companion.pipeline import Aid, Arrival, Health, Pipeline
from ekf_companion.resumption import Resumption

_log = logging.getLogger(__name__)

_SECOND_NS = 1_000_000_000
SILENCE_NS = 10 * _SECOND_NS
"""Without an autopilot for so long, a human should look: it sends its heartbeat once a second."""
DECIMATED = 80.0
"""Inertial samples below this rate miss what a multicopter does, Hz."""


class Due:
    """Says when something periodic is due, by the stamps of what drives it."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(_SECOND_NS / rate)
        self._next_ns: int | None = None

    def is_due(self, t_ns: int) -> bool:
        """Whether a period has passed; a stamp far from the plan makes a new plan."""
        if self._next_ns is not None and 0 < self._next_ns - t_ns <= self._period_ns:
            return False
        if self._next_ns is None or abs(t_ns - self._next_ns) > self._period_ns:
            self._next_ns = t_ns
        self._next_ns += self._period_ns
        return True


class Publisher:
    """Turns a pipeline's estimates into messages, each at its rate."""

    def __init__(self, config: Config, pipeline: Pipeline, family: Family) -> None:
        self._pipeline = pipeline
        self._odometry = Due(config.output.odometry.rate)
        self._status = Due(1.0)
        self._frame = encode.Frame[config.output.odometry.frame]
        chosen = config.output.odometry.estimator_type
        self._type = encode.estimator_type(family) if chosen == "auto" else EstimatorType[chosen]
        self._was_invalid = False
        self._last = Status.INIT
        self._is_decimated = False
        self._resets = 0

    def publish(self, send: Callable[[str, bytes], None]) -> Status:
        """Send what is due at the newest sample's stamp; give the status of the estimate."""
        t_ns = self._pipeline.stamp_ns
        if self._odometry.is_due(t_ns):
            self._publish_odometry(send)
        if self._status.is_due(t_ns):
            self._publish_status(send, t_ns)
        return self._last

    def _publish_odometry(self, send: Callable[[str, bytes], None]) -> None:
        odometry = self._pipeline.odometry()
        if odometry is None:
            return
        # An invalid estimate is said to be so once, and then not sent
        is_invalid = odometry.quality < 0
        if not (is_invalid and self._was_invalid):
            send("ODOMETRY", encode.odometry(odometry, frame=self._frame, estimator=self._type))
        self._was_invalid = is_invalid

    def _publish_status(self, send: Callable[[str, bytes], None], t_ns: int) -> None:
        health = self._pipeline.health()
        self._report(health)
        origin = self._pipeline.origin
        if origin is None:
            return
        send("ESTIMATOR_STATUS", encode.estimator_status(_judge(health, t_ns)))
        send("GPS_GLOBAL_ORIGIN", encode.gps_global_origin(*origin, t_ns=t_ns))

    def _report(self, health: Health) -> None:
        """Log what has changed."""
        if health.resets != self._resets:
            moved = health.reset_delta
            _log.warning(
                "Reset %d: %s; moved by %.1f m, %.1f m/s, %.0f deg of yaw",
                health.resets,
                health.reset_reason,
                math.hypot(*moved[:3]),
                math.hypot(*moved[3:6]),
                math.degrees(moved[6]),
            )
            self._resets = health.resets
        if 0.0 < health.imu_rate < DECIMATED and not self._is_decimated:
            _log.warning(
                "Inertial samples come at %.0f Hz: fast motion is missed, so the noise is taken "
                "for larger; ask for %.0f Hz or more",
                health.imu_rate,
                DECIMATED,
            )
        self._is_decimated = 0.0 < health.imu_rate < DECIMATED
        if health.status != self._last:
            _log.info("Estimate is %s, was %s", health.status.name, self._last.name)
            self._last = health.status


def _judge(health: Health, t_ns: int) -> EstimatorHealth:
    """Say the filter's health in the words of ESTIMATOR_STATUS."""
    flags = StatusFlag.ATTITUDE | StatusFlag.VELOCITY_HORIZ | StatusFlag.VELOCITY_VERT
    flags |= StatusFlag.POS_HORIZ_REL | StatusFlag.POS_HORIZ_ABS | StatusFlag.POS_VERT_ABS
    if health.status == Status.DEAD_RECKONING:
        flags &= ~StatusFlag.POS_HORIZ_ABS
        flags |= StatusFlag.PRED_POS_HORIZ_REL
    elif health.status == Status.INVALID:
        flags = StatusFlag.ATTITUDE
    if max(health.ratios[Aid.POSITION], health.ratios[Aid.VELOCITY]) > 1.0:
        flags |= StatusFlag.GPS_GLITCH
    return EstimatorHealth(
        t_ns=t_ns,
        flags=flags,
        vel_ratio=math.sqrt(health.ratios[Aid.VELOCITY]),
        pos_horiz_ratio=math.sqrt(health.ratios[Aid.POSITION]),
        pos_vert_ratio=math.sqrt(health.ratios[Aid.HEIGHT]),
        heading_ratio=math.sqrt(health.ratios[Aid.HEADING]),
        std_horiz=health.std_horizontal,
        std_vert=health.std_vertical,
    )


def session_options(
    config: Config, is_recording: bool, expected: Vehicle | None = None
) -> SessionOptions:
    """Give a session what the configuration says of the link, and whom it may expect there."""
    link, timesync = config.link, config.timesync
    rates = dict(RATES)
    rates["HIGHRES_IMU"] = link.imu_rate
    rates["GPS_RAW_INT"] = link.gnss_rate
    rates["ATTITUDE"] = link.heading_rate
    rates["SCALED_PRESSURE"] = link.baro_rate
    return SessionOptions(
        system_id=link.system_id,
        component_id=link.component_id,
        autopilot_system_id=link.autopilot,
        rates=rates,
        expected=None if expected is None else PeerFound(*expected[1:], Family(expected.family)),
        is_recording=is_recording,
        timesync=TimesyncOptions(
            respond=timesync.respond,
            request=timesync.request,
            largest_rtt_ms=timesync.largest_rtt * 1e3,
        ),
    )


class Companion:
    """One vehicle's estimator on one link."""

    def __init__(
        self, config: Config, is_recording: bool = False, resumption: Resumption | None = None
    ) -> None:
        self._config = config
        self._resumption = resumption or Resumption()
        self._expected = self._resumption.expected
        self._has_sample = False
        self.session = Session(session_options(config, is_recording, self._expected))
        self.pipeline: Pipeline | None = None
        self._publisher: Publisher | None = None
        self._begin_ns: int | None = None
        self._bytes = 0
        self._has_complained = False

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes read at a time of ours; what follows from them waits in ``data_to_send``."""
        self._bytes += len(data)
        for measurement in self.session.receive(data, now_ns):
            self._heed_events()
            self._process(measurement, now_ns)
        self._heed_events()

    def tick(self, now_ns: int) -> None:
        """Do what time brings: heartbeats, requests, time-outs."""
        self.session.tick(now_ns)
        self._heed_events()
        self._complain(now_ns)

    def data_to_send(self) -> list[bytes]:
        """Give what is to be sent, and forget it."""
        return self.session.data_to_send()

    def checkpoint(self, clocks: Clocks) -> bytes | None:
        """Give what a restart could go on from; None: nothing has been estimated yet."""
        if self.pipeline is None:
            return None
        return self._resumption.take(self.pipeline, self.session.decoder, clocks)

    @property
    def resets(self) -> int:
        """How often the estimate has jumped on purpose."""
        return 0 if self.pipeline is None else self.pipeline.resets

    def close(self, now_ns: int) -> None:
        """Say goodbye in a last heartbeat."""
        self.session.set_state(SystemStatus.POWEROFF)
        self.session.send("HEARTBEAT", encode.heartbeat(SystemStatus.POWEROFF), now_ns)

    def _process(self, measurement: Measurement, now_ns: int) -> None:
        if self.pipeline is None or self._publisher is None:
            return
        if not self._has_sample and isinstance(measurement, ImuSample):
            self._has_sample = True
            self._resumption.resume(self.pipeline, measurement.t_ns, now_ns)
        if self.pipeline.process(measurement) is Arrival.ESTIMATED:
            status = self._publisher.publish(
                lambda name, payload: self.session.send(name, payload, now_ns)
            )
            self.session.set_state(encode.SYSTEM_STATUS[status])

    def _begin(self, peer: PeerFound) -> None:
        """Begin to estimate, or anew where the autopilot is not of the family expected."""
        vehicle = Vehicle(peer.family.value, peer.system_id, peer.component_id)
        if self.pipeline is not None and self._expected in (None, vehicle):
            return
        self.pipeline = Pipeline(self._config, peer.family.value)
        self._publisher = Publisher(self._config, self.pipeline, peer.family)
        self._resumption.meet(vehicle, self.pipeline, self.session.decoder)
        if self._expected != vehicle:
            self._expected = None

    def _complain(self, now_ns: int) -> None:
        """Say once that no autopilot has been heard, and what to look at."""
        if self.pipeline is not None or self._has_complained:
            return
        if self._begin_ns is None:
            self._begin_ns = now_ns
        if now_ns - self._begin_ns < SILENCE_NS:
            return
        self._has_complained = True
        if self._bytes:
            _log.warning(
                "No heartbeat of an autopilot in %d bytes; check the baud rate and link.autopilot",
                self._bytes,
            )
        else:
            _log.warning("Nothing heard for 10 s; check the wire, the port and the autopilot's")

    def _heed_events(self) -> None:
        for event in self.session.events():
            if isinstance(event, PeerFound):
                _log.info(
                    "Autopilot found: system %d, component %d, %s",
                    event.system_id,
                    event.component_id,
                    event.family.value,
                )
                self._begin(event)
            elif isinstance(event, PeerLost):
                _log.warning("Autopilot lost: no heartbeat for 5 s; check the link")
            elif isinstance(event, Rebooted):
                _log.warning("Autopilot rebooted: its clock began anew, and so does the estimate")
            elif isinstance(event, Noted):
                _log.warning("%s", event.text)
            elif isinstance(event, Answered):
                _log.info("Request for %s: %s", event.message, event.result)
