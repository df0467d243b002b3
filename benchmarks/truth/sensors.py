"""What the sensors of a consumer set read along a flight, with errors of known size.

Readings are arrays of a few named parts, so that a case can falsify them in place.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from pygeomag import GeoMag
from scipy.signal import lfilter

from benchmarks.truth import earth
from benchmarks.truth.earth import Array
from benchmarks.truth.motion import FINE, Flight, rotate, transpose

DEG = np.pi / 180.0
YEAR = 2026.0


@dataclass(slots=True, eq=False)
class Inertial:
    """Averages over the interval that ends at each time."""

    t: Array
    stamp: Array
    """What the log says instead of `t`, s."""
    gyro: Array
    accel: Array


@dataclass(slots=True, eq=False)
class Fixes:
    """A receiver's positions and velocities, as their errors and what it declares."""

    t: Array
    delay: float
    """From the time of validity to the stamp, s; not declared."""
    pos_error_n: Array
    vel_error_n: Array
    std_h: Array
    std_v: Array
    std_vel: Array
    is_lost: np.ndarray[tuple[int], np.dtype[np.bool_]]
    said: np.ndarray[tuple[int], np.dtype[np.int64]]
    """Which fix's numbers each says: its own, or an old one's."""
    lever_b: Array = field(default_factory=lambda: np.zeros(3))
    """From the inertial unit to the antenna, m."""


@dataclass(slots=True, eq=False)
class Source:
    """Readings of a source beside the usual sensors, by the columns of a log."""

    t: Array
    """When each becomes known, s."""
    stamp: Array
    """When it was true, as the log says, s."""
    columns: tuple[str, ...]
    values: Array
    """Shape (n, number of columns)."""


@dataclass(slots=True, eq=False)
class Readings:
    """All that was measured along a flight."""

    flight: Flight
    inertial: Inertial
    fixes: Fixes
    mag_t: Array
    """Empty where there is no magnetometer."""
    mag: Array
    """Gauss, body."""
    baro_t: Array
    baro: Array
    """Pressure height, m."""
    set_back: tuple[float, float] = (np.inf, 0.0)
    """When the log's clock is set back, and by how much, s."""
    sources: list[Source] = field(default_factory=list)
    settings: dict[str, Any] = field(default_factory=dict)
    """What is to be set of them, as in a configuration."""


def measure(
    flight: Flight,
    rng: np.random.Generator,
    *,
    imu_rate: int = 125,
    has_mag: bool = True,
    delay: float = 0.0,
) -> Readings:
    """Read all sensors along a flight."""
    duration = float(flight.t[-1])
    slow_t = np.arange(1, int(duration * 25) + 1) / 25.0
    mag_t = slow_t if has_mag else slow_t[:0]
    return Readings(
        flight=flight,
        inertial=_inertial(flight, rng, imu_rate),
        fixes=_fixes(np.arange(1, int(duration * 5) + 1) / 5.0, delay, rng),
        mag_t=mag_t,
        mag=_mag(flight, mag_t, rng),
        baro_t=slow_t,
        baro=_baro(flight, slow_t, rng),
    )


def _inertial(flight: Flight, rng: np.random.Generator, rate: int) -> Inertial:
    each = FINE // rate
    count = (len(flight.t) - 1) // each
    t = np.arange(1, count + 1) / rate

    def mean(increments: Array) -> Array:
        return np.asarray(increments[: count * each].reshape(count, each, 3).sum(axis=1) * rate)

    root = np.sqrt(rate)
    gyro = mean(flight.dtheta_b) + 0.5 * DEG * rng.standard_normal(3)
    gyro += 0.005 * DEG * root * rng.standard_normal((count, 3))
    gyro += gauss_markov(rng, (count, 3), 10.0 * DEG / 3600.0, 300.0, 1.0 / rate)
    accel = mean(flight.dvel_b) + 0.06 * rng.standard_normal(3)
    accel += 1.5e-3 * root * rng.standard_normal((count, 3))
    accel += gauss_markov(rng, (count, 3), 1e-3, 300.0, 1.0 / rate)
    return Inertial(t, t.copy(), gyro, accel)


def _fixes(t: Array, delay: float, rng: np.random.Generator) -> Fixes:
    shape, dt = (len(t), 3), 0.2
    level = np.array([1.0, 1.0, 0.0])
    white, slow = 0.5 * level + [0, 0, 0.8], 0.7 * level + [0, 0, 1.1]
    return Fixes(
        t=t,
        delay=delay,
        pos_error_n=white * rng.standard_normal(shape)
        + slow * gauss_markov(rng, shape, 1.0, 60.0, dt),
        vel_error_n=0.05 * rng.standard_normal(shape) + gauss_markov(rng, shape, 0.02, 20.0, dt),
        std_h=np.full(len(t), 0.86),
        std_v=np.full(len(t), 1.36),
        std_vel=np.full(len(t), 0.1),
        is_lost=np.zeros(len(t), dtype=np.bool_),
        said=np.arange(len(t)),
    )


def _mag(flight: Flight, t: Array, rng: np.random.Generator) -> Array:
    lat, lon, alt = earth.to_geodetic(flight.pos_e[0])
    field_n = magnetic_field(float(lat), float(lon), float(alt))
    C_bn = transpose(flight.C_nb[flight.index(t)])
    return C_bn @ field_n + 3e-3 * rng.standard_normal((len(t), 3))


@cache
def magnetic_field(lat: float, lon: float, alt: float) -> Array:
    """Return the field of the World Magnetic Model 2025, north, east, down, gauss."""
    model = GeoMag(coefficients_file="wmm/WMM_2025.COF")
    field = model.calculate(glat=lat / DEG, glon=lon / DEG, alt=alt / 1000.0, time=YEAR)
    return np.array([field.x, field.y, field.z]) * 1e-5


def _baro(flight: Flight, t: Array, rng: np.random.Generator) -> Array:
    alt = earth.to_geodetic(flight.pos_e[flight.index(t)])[2]
    drift = 0.02 * np.sqrt(0.04) * np.cumsum(rng.standard_normal(len(t)))
    return np.asarray(
        alt + 20.0 * rng.standard_normal() + drift + 0.15 * rng.standard_normal(len(t))
    )


def gauss_markov(
    rng: np.random.Generator, shape: tuple[int, int], std: float, time: float, dt: float
) -> Array:
    """Return first-order Gauss-Markov errors of one sigma and a correlation time, down columns."""
    keep = np.exp(-dt / time)
    drive = std * np.sqrt(1.0 - keep**2) * rng.standard_normal(shape)
    drive[0] /= np.sqrt(1.0 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0))


def antenna(flight: Flight, fixes: Fixes) -> tuple[Array, Array]:
    """Return ECEF positions and velocities n that the receiver gives, its errors included."""
    k = flight.index(fixes.t - fixes.delay)
    C_nb, C_en = flight.C_nb[k], flight.C_en[k]
    rate_b = flight.dtheta_b[np.minimum(k, len(flight.dtheta_b) - 1)] * FINE
    lever_n = C_nb @ fixes.lever_b + fixes.pos_error_n
    pos_e = flight.pos_e[k] + rotate(C_en, lever_n)
    spin_n = rotate(C_nb, np.cross(rate_b, fixes.lever_b))
    return pos_e, flight.vel_n[k] + spin_n + fixes.vel_error_n
