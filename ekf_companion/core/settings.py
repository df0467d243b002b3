"""The numbers that a user may turn, and their place in the kernel's parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from msgspec import Meta

Array = npt.NDArray[np.float64]
Auto = Literal["auto"]
Seconds = Annotated[float, Meta(ge=-1.0, le=1.0)]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]
Probability = Annotated[float, Meta(gt=0.5, lt=1.0)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Factor = Annotated[float, Meta(ge=-10.0, le=10.0)]
MatrixRow = tuple[Factor, Factor, Factor]


@dataclass(frozen=True, slots=True, kw_only=True)
class Habit:
    """How late, and how sampled, the stamps of an autopilot's family are."""

    gnss_delay: float
    """A fix is older than its stamp by this, s."""
    gnss_delay_std: float
    """One sigma of that, s: the filter estimates the rest."""
    imu_lag: float
    """An inertial sample says what was true this long before its stamp, s."""
    imu_samples: Literal["mean", "instant"]
    """What a sample is: the mean since the one before, or a reading at its time."""
    mag_delay: float
    """A magnetic field is older than its stamp by this, s."""
    keeps_bias: bool
    """The biases of what it sends are the sensors' own, and the same after a reboot in flight."""


HABITS = {
    # ArduPilot sends the IMU behind a 20 Hz low-pass of second order, read at the time of sending,
    # and stamps a fix on its arrival: both measured against its simulator's truth. With receivers
    # of its earlier years the delay was 0.2 s and more.
    # Its compass is late by 0.05 to 0.07 s; its own filter takes 0.06.
    "ardupilot": Habit(
        gnss_delay=0.085,
        gnss_delay_std=0.1,
        imu_lag=0.0115,
        imu_samples="instant",
        mag_delay=0.06,
        keeps_bias=True,
    ),
    # PX4 takes its own filter's biases off, which begin anew with it. It sends means and stamps a
    # fix on arrival: no delay in its simulator, 0.06 to 0.11 s with receivers.
    "px4": Habit(
        gnss_delay=0.05,
        gnss_delay_std=0.06,
        imu_lag=0.002,
        imu_samples="mean",
        mag_delay=0.0,
        keeps_bias=False,
    ),
    "unknown": Habit(
        gnss_delay=0.0,
        gnss_delay_std=0.05,
        imu_lag=0.0,
        imu_samples="mean",
        mag_delay=0.0,
        keeps_bias=False,
    ),
}
"""What ``auto`` means, by the autopilot's family."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuSettings:
    """The inertial sensor."""

    gyro_noise: Positive = 2e-3
    """White noise of the rate, rad/s per square root of Hz. Vibration counts in: PX4's EKF2 takes
    0.015 rad/s at 100 Hz, which is 1.5e-3."""
    accel_noise: Positive = 3e-2
    """White noise of the specific force, m/s^2 per square root of Hz (EKF2: 0.35 at 100 Hz)."""
    gyro_bias_walk: NotNegative = 5e-5
    """Random walk of the gyro bias, rad/s per square root of s."""
    accel_bias_walk: NotNegative = 5e-4
    """Random walk of the accelerometer bias, m/s^2 per square root of s."""
    gyro_bias: Positive = 0.02
    """One sigma of the gyro bias where no rest has shown it, rad/s."""
    accel_bias: Positive = 0.2
    """One sigma of the accelerometer bias at the start, m/s^2 (0.02 g: a MEMS over temperature)."""
    learn_noise: bool = True
    """Raise the white noise to what the differences between samples show."""
    lag: Seconds | Auto = "auto"
    """A sample says what was true this long before its stamp, s."""
    samples: Literal["auto", "mean", "instant"] = "auto"
    """What a sample is: the mean since the one before, or a reading at its time."""
    gap: Positive = 0.2
    """Longest silence to bridge as if nothing had been missed, s."""
    gap_reset: Positive = 1.0
    """Silence after which position, velocity and attitude begin anew with the next fixes, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssSettings:
    """The satellite receiver."""

    source: Literal["auto", "raw", "global"] = "auto"
    """``raw``: GPS_RAW_INT; ``global``: GLOBAL_POSITION_INT, the autopilot's own estimate, which is
    no independent measurement; ``auto``: the second only while the first is silent for 5 s."""
    delay: Seconds | Auto = "auto"
    """A fix is older than its stamp by this, s."""
    delay_std: Annotated[float, Meta(ge=0.0, le=0.5)] | Auto = "auto"
    """One sigma of the delay, s: the filter estimates the rest. 0: the delay is known."""
    timing_std: NotNegative = 0.02
    """One sigma of what a fix's stamp, and the receiver's own filter, leave of its time, s: counts
    by the acceleration for the velocity, by the velocity for the position."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Antenna from the inertial sensor: forward, right, down, m."""
    use_velocity: bool = True
    """Use the receiver's velocity beside its position."""
    white_share: Annotated[float, Meta(ge=0.01, le=1.0)] | Auto = "auto"
    """Share of the variance that the receiver states for its position that is white noise; the rest
    is an error that changes slowly. auto: learnt from the fixes."""
    slow_time: Positive = 100.0
    """Time constant of the slow error of its position, s."""
    position_std: NotNegative = 0.1
    """Least one sigma of the white noise of a horizontal axis, whatever the receiver claims, m."""
    height_std: NotNegative = 0.2
    """Least one sigma of that of the height, m."""
    velocity_std: NotNegative = 0.1
    """Least one sigma of the velocity per axis, m/s."""
    velocity_slow_std: NotNegative = 0.03
    """One sigma of the slow error of the velocity per axis, m/s: its integral drifts from the
    position's."""
    velocity_slow_time: Positive = 20.0
    """Time constant of that, s."""
    velocity_std_unknown: Positive = 0.3
    """One sigma of the velocity where the receiver does not say, m/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingSettings:
    """Where north comes from."""

    source: Literal["auto", "gnss", "magnetometer", "autopilot"] = "auto"
    """``auto``: the best that speaks: dual-antenna GNSS, magnetometer, autopilot's own."""
    declination: Annotated[float, Meta(ge=-3.2, le=3.2)] | Auto = "auto"
    """Of the magnetic field, rad, east positive; auto: World Magnetic Model at the fix."""
    year: Annotated[float, Meta(ge=2025.0, le=2030.0)] = 2026.0
    """For the World Magnetic Model, decimal year."""
    hard_iron: tuple[Gauss, Gauss, Gauss] = (0.0, 0.0, 0.0)
    """What the vehicle adds to the field: forward, right, down, gauss; taken off first."""
    soft_iron: tuple[MatrixRow, MatrixRow, MatrixRow] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    """What the rest is multiplied by, to be the Earth's field: three rows of a matrix."""
    magnetometer_std: Positive = 0.02
    """One sigma of the slow error of a compass heading beside hard iron, rad: declination, scale,
    mounting."""
    hard_iron_std: Positive = 0.01
    """One sigma per axis of the vehicle's own field that calibration leaves, gauss."""
    hard_iron_walk: NotNegative = 1e-4
    """Random walk of it, gauss per square root of s: currents."""
    magnetometer_delay: Seconds | Auto = "auto"
    """A magnetic field is older than its stamp by this, s."""
    magnetometer_noise: NotNegative = 0.01
    """White noise of the field, gauss; counts by the strength of its horizontal part."""
    field_strength: Positive = 0.25
    """Largest share by which the field may differ from the World Magnetic Model's strength; beyond,
    the magnetometer is disturbed or not calibrated, and no heading is taken from it."""
    field_dip: Positive = 0.26
    """Largest difference of its dip from the model's, rad."""
    heading_std: NotNegative = 0.02
    """Least one sigma of a heading from elsewhere, rad."""
    slow_time: Positive = 100.0
    """Time constant of the slow error of a compass or of the autopilot's heading, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BaroSettings:
    """The barometer: its height less ours is an offset that walks."""

    use: bool = True
    """Use the barometer at all."""
    std: Positive = 0.5
    """White noise of the pressure altitude, m."""
    walk: NotNegative = 0.05
    """Random walk of the offset, m per square root of s: weather, wind, temperature."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignSettings:
    """The start, and standing still."""

    time: Annotated[float, Meta(ge=0.2, le=30.0)] = 1.0
    """Length of a window of rest, or least stretch of motion, to level from, s."""
    rest_gyro: Positive = 0.05
    """Largest spread of the rate at rest, all axes together, rad/s."""
    rest_accel: Positive = 0.6
    """Largest spread of the specific force at rest, all axes together, m/s^2."""
    use_rest: bool = True
    """Take a vehicle that stands still as one: no velocity, and the gyro shows its bias. Never
    while the autopilot says that it flies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GateSettings:
    """Whom to believe, and for how long not to."""

    probability: Probability = 0.999999
    """Share of good measurements that a gate lets through."""
    soft_probability: Probability = 0.99
    """Share of good measurements that count in full; beyond, the further out the less."""
    timeout_position: Positive = 7.0
    """After so long without an accepted position the next one resets ours, s."""
    timeout_velocity: Positive = 7.0
    """Likewise for the velocity, s."""
    timeout_height: Positive = 5.0
    """Likewise for the height, s."""
    timeout_heading: Positive = 10.0
    """Likewise for the heading, s."""
    limit_position: Positive = 100.0
    """One sigma of the horizontal position beyond which the estimate is called invalid, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Everything that the estimator may be told."""

    imu: ImuSettings = field(default_factory=ImuSettings)
    gnss: GnssSettings = field(default_factory=GnssSettings)
    heading: HeadingSettings = field(default_factory=HeadingSettings)
    baro: BaroSettings = field(default_factory=BaroSettings)
    align: AlignSettings = field(default_factory=AlignSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    window: Annotated[float, Meta(ge=0.1, le=10.0)] = 2.0
    """How late a measurement may come and still take its place in time, s."""
