"""The sensors' samples of a motion: whole flights as columns, repeatable from a seed.

Each sensor draws from a generator of its own, so that a changed number of one leaves the noise of
the others as it was. Times are seconds since the start of the flight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from pygeomag import GeoMag

from ekf_companion.errors import part_of
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.config import (
    AirspeedConfig,
    BaroConfig,
    CompassConfig,
    FlowConfig,
    GnssConfig,
    ImuConfig,
    RangeFinderConfig,
    WheelConfig,
)
from sim_autopilot.truth import Trajectory, Truth

Value = TypeVar("Value", float, npt.NDArray[np.float64])

GAUSS_LEGENDRE = 4
"""Points per inertial interval: exact for polynomials up to degree 7."""
_CHUNK = 4096
"""Inertial samples evaluated at once: bounds the memory, changes no bit."""
_NANOTESLA = 1e-5
"""Gauss."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImuData:
    """Means over the intervals that end at ``t``."""

    t: Array
    gyro_b: Array
    """rad/s, shape (n, 3)."""
    accel_b: Array
    """m/s^2, shape (n, 3)."""
    gyro_bias_b: Array
    """The part of ``gyro_b`` that is slow error, rad/s."""
    accel_bias_b: Array
    """m/s^2."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GnssData:
    """Fixes of the antenna."""

    t: Array
    """Stamps, which are also when the fixes arrive; they were true ``delay`` before."""
    lat: Array
    """rad."""
    lon: Array
    """rad."""
    alt: Array
    """m."""
    vel_n: Array
    """m/s."""
    yaw: Array
    """rad; NaN without two antennas."""
    slow_n: Array
    """The slow part of the position's error, north, east, down, m, shape (n, 3)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MagData:
    """Samples of the magnetic field."""

    t: Array
    mag_b: Array
    """gauss, shape (n, 3)."""
    heading_error: Array
    """The slow error of a heading from it, rad."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BaroData:
    """Samples of the static pressure."""

    t: Array
    alt: Array
    """In the standard atmosphere, m."""
    pressure: Array
    """hPa."""
    drift: Array
    """The part of ``alt`` that is slow error, m."""


def generators(seed: int) -> dict[str, np.random.Generator]:
    """Return one generator for each source of noise; new ones are added at the end."""
    names = (
        "imu",
        "gnss",
        "compass",
        "baro",
        "estimate",
        "compass 2",
        "compass 3",
        "gnss 2",
        "range",
        "airspeed",
        "wheel",
        "flow",
        "imu 2",
        "imu 3",
    )
    sequences = np.random.SeedSequence(seed).spawn(len(names))
    return dict(zip(names, map(np.random.default_rng, sequences), strict=True))


def mean_imu(trajectory: Trajectory, t: Array, period: float) -> tuple[Array, Array]:
    """Return the means of body rate and specific force over the intervals that end at ``t``."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_LEGENDRE)
    gyro_b, accel_b = np.empty((len(t), 3)), np.empty((len(t), 3))
    for start in range(0, len(t), _CHUNK):
        ends = t[start : start + _CHUNK, None]
        truth = trajectory.at((ends + 0.5 * period * (nodes - 1.0)).ravel())
        for mean, values in ((gyro_b, truth.gyro_b), (accel_b, truth.accel_b)):
            values = values.reshape(-1, GAUSS_LEGENDRE, 3)
            mean[start : start + _CHUNK] = 0.5 * np.einsum("g,ngi->ni", weights, values)
    return gyro_b, accel_b


def imu(
    trajectory: Trajectory, config: ImuConfig, rng: np.random.Generator, t: Array, period: float
) -> ImuData:
    """Draw the inertial samples of the intervals that end at ``t``, each ``period`` long (s)."""
    gyro_b, accel_b = mean_imu(trajectory, t, period)
    start = rng.standard_normal((2, 3))
    white = rng.standard_normal((len(t), 6)) / np.sqrt(period)
    slow = rng.standard_normal((len(t), 6))
    gyro_slow = gauss_markov(slow[:, :3], period, config.gyro_bias_time)
    accel_slow = gauss_markov(slow[:, 3:], period, config.accel_bias_time)
    gyro_bias_b = config.gyro_bias_start * start[0] + config.gyro_bias_instability * gyro_slow
    accel_bias_b = config.accel_bias_start * start[1] + config.accel_bias_instability * accel_slow
    gyro_b += gyro_bias_b + config.gyro_noise * white[:, :3]
    accel_b += accel_bias_b + config.accel_noise * white[:, 3:]
    if 0.0 < config.lowpass * period < 0.5:
        gyro_b, accel_b = (_lowpass(x, config.lowpass * period) for x in (gyro_b, accel_b))
    return ImuData(
        t=t, gyro_b=gyro_b, accel_b=accel_b, gyro_bias_b=gyro_bias_b, accel_bias_b=accel_bias_b
    )


