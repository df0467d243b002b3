"""The kernel's numbers, from the user's settings and the autopilot's family."""

import dataclasses
import math
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.enums import SLOW_ERRORS, Aid
from ekf_companion.core.memory.parameters import PARAMETERS, Parameters
from ekf_companion.core.settings.faults import FAULTS
from ekf_companion.core.settings.settings import HABITS, FilterSettings
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Kind

SET_STD = 0.02
"""One sigma of a delay that somebody has set in the autopilot's parameters, s."""


def parameters(
    settings: FilterSettings, family: str, gnss_delay: float | None = None
) -> npt.NDArray[np.float64]:
    """Return the settings as the kernel reads them: :class:`Parameters`, shape (PARAMETERS,).

    Args:
        settings: The user's.
        family: ``px4``, ``ardupilot`` or ``unknown``: settles what is ``auto``.
        gnss_delay: Delay of the receiver that the log itself declares, s.
    """
    habit = HABITS[family]
    imu, gnss, heading, gate = settings.imu, settings.gnss, settings.heading, settings.gate
    numbers = np.zeros(PARAMETERS)
    k: Any = Parameters.from_buffer(numbers)  # type: ignore[attr-defined]
    k.gyro_noise, k.accel_noise = imu.gyro_noise, imu.accel_noise
    k.gyro_bias_walk, k.accel_bias_walk = imu.gyro_bias_walk, imu.accel_bias_walk
    k.gyro_bias_std, k.accel_bias_std = imu.gyro_bias, imu.accel_bias
    k.learn_noise = imu.learn_noise
    k.mean_samples = has_mean_samples(settings, family)
    k.lag = imu_lag(settings, family)
    k.gap, k.gap_reset = imu.gap, imu.gap_reset

    k.lever_arm_b[:] = gnss.lever_arm
    k.lever_var = gnss.lever_arm_std**2
    k.gnss_delay = configured_delay(settings, family, gnss_delay)
    k.delay_std = gnss_delay_std(settings, family, gnss_delay)
    k.told_delay_std = told_delay_std(settings)
    k.unset_delay = habit.unset_gnss_delay
    k.use_velocity = gnss.use_velocity
    k.use_derived = ("raw", "auto", "global").index(gnss.source)
    k.gnss_floor[:] = gnss.position_std, gnss.height_std, gnss.velocity_std
    k.gnss_vel_slow_std = gnss.velocity_slow_std
    k.gnss_vel_offset_time = gnss.velocity_slow_time
    k.timing_std = gnss.timing_std
    k.lag_std = gnss.velocity_lag_std
    k.gnss_offset_time = gnss.slow_time
    k.white_share = math.nan if gnss.white_share == "auto" else gnss.white_share
    k.vel_std_default = gnss.velocity_std_unknown

    k.vehicle = ("auto", "fixed_wing", "rotary", "ground", "other").index(settings.vehicle)
    k.heading = ("auto", "gnss", "magnetometer", "autopilot").index(heading.source)
    k.mag_std, k.mag_noise = heading.magnetometer_std, heading.magnetometer_noise
    k.iron_std, k.iron_walk = heading.hard_iron_std, heading.hard_iron_walk
    k.field_strength, k.field_dip = heading.field_strength, heading.field_dip
    k.heading_time, k.heading_floor = heading.slow_time, heading.heading_std

    for one in DECLARED:
        own, numbers_of = getattr(settings, one.name), k.aid[Aid[one.name.upper()]]
        numbers_of.use, numbers_of.std = own.use, own.std
        numbers_of.stuck_after, numbers_of.patience = one.stuck_after, one.patience
        numbers_of.yields, numbers_of.is_tried = one.yields, one.is_tried
        errors = one.slow_errors.values()
        known = {"use", "std"}
        for walk in ("walk", "speed_walk", "climb_walk"):
            names = [getattr(error, walk) for error in errors]
            found = [getattr(own, name) if name else 0.0 for name in names]
            getattr(numbers_of, walk)[: len(found)] = found
            known |= {*names}
        rest = [getattr(own, f.name) for f in dataclasses.fields(own) if f.name not in known]
        told = (math.nan if one == "auto" else one for one in rest)
        flat = np.hstack([[], *(one for one in told if is_number(one))])
        numbers_of.own[: len(flat)] = flat
        numbers_of.error, numbers_of.errors = SLOW_ERRORS.get(one.name, 0), len(one.slow_errors)
        numbers_of.parts = one.parts
        numbers_of.shows = 2.0 if one.shows_position else float(one.shows_velocity)
    k.align_time, k.use_rest = settings.align.time, settings.align.use_rest
    k.rest_gyro, k.rest_accel = settings.align.rest_gyro, settings.align.rest_accel
    k.gate[:] = [chi_square_quantile(gate.probability, dof) for dof in (1, 2, 3)]
    k.soft_gate[:] = [chi_square_quantile(gate.soft_probability, dof) for dof in (1, 2, 3)]
    k.timeout_pos, k.timeout_vel = gate.timeout_position, gate.timeout_velocity
    k.timeout_height, k.timeout_heading = gate.timeout_height, gate.timeout_heading
    k.limit_pos = gate.limit_position
    k.gravity = STANDARD_GRAVITY
    k.keeps_bias = habit.keeps_bias
    k.weighs_faults = ("off", "report", "act").index(settings.weigh_faults)
    k.risk = settings.integrity.risk
    for fault, prior in FAULTS.items():
        of = k.fault[fault]
        of.rows, of.std, of.tail, of.rate = prior.rows, prior.std, prior.tail, prior.rate
        of.every, of.shows, of.source = prior.every, prior.shows, prior.source
    return numbers


