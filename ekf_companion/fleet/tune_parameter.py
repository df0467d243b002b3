"""The parameters that ``fleet tune`` finds, their ranges, and the configuration that has them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.nav.arrays import Array, Mask


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """A number that is tuned. Of a noise all but the range is of its natural logarithm."""

    name: str
    unit: str
    low: float
    """Least value; of a noise that a ground station may set, as there."""
    high: float
    begin: float
    """Where a search begins: it matters little, as each goes over the whole range."""
    step: float
    """Of the differences: the likelihood is rough below it, and a parabola within it."""
    sure: float
    """Largest half of a 95 % interval with which the flights show the parameter."""


DELAY, ARM, NOISES, VELOCITY_STD, GYRO_NOISE = 0, slice(1, 4), slice(4, 10), 6, 9
PARAMETERS = (
    Parameter(name="delay", unit="s", low=-0.2, high=0.6, begin=0.1, step=0.01, sure=0.05),
    *(
        Parameter(name=axis, unit="m", low=-5.0, high=5.0, begin=0.0, step=0.05, sure=0.15)
        for axis in ("forward", "right", "down")
    ),
    *(
        Parameter(name=name, unit=unit, low=low, high=high, begin=begin, step=0.1, sure=0.3)
        for name, unit, low, high, begin in (
            ("position_std", "m", 0.005, 50.0, 1.0),
            ("height_std", "m", 0.01, 50.0, 2.0),
            ("velocity_std", "m/s", 0.005, 10.0, 0.3),
            ("timing_std", "s", 1e-3, 0.3, 0.01),
            ("accel_noise", "m/s^2/sqrt(Hz)", 1e-4, 5.0, 0.1),
            ("gyro_noise", "rad/s/sqrt(Hz)", 1e-5, 0.1, 3e-3),
        )
    ),
)
"""Delay, lever arm (forward, right, down), noises, in the order of every array of parameters."""
WHITE_SHARE = 0.01
"""Share of the variance of a position that counts as white: the least that can be set, so that the
noise is the one that is tuned, and what a receiver states is its slow error."""
WALK = math.sqrt(0.007)
"""Of the configured walks of the biases while noise is tuned: the least that the filter takes in
flight, where fixes and samples agree. The whole, which is for a sensor that warms up, would pass
for a twentieth of the noise of the gyro."""
SCALE = np.array([0.3, *(1.0,) * 9])
"""Unit of each parameter in the search: 0.3 s of delay are as far as 1 m, or a factor e."""
LOW = np.array([p.low for p in PARAMETERS])
HIGH = np.array([p.high for p in PARAMETERS])
LOW[NOISES], HIGH[NOISES] = np.log(LOW[NOISES]), np.log(HIGH[NOISES])
BEGIN = np.array([p.begin for p in PARAMETERS])
BEGIN[NOISES] = np.log(BEGIN[NOISES])
STEPS = np.array([p.step for p in PARAMETERS])
SURE = np.array([p.sure for p in PARAMETERS])
N = len(PARAMETERS)


def to_theta(values: Array) -> Array:
    """Return parameters with the noises by their logarithm, as they are searched."""
    return np.concatenate([values[: NOISES.start], np.log(values[NOISES])])


def to_values(theta: Array) -> Array:
    """Return parameters with the noises as they are."""
    return np.concatenate([theta[: NOISES.start], np.exp(theta[NOISES])])


def known(config: Config, theta: Array) -> Config:
    """Return a configuration in which all parameters are known, and nothing is learnt."""
    position, height, velocity, timing, accel, gyro = np.exp(theta[NOISES]).tolist()
    gnss = replace(
        config.gnss,
        delay=float(theta[DELAY]),
        delay_std=0.0,
        lever_arm=tuple(theta[ARM].tolist()),
        lever_arm_std=0.0,
        white_share=WHITE_SHARE,
        position_std=position,
        height_std=height,
        velocity_std=velocity,
        timing_std=timing,
    )
    imu = replace(
        config.imu,
        learn_noise=False,
        accel_noise=accel,
        gyro_noise=gyro,
        accel_bias_walk=WALK * config.imu.accel_bias_walk,
        gyro_bias_walk=WALK * config.imu.gyro_bias_walk,
    )
    return replace(config, gnss=gnss, imu=imu, weigh_faults="off")


def tuned(
    config: Config, theta: Array, is_shown: Mask, std: tuple[float, float], *, learns: bool
) -> Config:
    """Return the configuration with parameters that were found; what is not shown stays.

    Args:
        config: What is configured.
        theta: The parameters, noises by their logarithm.
        is_shown: Which of them the flights show.
        std: One sigma of the delay, s, and of the lever arm, m.
        learns: Whether noise is learnt in flight, as configured; then inertial noise stays too.
    """
    new = known(config, theta)
    gnss, names = config.gnss, [p.name for p in PARAMETERS]
    changes: dict[str, object] = {
        name: getattr(new.gnss, name)
        for name, shown in zip(names[4:8], is_shown[4:8], strict=True)
        if shown
    }
    if is_shown[DELAY]:
        changes |= {"delay": new.gnss.delay, "delay_std": std[0]}
    if is_shown[ARM].any():
        arm = zip(new.gnss.lever_arm, gnss.lever_arm, is_shown[ARM], strict=True)
        changes["lever_arm"] = tuple(found if shown else was for found, was, shown in arm)
    if is_shown[ARM].all():
        changes["lever_arm_std"] = std[1]
    imu = config.imu
    if not learns:
        changes["white_share"] = WHITE_SHARE
        noises = {n: getattr(new.imu, n) for n, s in zip(names[8:], is_shown[8:], strict=True) if s}
        imu = replace(imu, learn_noise=False, **noises)
    return replace(config, gnss=replace(gnss, **changes), imu=imu)  # type: ignore[arg-type]


def configured(config: Config, delay: float) -> Array:
    """Return the parameters of a configuration, as near as they may be."""
    gnss, imu = config.gnss, config.imu
    noises = [gnss.position_std, gnss.height_std, gnss.velocity_std, gnss.timing_std]
    noises += [imu.accel_noise, imu.gyro_noise]
    floor = np.log(np.maximum(noises, 1e-9))
    theta: Array = np.clip(np.array([delay, *gnss.lever_arm, *floor]), LOW, HIGH)
    return theta
