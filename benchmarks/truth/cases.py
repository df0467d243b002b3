"""The named cases: a motion, and what is wrong with what was measured.

Each is a function of a seed's draws; its docstring is the sentence of the table.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.truth import paths
from benchmarks.truth.motion import Motion, fly
from benchmarks.truth.paths import DEG, Draw
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
CASES: dict[str, Case] = {}


def case(function: Case) -> Case:
    """Enter a function into the table of cases."""
    CASES[function.__name__.replace("_", "-")] = function
    return function


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


def generate(name: str, seed: int) -> Readings:
    """Return what was measured in a case; a seed is a flight."""
    return CASES[name](Draw(seed, name))


@case
def fig8(draw: Draw) -> Readings:
    """Figure-eights; nothing wrong."""
    return flown(draw, paths.figure_eights(draw), 120.0)


@case
def hover(draw: Draw) -> Readings:
    """Hover in gusts; nothing wrong."""
    return flown(draw, paths.hover(draw), 120.0)


@case
def outage_60(draw: Draw) -> Readings:
    """Figure-eights; no fix for about 60 s."""
    readings = flown(draw, paths.figure_eights(draw), 150.0)
    begin = draw.about(50.0)
    lose(readings, begin, begin + draw.about(60.0, 0.1))
    return readings


@case
def jump_80(draw: Draw) -> Readings:
    """Figure-eights; position about 80 m off for 10 s, velocity true."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    rows = during(readings.fixes.t, draw.about(60.0), draw.about(10.0))
    readings.fixes.pos_error_n[rows] += draw.about(80.0) * draw.level()
    return readings


@case
def slow_yaw(draw: Draw) -> Readings:
    """In place, turning at about 1 deg/s from the first row on."""
    rate = draw.about(1.0 * DEG) * draw.sign()
    return flown(draw, paths.resting(draw, lambda t: rate * t), 200.0)


def during(t: np.ndarray, begin: float, length: float) -> np.ndarray:
    """Return which times lie in an interval."""
    return (t >= begin) & (t < begin + length)


def lose(readings: Readings, begin: float, end: float) -> None:
    """Take the fixes of an interval away."""
    readings.fixes.is_lost |= during(readings.fixes.t, begin, end - begin)