def is_number(value: object) -> bool:
    """Return whether the kernel takes a setting as it is: a number, or some of them."""
    return np.ndim(value) < 2 and not isinstance(value, str)  # type: ignore[arg-type]


def imu_lag(settings: FilterSettings, family: str) -> float:
    """Return how long before its stamp an inertial sample was true, s."""
    lag = settings.imu.lag
    return HABITS[family].imu_lag if lag == "auto" else lag


def has_mean_samples(settings: FilterSettings, family: str) -> bool:
    """Return whether an inertial sample is the mean since the one before."""
    samples = settings.imu.samples
    return (HABITS[family].imu_samples if samples == "auto" else samples) == "mean"


def gnss_delay_std(settings: FilterSettings, family: str, gnss_delay: float | None) -> float:
    """Return one sigma of the receiver's delay, s: less where somebody has set the delay."""
    gnss = settings.gnss
    if gnss.delay_std != "auto":
        return gnss.delay_std
    habit = HABITS[family]
    is_set = gnss_delay is not None and not math.isclose(gnss_delay, habit.unset_gnss_delay)
    return SET_STD if gnss.delay == "auto" and is_set else habit.gnss_delay_std


def told_delay_std(settings: FilterSettings) -> float:
    """Return one sigma of a delay that the autopilot tells, s; negative: that does not count."""
    gnss = settings.gnss
    if gnss.delay != "auto":
        return -1.0
    return SET_STD if gnss.delay_std == "auto" else gnss.delay_std


def configured_delay(settings: FilterSettings, family: str, gnss_delay: float | None) -> float:
    """Return by how much fixes are taken to be older than their stamps, s."""
    delay = settings.gnss.delay
    if delay != "auto":
        return delay
    return HABITS[family].gnss_delay if gnss_delay is None else gnss_delay


def delays_ns(
    settings: FilterSettings, family: str, gnss_delay: float | None = None
) -> npt.NDArray[np.int64]:
    """Return how late the stamps of each kind are, ns, shape (kinds,).

    Args:
        settings: The user's.
        family: Settles what is ``auto``.
        gnss_delay: Delay of the receiver that the log itself declares, s; beats ``auto``.
    """
    late = np.zeros(len(Kind), dtype=np.int64)
    late[Kind.GNSS] = round(configured_delay(settings, family, gnss_delay) * 1e9)
    late[Kind.IMU] = round(imu_lag(settings, family) * 1e9)
    for one in DECLARED:
        delay = getattr(getattr(settings, one.name), "delay", 0.0)
        late[one.kind] = round((HABITS[family].airspeed_delay if delay == "auto" else delay) * 1e9)
    mag = settings.heading.magnetometer_delay
    late[Kind.MAG] = round((HABITS[family].mag_delay if mag == "auto" else mag) * 1e9)
    return late


def chi_square_quantile(probability: float, dof: int) -> float:
    """Return the chi-square value that a share of the probability stays below, dof 1, 2 or 3.

    Source: the closed forms of the distribution function, e.g. Abramowitz and Stegun 26.4.
    """
    if dof == 1:
        return NormalDist().inv_cdf(0.5 + 0.5 * probability) ** 2
    if dof == 2:
        return -2.0 * math.log1p(-probability)
    low, high = 0.0, 200.0
    for _ in range(100):
        middle = 0.5 * (low + high)
        below = math.erf(math.sqrt(0.5 * middle)) - math.sqrt(2.0 * middle / math.pi) * math.exp(
            -0.5 * middle
        )
        low, high = (middle, high) if below < probability else (low, middle)
    return 0.5 * (low + high)
