"""The settings of a filter that knows the simulator's sensors: a test of its mathematics."""

from __future__ import annotations

import math

from ekf_companion.core.settings.settings import (
    BaroSettings,
    FilterSettings,
    GnssSettings,
    HeadingSettings,
    ImuSettings,
)
from ekf_companion.nav.magnetic import magnetic_field
from sim_autopilot.config import ImuConfig, SimConfig

ALMOST_NONE = 1e-4
"""In place of zero where a setting must be positive."""


def matched(
    config: SimConfig, delay_std: float = 0.0, hard_iron_std: float = ALMOST_NONE
) -> FilterSettings:
    """Return the settings that describe each sensor as the simulator makes it.

    A Gauss-Markov process of variance s^2 and correlation time T walks, over times much shorter
    than T, with a density of s sqrt(2 / T).

    Args:
        config: The simulator's numbers; ``imu.lowpass`` is not modelled.
        delay_std: One sigma of the receiver's delay about ``gnss.delay``, s.
        hard_iron_std: One sigma of the vehicle's own field, gauss.
    """
    gnss, compass, baro = config.gnss, config.compass, config.baro
    home = (math.radians(config.home.lat), math.radians(config.home.lon))
    _, dip, strength = magnetic_field(*home, compass.year)
    return FilterSettings(
        imu=_inertial(config.imu),
        gnss=GnssSettings(
            delay=gnss.delay,
            delay_std=delay_std,
            timing_std=0.0,
            velocity_slow_std=0.0,
            lever_arm=gnss.lever_arm,
            lever_arm_std=0.0,
            white_share=gnss.noise_h**2 / (gnss.noise_h**2 + gnss.slow_h**2),
            slow_time=gnss.slow_time,
            position_std=0.0,
            height_std=0.0,
            velocity_std=0.0,
        ),
        heading=HeadingSettings(
            year=compass.year,
            magnetometer_std=max(compass.slow_heading, ALMOST_NONE),
            hard_iron_std=hard_iron_std,
            hard_iron_walk=0.0,
            magnetometer_delay=0.0,
            magnetometer_noise=compass.noise_heading * strength * math.cos(dip),
            slow_time=compass.slow_time,
        ),
        baro=BaroSettings(std=baro.noise, walk=_walk(baro.drift, baro.drift_time), speed_walk=0.0),
    )


def _inertial(imu: ImuConfig) -> ImuSettings:
    return ImuSettings(
        gyro_noise=imu.gyro_noise,
        accel_noise=imu.accel_noise,
        gyro_bias_walk=_walk(imu.gyro_bias_instability, imu.gyro_bias_time),
        accel_bias_walk=_walk(imu.accel_bias_instability, imu.accel_bias_time),
        gyro_bias=math.hypot(imu.gyro_bias_start, imu.gyro_bias_instability),
        accel_bias=math.hypot(imu.accel_bias_start, imu.accel_bias_instability),
        learn_noise=False,
        lag=0.0,
        samples="mean",
    )


def _walk(sigma: float, correlation: float) -> float:
    return sigma * math.sqrt(2.0 / correlation)
