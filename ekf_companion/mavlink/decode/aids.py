"""Messages of the aids that declare themselves, each with the rate that it is asked for at."""

from __future__ import annotations

import math
from typing import ClassVar

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.preference import Preference
from ekf_companion.mavlink.frame import Frame
from ekf_companion.nav.held_reading import HeldReading
from ekf_companion.nav.measurements import (
    AirspeedSample,
    FlowSample,
    Kind,
    RangeSample,
    WheelSample,
)

DOWN = 25
"""MAV_SENSOR_ROTATION_PITCH_270."""
UNKNOWN_VARIANCE = (0, 255)
"""cm^2; ArduPilot sends 0, MAVLink means 255."""
UNHEALTHY, USING = 1, 2
"""AIRSPEED_SENSOR_FLAGS."""
DIFFERENTIAL_PRESSURE = 16
"""MAV_SYS_STATUS_SENSOR."""
LAST = 255
"""Rank of VFR_HUD, behind all sensors of their own."""
LONGEST_NS = 1_000_000_000
"""Between two distances of a wheel, of which a speed is made."""
INVALID = 1
"""Of signal_quality; 0: not known, 100: best."""
BEST = 255
"""Largest quality of optical flow; 0: nothing is seen."""


class Sensors:
    """Selects, of several sensors of a kind, the first that speaks."""

    def __init__(self) -> None:
        """Begin with none heard."""
        self._sources = Preference()
        self._ids: list[int] = []

    def admit(self, sensor: int, t_ns: int) -> bool:
        """Whether to use a sensor now, by its number and its own stamp."""
        if sensor not in self._ids:
            self._ids.append(sensor)
        return self._sources.admit(self._ids.index(sensor), t_ns)


class Reader:
    """Reads the message of one aid."""

    kind: ClassVar[Kind]
    """Of its measurements."""
    message: ClassVar[str]
    rate: ClassVar[float]
    """At which the message is asked for, Hz."""

    def __init__(self, context: Context) -> None:
        """Begin with nothing read."""
        self._context = context
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""

    def read(self, frame: Frame) -> Measurements:
        """Return the measurements of a frame of this message."""
        raise NotImplementedError


class RangeFinder(Reader):
    """Reads the distance to the ground; of several range finders, the first that speaks."""

    kind = Kind.RANGE
    message, rate = "DISTANCE_SENSOR", 10.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._sensors = Sensors()

    def read(self, frame: Frame) -> Measurements:
        """Read DISTANCE_SENSOR; what is at an end of its range is no distance."""
        m = unpack(frame)
        if m.orientation != DOWN:
            return []
        out, t_ns = self._context.follow_ms(m.time_boot_ms, self.message)
        if t_ns is None:
            return out
        if not m.min_distance < m.current_distance < m.max_distance or m.signal_quality == INVALID:
            self._context.refuse("range: out of the sensor's range")
            return out
        if self._sensors.admit(m.id, t_ns):
            is_known = m.covariance not in UNKNOWN_VARIANCE
            std = m.covariance**0.5 * 0.01 if is_known else None
            out.append(RangeSample(t_ns=t_ns, range=m.current_distance * 0.01, std=std))
        return out


class Airspeed(Reader):
    """Reads AIRSPEED, else VFR_HUD where SYS_STATUS says that there is a sensor.

    VFR_HUD holds the autopilot's own estimate where there is none: made of the fixes, and of
    sideslip that is assumed. Both are indicated airspeeds, without a stamp of their own.
    """

    kind = Kind.AIRSPEED
    message, rate = "AIRSPEED", 10.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._sources = Preference()
        self._ids: list[int] = []
        self._is_measured = False

    def read(self, frame: Frame) -> Measurements:
        """Read AIRSPEED; of several sensors the one that the autopilot uses, else the first."""
        m = unpack(frame)
        if m.flags & UNHEALTHY:
            return self._context.refuse("airspeed: its sensor is unhealthy")
        if m.id not in self._ids:
            self._ids.append(m.id)
        return self._sample(0 if m.flags & USING else 1 + self._ids.index(m.id), m.airspeed)

    def vfr_hud(self, frame: Frame) -> Measurements:
        """Read VFR_HUD."""
        return self._sample(LAST, unpack(frame).airspeed) if self._is_measured else []

    @property
    def source(self) -> str:
        """The message in use."""
        return "VFR_HUD" if self._sources.rank == LAST else self.message

    def sys_status(self, frame: Frame) -> Measurements:
        """Read from SYS_STATUS whether there is a sensor, which is used and healthy."""
        m = unpack(frame)
        self._is_measured = bool(
            m.onboard_control_sensors_present
            & m.onboard_control_sensors_enabled
            & m.onboard_control_sensors_health
            & DIFFERENTIAL_PRESSURE
        )
        return []

    def _sample(self, rank: int, airspeed: float) -> Measurements:
        t_ns = self._context.clock.latest_ns
        if t_ns is None or not self._sources.admit(rank, t_ns):
            return []
        return [AirspeedSample(t_ns=t_ns, airspeed=airspeed, is_indicated=True)]


