"""Every number that can be turned, with its unit, and the YAML that may say otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import yaml

from ekf_companion.errors import ConfigError


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuConfig:
    """A good MEMS unit of an autopilot, as calibrated by it (ICM-42688 class, vibration added)."""

    rate: float = 250.0
    """Samples, Hz; the period is rounded to whole microseconds."""
    gyro_noise: float = 3.0e-4
    """White noise density, rad/s/sqrt(Hz)."""
    gyro_bias_instability: float = 5.0e-5
    """One sigma of the bias that wanders, rad/s."""
    gyro_bias_time: float = 300.0
    """Correlation time of it, s."""
    gyro_bias_start: float = 5.0e-3
    """One sigma of the constant bias per axis, rad/s."""
    accel_noise: float = 3.0e-3
    """White noise density, m/s^2/sqrt(Hz)."""
    accel_bias_instability: float = 2.0e-3
    """One sigma of the bias that wanders, m/s^2."""
    accel_bias_time: float = 300.0
    """Correlation time of it, s."""
    accel_bias_start: float = 3.0e-2
    """One sigma of the constant bias per axis, m/s^2."""
    lowpass: float = 0.0
    """Corner of the second-order low-pass that the autopilot applies, Hz; 0: none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssConfig:
    """A single-frequency receiver."""

    rate: float = 5.0
    """Fixes, Hz."""
    noise_h: float = 1.0
    """One sigma of the white error per horizontal axis, m."""
    noise_v: float = 1.5
    """One sigma of the white error of the altitude, m."""
    slow_h: float = 0.0
    """One sigma of the slow error per horizontal axis, m."""
    slow_v: float = 0.0
    """One sigma of the slow error of the altitude, m."""
    slow_time: float = 100.0
    """Correlation time of the slow errors, s."""
    noise_vel: float = 0.1
    """One sigma of the velocity per axis, m/s."""
    delay: float = 0.12
    """The fix is so much older than its stamp, s; it is sent at its stamp."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Antenna from the inertial unit, forward, right, down, m."""
    yaw: bool = False
    """The receiver has two antennas and reports the heading of the nose."""
    noise_yaw: float = math.radians(2.0)
    """One sigma of it, rad."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CompassConfig:
    """A magnetometer in the field of the World Magnetic Model."""

    rate: float = 50.0
    """Samples, Hz."""
    noise_heading: float = math.radians(2.0)
    """One sigma of the heading that one level sample gives, rad: sets the noise of each axis."""
    hard_iron: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """What the vehicle adds, forward, right, down, gauss."""
    year: float = 2026.0
    """Epoch of the model."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaroConfig:
    """A barometer in the standard atmosphere."""

    rate: float = 25.0
    """Samples, Hz."""
    noise: float = 0.1
    """One sigma of the white error, m of altitude."""
    drift: float = 0.5
    """One sigma of the slow error, m of altitude."""
    drift_time: float = 300.0
    """Correlation time of it, s."""
    temperature: float = 38.0
    """Of the board, degrees Celsius."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimateConfig:
    """How far the autopilot's own estimate is from the truth: slow errors, one sigma."""

    tilt: float = math.radians(0.3)
    """Roll and pitch, rad."""
    yaw: float = math.radians(1.0)
    """rad."""
    position: float = 0.3
    """Per axis, m."""
    velocity: float = 0.05
    """Per axis, m/s."""
    time: float = 20.0
    """Correlation time of all of them, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamConfig:
    """Rates of the messages until somebody asks for another, Hz; 0: not sent."""

    HIGHRES_IMU: float = 1000.0
    """At most the inertial unit's rate."""
    GPS_RAW_INT: float = 1000.0
    """At most the receiver's rate."""
    ATTITUDE: float = 50.0
    GLOBAL_POSITION_INT: float = 10.0
    LOCAL_POSITION_NED: float = 10.0
    SIM_STATE: float = 25.0
    SYSTEM_TIME: float = 1.0
    EXTENDED_SYS_STATE: float = 2.0
    GPS_GLOBAL_ORIGIN: float = 1.0
    HEARTBEAT: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class HomeConfig:
    """Where and when the flight starts."""

    lat: float = 47.397742
    """degrees."""
    lon: float = 8.545594
    """degrees."""
    alt: float = 488.0
    """Above mean sea level, m."""
    boot: float = 20.0
    """Time since the autopilot's start, s."""
    unix: float = 1780000000.0
    """Time since 1970 at the autopilot's start, s: what a .tlog counts in."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimConfig:
    """All of it."""

    system_id: int = 1
    home: HomeConfig = field(default_factory=HomeConfig)
    imu: ImuConfig = field(default_factory=ImuConfig)
    gnss: GnssConfig = field(default_factory=GnssConfig)
    compass: CompassConfig = field(default_factory=CompassConfig)
    baro: BaroConfig = field(default_factory=BaroConfig)
    estimate: EstimateConfig = field(default_factory=EstimateConfig)
    streams: StreamConfig = field(default_factory=StreamConfig)
    parameters: dict[str, float] = field(default_factory=dict)
    """Parameters of the autopilot beside, or instead of, those that its kind has."""


def load(path: Path | None) -> SimConfig:
    """Read a YAML file that says what differs from the defaults; None: the defaults.

    Raises:
        ConfigError: The file cannot be read, or has a key or a value that cannot be meant.
    """
    if path is None:
        return SimConfig()
    try:
        content: Any = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    except (OSError, yaml.YAMLError) as error:
        raise ConfigError(f"{path}: {error}") from error
    _refuse_unknown(path, content, SimConfig(), "")
    try:
        return msgspec.convert(content, SimConfig)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {error}") from error


def _refuse_unknown(path: Path, content: Any, known: Any, where: str) -> None:
    names = getattr(type(known), "__dataclass_fields__", None)
    if names is None or not isinstance(content, dict):
        return
    for key, value in content.items():
        if key not in names:
            raise ConfigError(f"{path}: {where}{key}: unknown key; known are {', '.join(names)}")
        _refuse_unknown(path, value, getattr(known, key), f"{where}{key}.")
