"""A session and a pipeline joined: bytes in, bytes out, no socket and no clock.

The service runs it live and the converter over a recorded .tlog. What is sent is decided by the
stamps of the inertial samples, so both send the same.
"""

from __future__ import annotations

import logging
from collections.abc import Hashable
from functools import partial

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, TimesyncConfig
from ekf_companion.engine.announcer import Bulletin
from ekf_companion.engine.checkpoint import Clocks, Vehicle
from ekf_companion.engine.health import Arrival
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.engine.publisher import (
    STREAMS,
    Publisher,
    default_rate,
    largest_rate,
    smallest_rate,
)
from ekf_companion.engine.tuning import Tuning, parameters
from ekf_companion.engine.warm_start import Resumption
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.clock import TimesyncOptions
from ekf_companion.mavlink.commands import Stream
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import SystemStatus
from ekf_companion.mavlink.event import IntervalSet, ParameterSet, PeerFound
from ekf_companion.mavlink.guard import GuardOptions
from ekf_companion.mavlink.session import RATES, Session, SessionOptions
from ekf_companion.mavlink.signing import Signing
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.measurements import ImuSample, Measurement
from ekf_companion.nav.state import Status

_log = logging.getLogger(__name__)

UNFED_NS = 2 * SECOND_NS
"""Without an inertial sample for so long, our heartbeat says no more how the last estimate was."""
SILENCE_NS = 10 * SECOND_NS
"""Without an autopilot for so long, a human should look: it sends its heartbeat once a second."""


def session_options(
    config: Config, is_recording: bool, expected: Vehicle | None = None
) -> SessionOptions:
    """Give a session what the configuration says of the link, and whom it may expect there."""
    link = config.link
    return SessionOptions(
        system_id=link.system_id,
        component_id=link.component_id,
        autopilot_system_id=link.autopilot,
        allow_systems=link.allow_systems,
        allow_components=link.allow_components,
        accept_unsigned=config.signing.accept_unsigned,
        rates=_rates(link),
        expected=None if expected is None else PeerFound(*expected[1:], Family(expected.family)),
        is_recording=is_recording,
        parameters=parameters(config),
        timesync=_timesync_options(config.timesync),
        guard=guard_options(config),
    )


def _rates(link: LinkConfig) -> dict[str, float]:
    return {
        **RATES,
        "HIGHRES_IMU": link.imu_rate,
        "GPS_RAW_INT": link.gnss_rate,
        "ATTITUDE": link.heading_rate,
        "SCALED_PRESSURE": link.baro_rate,
    }


def _timesync_options(timesync: TimesyncConfig) -> TimesyncOptions:
    return TimesyncOptions(
        respond=timesync.respond,
        request=timesync.request,
        largest_rtt_ms=timesync.largest_rtt * 1e3,
    )


def guard_options(config: Config) -> GuardOptions:
    """Give the guard what the configuration says of ODOMETRY."""
    odometry = config.output.odometry
    return GuardOptions(mode=odometry.mode, independent=odometry.independent)