class Wheel(Reader):
    """Reads the distances of the wheels: what all of them gain is a speed halfway."""

    kind = Kind.WHEEL
    message, rate = "WHEEL_DISTANCE", 10.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._last: tuple[int, list[float]] | None = None

    def read(self, frame: Frame) -> Measurements:
        """Read WHEEL_DISTANCE."""
        m = unpack(frame)
        out = self._context.follow_us(m.time_usec, self.message)
        if out is None or not 0 < m.count <= len(m.distance):
            return out or []
        now, before = (m.time_usec * 1000, list(m.distance[: m.count])), self._last
        self._last = now
        if before is None or len(before[1]) != m.count:
            return out
        span_ns = now[0] - before[0]
        if not 0 < span_ns < LONGEST_NS:
            return out
        gained = sum(b - a for a, b in zip(before[1], now[1], strict=True)) / m.count
        t_ns = before[0] + span_ns // 2
        return [*out, WheelSample(t_ns=t_ns, speed=gained / (span_ns * 1e-9))]


class OpticalFlowRad(Reader):
    """Reads the flow integrated over an interval, as PX4 sends it and sensors do."""

    kind = Kind.FLOW
    message, rate = "OPTICAL_FLOW_RAD", 20.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._sensors = Sensors()
        self._held = HeldReading()

    def read(self, frame: Frame) -> Measurements:
        """Read OPTICAL_FLOW_RAD: means over the interval, which count at its middle."""
        m = unpack(frame)
        out = self._context.follow_us(m.time_usec, self.message)
        if out is None:
            return []
        if not m.integration_time_us:
            self._context.refuse("optical flow: no interval")
            return out
        seconds = m.integration_time_us * 1e-6
        flow, gyro = (
            tuple(one / seconds for one in pair)
            for pair in (
                (m.integrated_x, m.integrated_y),
                (m.integrated_xgyro, m.integrated_ygyro),
            )
        )
        t_ns = m.time_usec * 1000
        if self._sensors.admit(m.sensor_id, t_ns):
            middle_ns = t_ns - m.integration_time_us * 500
            found = _flow(self._context, self._held, middle_ns, flow, gyro, m.quality)
            out += found
        return out


class OpticalFlow(Reader):
    """Reads the rates that ArduPilot sends; others fill this message with pixels."""

    kind = Kind.FLOW
    message, rate = "OPTICAL_FLOW", 20.0

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._held = HeldReading()

    def read(self, frame: Frame) -> Measurements:
        """Read OPTICAL_FLOW: its time is in ms, and the flow less the gyro stands as flow_comp_m.

        Source: ArduPilot, ``GCS_MAVLINK::send_opticalflow``.
        """
        m = unpack(frame)
        if self._context.family is not Family.ARDUPILOT:
            return self._context.refuse("optical flow: OPTICAL_FLOW in pixels")
        if m.time_usec >= 1 << 32:  # more ms than ArduPilot counts
            return self._context.refuse("optical flow: no time")
        out, t_ns = self._context.follow_ms(m.time_usec, self.message)
        if t_ns is not None:
            flow = m.flow_rate_x, m.flow_rate_y
            gyro = flow[0] - m.flow_comp_m_x, flow[1] - m.flow_comp_m_y
            out += _flow(self._context, self._held, t_ns, flow, gyro, m.quality)
        return out


def _flow(
    context: Context,
    held: HeldReading,
    t_ns: int,
    flow: tuple[float, ...],
    gyro: tuple[float, ...],
    quality: int,
) -> Measurements:
    """Return a flow that a sensor has seen; a quality of 0 is that of darkness, or of nothing."""
    if not quality or not all(map(math.isfinite, flow)):
        return context.refuse("optical flow: nothing seen")
    if held.is_held(t_ns, flow):
        return context.refuse("optical flow: frozen")
    known = all(map(math.isfinite, gyro))
    gyro_x, gyro_y = gyro if known else (None, None)
    x, y = flow
    share = quality / BEST
    return [FlowSample(t_ns=t_ns, flow_x=x, flow_y=y, gyro_x=gyro_x, gyro_y=gyro_y, quality=share)]


READERS: tuple[type[Reader], ...] = (RangeFinder, Airspeed, Wheel, OpticalFlowRad, OpticalFlow)
SOURCES = {
    kind: " or ".join(one.message for one in READERS if one.kind is kind)
    for kind in dict.fromkeys(one.kind for one in READERS)
} | dict.fromkeys((Kind.POSE, Kind.VELOCITY), "another component")
"""The messages of each, by kind; what others send is named by :mod:`.external`."""
RATES = {one.message: one.rate for one in READERS}
"""Hz, by message."""