def gnss(
    trajectory: Trajectory, config: GnssConfig, rng: np.random.Generator, t: Array
) -> GnssData:
    """Draw the fixes that arrive at ``t``."""
    truth = trajectory.at(t - config.delay)
    lever_b = np.array(config.lever_arm)
    lever_n = so3.rotate(truth.q_nb, lever_b)
    swing_n = so3.rotate(truth.q_nb, np.cross(truth.rate_nb_b, lever_b))

    white = rng.standard_normal((len(t), 7))
    slow = gauss_markov(rng.standard_normal((len(t), 3)), 1.0 / config.rate, config.slow_time)
    slow_n = slow * [config.slow_h, config.slow_h, config.slow_v]
    error_n = white[:, :3] * [config.noise_h, config.noise_h, config.noise_v] + slow_n
    lat, lon, alt = trajectory.frame.to_geodetic(truth.pos_n + lever_n + error_n)
    yaw = so3.to_euler(truth.q_nb)[:, 2] + config.noise_yaw * white[:, 6]
    return GnssData(
        t=t,
        lat=lat,
        lon=lon,
        alt=alt,
        vel_n=truth.vel_n + swing_n + config.noise_vel * white[:, 3:6],
        yaw=so3.wrap(yaw) if config.yaw else np.full(len(t), np.nan),
        slow_n=slow_n,
    )


def compass(
    trajectory: Trajectory, config: CompassConfig, rng: np.random.Generator, t: Array
) -> MagData:
    """Draw the field in the body that arrives at ``t``, with hard iron, noise and slow error."""
    frame = trajectory.frame
    field_n = earth_field(frame.lat, frame.lon, frame.alt, config.year)
    truth = trajectory.at(t - config.delay)
    noise = config.noise_heading * float(np.hypot(field_n[0], field_n[1]))
    white = rng.standard_normal((len(t), 3))
    slow = gauss_markov(rng.standard_normal((len(t), 1)), 1.0 / config.rate, config.slow_time)
    heading_error = config.slow_heading * slow[:, 0]
    back = so3.exp(np.outer(-heading_error, [0.0, 0.0, 1.0]))
    mag_b = so3.rotate(so3.conjugate(truth.q_nb), so3.rotate(back, field_n))
    mag_b = mag_b + np.array(config.hard_iron) + noise * white
    return MagData(t=t, mag_b=mag_b, heading_error=heading_error)


def earth_field(lat: float, lon: float, alt: float, year: float) -> Array:
    """Return the World Magnetic Model's field at a place (rad, rad, m), n, gauss."""
    field = GeoMag().calculate(np.degrees(lat), np.degrees(lon), alt * 1e-3, year)
    return np.array([field.x, field.y, field.z]) * _NANOTESLA


def baro(
    trajectory: Trajectory, config: BaroConfig, rng: np.random.Generator, t: Array
) -> BaroData:
    """Draw the pressure at ``t``; the drift begins at a random value, like the weather."""
    slow = gauss_markov(rng.standard_normal((len(t), 1)), 1.0 / config.rate, config.drift_time)
    drift = config.drift * slow[:, 0]
    alt = trajectory.at(t).alt + drift + config.noise * rng.standard_normal(len(t))
    return BaroData(t=t, alt=alt, pressure=pressure(alt), drift=drift)


def ranges(config: RangeFinderConfig, white: Array, height: Array, q_nb: Array) -> Array:
    """Return what a range finder reads along the body's down axis over level ground, m.

    ``height`` is that of the vehicle above where it stood, m; what is out of range reads the limit.
    """
    upright = np.maximum(1.0 - 2.0 * (q_nb[:, 1] ** 2 + q_nb[:, 2] ** 2), 1e-3)
    found = (height + config.mounted) / upright + config.noise * white
    return np.asarray(np.clip(found, config.lowest, config.highest))


def airspeeds(config: AirspeedConfig, white: Array, truth: Truth, period: float) -> Array:
    """Return the indicated airspeeds of a motion, m/s: less than the true ones in thin air.

    Of the white noise, shape (n, 2), one column becomes gusts.
    """
    through_n = truth.vel_n - np.array([*config.wind, 0.0])
    density = (pressure(truth.alt) / 1013.25) ** (4.25588 / 5.25588)
    gusts = config.gust * gauss_markov(white[:, 1:], period, config.gust_time)[:, 0]
    indicated = (np.linalg.norm(through_n, axis=1) + gusts) * np.sqrt(density)
    return np.asarray(config.scale * indicated + config.noise * white[:, 0])