class Companion:
    """One vehicle's estimator on one link."""

    def __init__(
        self,
        config: Config,
        is_recording: bool = False,
        resumption: Resumption | None = None,
        signing: Signing | None = None,
        tuning: Tuning | None = None,
    ) -> None:
        self.tuning = tuning or Tuning(config)
        self._config = self.tuning.config
        self._resumption = resumption or Resumption()
        self._vehicle: Vehicle | None = None
        self._has_sample = False
        self.reloads = 0
        """How often the configuration was read again."""
        self.last_reload = ""
        """What became of it the last time."""
        options = session_options(self._config, is_recording, self._resumption.expected)
        self.session = Session(options, signing)
        self.pipeline: Pipeline | None = None
        self._publisher: Publisher | None = None
        self._bulletin = Bulletin(self.session.statustext)
        self._family = Family.UNKNOWN
        self._begin_ns: int | None = None
        self._estimated_ns: int | None = None
        self._bytes = 0
        self._has_complained = False
        self._offer()

    def receive(self, data: bytes, now_ns: int, sender: Hashable = None) -> None:
        """Take bytes read at a time of ours; what follows from them waits in ``data_to_send``.

        ``sender`` tells apart who sends datagrams to one socket.
        """
        self._bytes += len(data)
        for measurements in self.session.steps(data, now_ns, sender):
            self._heed_events(now_ns)
            for measurement in measurements:
                self._process(measurement, now_ns)

    def tick(self, now_ns: int) -> None:
        """Do what time brings: heartbeats, requests, time-outs."""
        self.session.tick(now_ns)
        self._heed_events(now_ns)
        self._bulletin.tick(now_ns)
        self._complain(now_ns)
        if self._estimated_ns is not None and now_ns - self._estimated_ns > UNFED_NS:
            self._estimated_ns = None
            self.session.set_state(encode.SYSTEM_STATUS[Status.INIT], Status.INIT)

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
        if self.pipeline.process(measurement) is not Arrival.ESTIMATED:
            return
        self._estimated_ns = now_ns
        health = self._publisher.publish(lambda name, payload: self._send(name, payload, now_ns))
        if health is not None:
            self._bulletin.report(health, self.session.decoder.imu_source)
            self.session.set_state(encode.SYSTEM_STATUS[health.status], health.status)

    def _send(self, name: str, payload: bytes, now_ns: int) -> None:
        """Send a message; an ODOMETRY that must not be sent is only recorded."""
        if name == "ODOMETRY" and not self.session.may_stream:
            self.session.note(name, payload, now_ns)
        else:
            self.session.send(name, payload, now_ns)

    def _begin(self, peer: PeerFound) -> None:
        """Begin to estimate, or anew where it is another autopilot, or of another family."""
        vehicle = Vehicle(peer.family.value, peer.system_id, peer.component_id)
        if vehicle == self._vehicle:
            return
        self._vehicle = vehicle
        self.pipeline = Pipeline(self._config, peer.family.value)
        self._publisher = Publisher(self._config, self.pipeline, peer.family)
        self._family = peer.family
        self._offer()
        for warning in self._publisher.label.warnings:
            _log.warning("%s", warning)
        self._resumption.meet(vehicle, self.pipeline, self.session.decoder)
        self._bulletin.begin()

    def _complain(self, now_ns: int) -> None:
        """Say once that no autopilot has been heard, and what to look at."""
        if self.pipeline is not None or self._has_complained:
            return
        if self._begin_ns is None:
            self._begin_ns = now_ns
        if now_ns - self._begin_ns < SILENCE_NS:
            return
        self._has_complained = True
        if refused := self.session.admission.refused:
            why, count = refused.most_common(1)[0]
            _log.warning(
                "No heartbeat of an autopilot was let in: %d frames: %s; see docs/LINK.md",
                count,
                why,
            )
        elif self._bytes:
            _log.warning(
                "No heartbeat of an autopilot in %d bytes; check the baud rate and link.autopilot",
                self._bytes,
            )
        else:
            _log.warning("Nothing heard for 10 s; check the wire, the port and the autopilot's")

    def _heed_events(self, now_ns: int) -> None:
        for event in self.session.events():
            self._bulletin.heed(event, now_ns)
            match event:
                case PeerFound():
                    self._begin(event)
                case ParameterSet(key=key, value=value):
                    self._tune(self.tuning.set(key, value))
                case IntervalSet(message, rate) if self._publisher is not None:
                    self._publisher.set_rate(message, rate)

    def reload(self, read: Config | str) -> str:
        """Take from a new configuration what can be taken in flight; give what became of it.

        ``read`` may also say why there is none: all then stays as it was.
        """
        self.reloads += 1
        if isinstance(read, str):
            self.last_reload = f"{read}; all stays as it was"
        else:
            self.last_reload = str(self.tuning.reload(read))
            self._tune(self.tuning.config)
        return self.last_reload

    def _tune(self, config: Config) -> None:
        """Go on with what somebody has turned."""
        self._config = config
        if self.pipeline is not None:
            self.pipeline.retune(config)
        self.session.timesync.options = _timesync_options(config.timesync)
        self.session.requests.retune(_rates(config.link))
        self.session.guard.retune(guard_options(config))
        self.session.parameters.retune(parameters(config))
        self._offer()

    def _offer(self) -> None:
        """Say what may be asked for, and send each at the rate that counts."""
        commands = self.session.commands
        for name in STREAMS:
            stream = Stream(
                rate=default_rate(name, self._config, self._family),
                smallest=smallest_rate(name),
                largest=largest_rate(name, self._family),
                request=partial(self._ask, name),
            )
            commands.offer(name, stream)
            if self._publisher is not None:
                self._publisher.set_rate(name, commands.rate(name))

    def _ask(self, name: str) -> bool:
        may = self.session.may_stream or name != "ODOMETRY"
        return may and self._publisher is not None and self._publisher.ask(name)
