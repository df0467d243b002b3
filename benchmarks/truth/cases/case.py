"""What cases are made of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from benchmarks.truth.draw import DEG, TURN, Draw, ramp
from benchmarks.truth.earth import Array
from benchmarks.truth.motion import Motion, fly
from benchmarks.truth.sensors import Readings, measure

PLACES = (
    (47.4, 8.5, 500.0),
    (-33.9, 151.2, 20.0),
    (39.7, -105.0, 1600.0),
    (1.35, 103.8, 10.0),
    (-17.8, 179.9995, 30.0),
    (64.1, -21.9, 50.0),
)
"""Latitude, longitude (deg) and height; one of them is on the date line."""
Case = Callable[[Draw], Readings]


def flown(
    draw: Draw,
    motion: Motion,
    duration: float,
    *,
    imu_rate: int = 125,
    has_mag: bool = True,
    delay: float = 0.0,
) -> Readings:
    """Measure a motion at a drawn place."""
    lat, lon, alt = PLACES[draw.rng.integers(len(PLACES))]
    flight = fly(motion, duration, (lat * DEG, lon * DEG, alt))
    return measure(flight, draw.rng, imu_rate=imu_rate, has_mag=has_mag, delay=delay)


def during(t: Array, begin: float, length: float) -> npt.NDArray[np.bool_]:
    """Return which times lie in an interval."""
    return (t >= begin) & (t < begin + length)


def lose(readings: Readings, begin: float, length: float) -> None:
    """Take the fixes of an interval away."""
    readings.fixes.is_lost |= during(readings.fixes.t, begin, length)


def shift(readings: Readings, begin: float, length: float, by_n: Array) -> None:
    """Move the receiver's positions of an interval; its velocities stay true."""
    readings.fixes.pos_error_n[during(readings.fixes.t, begin, length)] += by_n


def away_and_back(draw: Draw, t: Array) -> Array:
    """Return a rise from 0 to 1 within about 60 s from about 40 s on, and a fall in as long."""
    begin, length = draw.about(40.0), draw.about(60.0)
    return ramp(t, begin, length) - ramp(t, begin + length, length)


def thin_baro(readings: Readings, step: int) -> None:
    """Keep one of ``step`` readings of the barometer, which has 25 Hz."""
    readings.baro_t, readings.baro = readings.baro_t[::step], readings.baro[::step]


def end_baro(readings: Readings, end: float) -> None:
    """Remove the barometer's readings from a time on."""
    kept = readings.baro_t < end
    readings.baro_t, readings.baro = readings.baro_t[kept], readings.baro[kept]


def shake(draw: Draw, readings: Readings, accel: float, gyro: float) -> None:
    """Add waves of about 0.4 Hz (m/s^2, rad/s), a frequency that wanders by 1 Hz."""
    t = readings.inertial.t
    rate = draw.about(0.4) + draw.wander(1.0, 60.0, 10.0)(t)
    phase = TURN * np.cumsum(rate) * (t[1] - t[0])
    for size, values in ((accel, readings.inertial.accel), (gyro, readings.inertial.gyro)):
        values += draw.about(size) * np.sin(phase[:, None] + draw.rng.uniform(0.0, TURN, 3))


def climbing(draw: Draw, motion: Motion, begin: float, length: float, by: float) -> Readings:
    """Measure a motion for 120 s; for a while the receiver's vertical velocity is off."""
    readings = flown(draw, motion, 120.0)
    rows = during(readings.fixes.t, draw.about(begin), draw.about(length))
    readings.fixes.vel_error_n[rows, 2] += draw.about(by) * draw.sign()
    return readings
