"""Every number of the simulation, with its unit, and the YAML that overrides the defaults."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import msgspec

from ekf_companion.errors import ConfigError
from ekf_companion.yaml_file import read_yaml

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]

_DEGREE = math.pi / 180.0
"""rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuConfig:
    """A good MEMS unit of an autopilot, as calibrated by it (ICM-42688 class, vibration added)."""

    rate: Positive = 250.0
    """Samples, Hz; the period is rounded to whole microseconds."""
    gyro_noise: NotNegative = 3.0e-4
    """White noise density, rad/s/sqrt(Hz)."""
    gyro_bias_instability: NotNegative = 5.0e-5
    """One sigma of the slow part of the bias, rad/s."""
    gyro_bias_time: Positive = 300.0
    """Correlation time of it, s."""
    gyro_bias_start: NotNegative = 5.0e-3
    """One sigma of the constant bias per axis, rad/s."""
    accel_noise: NotNegative = 3.0e-3
    """White noise density, m/s^2/sqrt(Hz)."""
    accel_bias_instability: NotNegative = 2.0e-3
    """One sigma of the slow part of the bias, m/s^2."""
    accel_bias_time: Positive = 300.0
    """Correlation time of it, s."""
    accel_bias_start: NotNegative = 3.0e-2
    """One sigma of the constant bias per axis, m/s^2."""
    lowpass: NotNegative = 0.0
    """Corner of the second-order low-pass that the autopilot applies, Hz; 0, or half
    the rate and above: none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssConfig:
    """A single-frequency receiver."""

    rate: Positive = 5.0
    """Fixes, Hz."""
    noise_h: NotNegative = 1.0
    """One sigma of the white error per horizontal axis, m."""
    noise_v: NotNegative = 1.5
    """One sigma of the white error of the altitude, m."""
    slow_h: NotNegative = 0.0
    """One sigma of the slow error per horizontal axis, m."""
    slow_v: NotNegative = 0.0
    """One sigma of the slow error of the altitude, m."""
    slow_time: Positive = 100.0
    """Correlation time of the slow errors, s."""
    noise_vel: NotNegative = 0.1
    """One sigma of the velocity per axis, m/s."""
    delay: NotNegative = 0.12
    """The fix is so much older than its stamp, s; it is sent at its stamp."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Antenna from the inertial unit, forward, right, down, m."""
    yaw: bool = False
    """The receiver has two antennas and reports the heading of the nose."""
    noise_yaw: NotNegative = 2.0 * _DEGREE
    """One sigma of it, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompassConfig:
    """A magnetometer in the field of the World Magnetic Model."""

    rate: Positive = 50.0
    """Samples, Hz."""
    noise_heading: NotNegative = 2.0 * _DEGREE
    """One sigma of the heading of one level sample, rad: sets the noise of each axis."""
    slow_heading: NotNegative = 0.0
    """One sigma of a slow error of the heading, rad: the rest after a calibration."""
    slow_time: Positive = 100.0
    """Correlation time of it, s."""
    delay: NotNegative = 0.0
    """A sample is so much older than its stamp, s."""
    hard_iron: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The vehicle's own field, forward, right, down, gauss."""
    year: Annotated[float, msgspec.Meta(ge=2025.0, lt=2030.0)] = 2026.0
    """Date, for the model of 2025 to 2030."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpareConfig:
    """Sensors beside the first of their kind; faults act on the first, unless they say all."""

    compasses: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0
    """Magnetometers, as good as the first, in SCALED_IMU2 and SCALED_IMU3."""
    hard_iron: NotNegative = 0.03
    """One sigma of what the calibration of each leaves, per axis, gauss: assumed."""
    receivers: Annotated[int, msgspec.Meta(ge=0, le=1)] = 0
    """Receivers, as good as the first, with an antenna in its place: GPS2_RAW."""
    units: Annotated[int, msgspec.Meta(ge=0, le=2)] = 0
    """Inertial units, as good as the first: in SCALED_IMU2 and SCALED_IMU3 too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaroConfig:
    """A barometer in the standard atmosphere."""

    rate: Positive = 25.0
    """Samples, Hz."""
    noise: NotNegative = 0.1
    """One sigma of the white error, m of altitude."""
    drift: NotNegative = 0.5
    """One sigma of the slow error, m of altitude."""
    drift_time: Positive = 300.0
    """Correlation time of it, s."""
    temperature: float = 38.0
    """Of the board, degrees Celsius."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinderConfig:
    """A range finder that looks down at level ground, which home stands on."""

    fitted: bool = False
    """Whether there is one: DISTANCE_SENSOR, once it is asked for."""
    noise: NotNegative = 0.05
    """One sigma of the white error, m."""
    lowest: Positive = 0.1
    """m."""
    highest: Positive = 40.0
    """m."""
    mounted: Positive = 0.15
    """Above the ground while the vehicle stands, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AirspeedConfig:
    """A pitot tube of a fixed wing, and the wind that it flies in."""

    fitted: bool = False
    """Whether there is one: AIRSPEED, once it is asked for."""
    noise: NotNegative = 0.3
    """One sigma of the white error, m/s."""
    gust: NotNegative = 0.6
    """One sigma of the gusts along the flight, m/s: with the noise what an airspeed leaves of the
    motion in two recorded flights, in winds of 1 and 5 m/s."""
    gust_time: Positive = 0.6
    """Correlation time of them, s, likewise."""
    scale: Positive = 1.0
    """Airspeed that is read over the indicated one."""
    delay: NotNegative = 0.25
    """A sample is so much older than its message, s: ArduPilot's, measured."""
    wind: tuple[float, float] = (0.0, 0.0)
    """Where the air moves to, north and east, m/s; a fixed wing crabs in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelConfig:
    """Encoders of a ground vehicle's wheels."""

    fitted: bool = False
    """Whether there are any: WHEEL_DISTANCE, once it is asked for."""
    noise: NotNegative = 0.002
    """One sigma of the white error of a distance, m: 1000 ticks a turn."""
    scale: Positive = 1.0
    """Distance that is read over the true one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowConfig:
    """An optical flow sensor that looks down at the ground of the range finder."""

    fitted: bool = False
    """Whether there is one: OPTICAL_FLOW_RAD (PX4) or OPTICAL_FLOW (ArduPilot), once it is asked
    for."""
    rate: Positive = 10.0
    """Readings, Hz; each is the mean over the interval before it."""
    noise: NotNegative = 0.05
    """One sigma of the white error of a rate, rad/s: a PX4FLOW on a quadrotor, measured."""
    scale: NotNegative = 0.05
    """One sigma of the scale, drawn once: of the focal length."""
    lowest: Positive = 0.3
    """Height below which it is out of focus and sees nothing, m."""
    highest: Positive = 40.0
    """Height above which the ground has no texture any more, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateConfig:
    """Errors of the autopilot's own estimate: slow, one sigma."""

    tilt: NotNegative = 0.3 * _DEGREE
    """Roll and pitch, rad."""
    yaw: NotNegative = 1.0 * _DEGREE
    """rad."""
    position: NotNegative = 0.3
    """Per axis, m."""
    velocity: NotNegative = 0.05
    """Per axis, m/s."""
    time: Positive = 20.0
    """Correlation time of all of them, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamConfig:
    """Rates of the messages until others are requested, Hz; 0: not sent."""

    HIGHRES_IMU: NotNegative = 1000.0
    """At most the inertial unit's rate."""
    GPS_RAW_INT: NotNegative = 1000.0
    """At most the receiver's rate."""
    ATTITUDE: NotNegative = 50.0
    GLOBAL_POSITION_INT: NotNegative = 10.0
    LOCAL_POSITION_NED: NotNegative = 10.0
    SIM_STATE: NotNegative = 25.0
    SYSTEM_TIME: NotNegative = 1.0
    EXTENDED_SYS_STATE: NotNegative = 2.0
    GPS_GLOBAL_ORIGIN: NotNegative = 1.0
    HEARTBEAT: NotNegative = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HomeConfig:
    """Where and when the flight starts."""

    lat: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)] = 47.397742
    """degrees."""
    lon: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = 8.545594
    """degrees."""
    alt: float = 488.0
    """Above mean sea level, m."""
    boot: NotNegative = 20.0
    """Time since the autopilot's start, s."""
    unix: NotNegative = 1780000000.0
    """Time since 1970 at the autopilot's start, s: of the stamps of a .tlog."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimConfig:
    """All numbers."""

    system_id: Annotated[int, msgspec.Meta(ge=1, le=255)] = 1
    home: HomeConfig = field(default_factory=HomeConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    gnss: GnssConfig = field(default_factory=GnssConfig)
    compass: CompassConfig = field(default_factory=CompassConfig)
    baro: BaroConfig = field(default_factory=BaroConfig)
    spare: SpareConfig = field(default_factory=SpareConfig)
    range_finder: RangeFinderConfig = field(default_factory=RangeFinderConfig)
    airspeed: AirspeedConfig = field(default_factory=AirspeedConfig)
    wheel: WheelConfig = field(default_factory=WheelConfig)
    flow: FlowConfig = field(default_factory=FlowConfig)
    estimate: EstimateConfig = field(default_factory=EstimateConfig)
    streams: StreamConfig = field(default_factory=StreamConfig)
    parameters: dict[str, float] = field(default_factory=dict)
    """Parameters of the autopilot, added to its own or instead of them."""


def load(path: Path | None) -> SimConfig:
    """Read a YAML file with what differs from the defaults; None: the defaults.

    Raises:
        ConfigError: The file cannot be read, or has an unknown key or an invalid value.
    """
    if path is None:
        return SimConfig()
    content = read_yaml(path, is_watched=False)
    _refuse_unknown(path, content, SimConfig(), "")
    try:
        return msgspec.convert(content, SimConfig)
    except msgspec.ValidationError as error:
        words, _, key = str(error).replace("`", "").partition(" - at $.")
        words = words.replace("object", "table").replace("array", "list")
        where = key or "the file"
        raise ConfigError(f"{path}: {where}: {words[0].lower()}{words[1:]}") from error


def _refuse_unknown(path: Path, content: Any, known: Any, where: str) -> None:
    names = getattr(type(known), "__dataclass_fields__", None)
    if names is None or not isinstance(content, dict):
        return
    for key, value in content.items():
        if key not in names:
            raise ConfigError(f"{path}: {where}{key}: unknown key; known are {', '.join(names)}")
        _refuse_unknown(path, value, getattr(known, key), f"{where}{key}.")