def wheel_distances(config: WheelConfig, white: Array, truth: Truth, period: float) -> Array:
    """Return the distances of a motion along the body's forward axis from its begin on, m."""
    ahead = so3.to_matrix(truth.q_nb)[:, :, 0]
    speed = np.sum(ahead * truth.vel_n, axis=1)
    return np.asarray(config.scale * np.cumsum(speed) * period + config.noise * white)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FlowData:
    """Means over the intervals that end at ``t``, by the axes of the body."""

    t: Array
    flow: Array
    """Rates of the ground across the image, rad/s, shape (n, 2)."""
    gyro: Array
    """Rates of the sensor, rad/s, shape (n, 2)."""
    quality: Array
    """From 0 to 1."""


def flow(
    trajectory: Trajectory,
    config: FlowConfig,
    mounted: float,
    rng: np.random.Generator,
    t: Array,
) -> FlowData:
    """Draw what an optical flow sensor says at ``t``, over level ground at home's height.

    ``mounted`` is its height above the ground while the vehicle stands, m. Where it cannot see, it
    says noise of quality 0.
    """
    scale = 1.0 + config.scale * rng.standard_normal()
    noise = config.noise * rng.standard_normal((len(t), 2))
    white = rng.standard_normal((len(t), 2))
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_LEGENDRE)
    seen, gyro = np.zeros((len(t), 2)), np.zeros((len(t), 2))
    for node, weight in zip(nodes.tolist(), weights.tolist(), strict=True):
        truth = trajectory.at(t + 0.5 * (node - 1.0) / config.rate)
        vel_b = so3.rotate(so3.conjugate(truth.q_nb), truth.vel_n)
        upright = np.maximum(1.0 - 2.0 * (truth.q_nb[:, 1] ** 2 + truth.q_nb[:, 2] ** 2), 1e-3)
        distance = np.maximum(trajectory_height(trajectory, truth.alt) + mounted, 0.01) / upright
        across = np.stack([-vel_b[:, 1], vel_b[:, 0]], axis=1) / distance[:, None]
        seen += 0.5 * weight * (scale * across + truth.rate_nb_b[:, :2])
        gyro += 0.5 * weight * truth.rate_nb_b[:, :2]
    height = trajectory_height(trajectory, trajectory.at(t).alt) + mounted
    is_seen = (height > config.lowest) & (height < config.highest)
    found = np.where(is_seen[:, None], seen + noise, white)
    return FlowData(t=t, flow=found, gyro=gyro, quality=np.where(is_seen, 0.9, 0.0))


def trajectory_height(trajectory: Trajectory, alt: Array) -> Array:
    """Return the height above home of an altitude, m."""
    return np.asarray(alt - trajectory.frame.alt)


def pressure(alt: Value) -> Value:
    """Return the pressure of the standard atmosphere at an altitude (m), hPa."""
    found: Value = 1013.25 * (1.0 - alt / 44330.769) ** 5.25588
    return found


def slow_errors(
    rng: np.random.Generator, count: int, sigmas: Array, period: float, correlation: float
) -> Array:
    """Draw a slow error per column, shape (count, len(sigmas)), like ``gauss_markov``.

    Drawn piece by piece, so that the white noise of an hour is never in memory at once.
    """
    found = np.empty((count, len(sigmas)))
    keep = np.exp(-period / correlation)
    state = np.zeros((1, len(sigmas)))
    for start in range(0, count, _CHUNK):
        white = rng.standard_normal((min(_CHUNK, count - start), len(sigmas)))
        drive = np.sqrt(1.0 - keep * keep) * white
        if not start:
            drive[0] = white[0]
        part, state = _scipy().lfilter([1.0], [1.0, -keep], drive, axis=0, zi=state)
        found[start : start + _CHUNK] = part * sigmas
    return found


def gauss_markov(white: Array, period: float, correlation: float) -> Array:
    """Filter unit white noise, shape (n, m), to a stationary process of unit variance."""
    keep = np.exp(-period / correlation)
    drive = np.sqrt(1.0 - keep * keep) * white
    if len(drive):
        drive[0] = white[0]
    return np.asarray(_scipy().lfilter([1.0], [1.0, -keep], drive, axis=0))


def _lowpass(samples: Array, corner: float) -> Array:
    """Filter like the autopilot; the corner is a part of the sampling rate."""
    signal = _scipy()
    b, a = signal.butter(2, 2.0 * corner)
    state = signal.lfilter_zi(b, a)[:, None] * samples[0]
    return np.asarray(signal.lfilter(b, a, samples, axis=0, zi=state)[0])


def _scipy() -> Any:
    """Return SciPy's digital filters, which only a generated flight needs."""
    with part_of("sim", "a generated flight"):
        from scipy import signal
    return signal
