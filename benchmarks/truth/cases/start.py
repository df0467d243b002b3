"""The log begins while the vehicle turns, rocks, drifts or flies, or without a heading."""

from __future__ import annotations

import numpy as np

from benchmarks.truth import paths
from benchmarks.truth.cases.case import Case, flown
from benchmarks.truth.draw import DEG, Draw, ramped
from benchmarks.truth.earth import Array
from benchmarks.truth.sensors import Readings

AIRBORNE = -100.0
"""Motions that began long before the log, s."""


def slow_yaw(draw: Draw) -> Readings:
    """In place, turning at about 1 deg/s from the first row on."""
    rate = draw.about(1.0 * DEG) * draw.sign()
    return flown(draw, paths.resting(draw, lambda t: rate * t), 200.0)


def slow_then_rest(draw: Draw) -> Readings:
    """In place, turning at about 4 deg/s for about 8 s, then at rest."""
    rate, stop = draw.about(4.0 * DEG) * draw.sign(), draw.about(8.0)
    motion = paths.resting(draw, lambda t: rate * (t - ramped(t, stop, 1.5)))
    return flown(draw, motion, 120.0)


def boat(draw: Draw) -> Readings:
    """On a rocking deck for 40 s, then take-off and figure-eights."""
    return flown(draw, paths.boat(draw), 100.0)


def quiet_drift(draw: Draw) -> Readings:
    """At rest for about 10 s, then a level drift at about 0.3 m/s without any turn."""
    return _drifting(draw, draw.level())


def quiet_climb(draw: Draw) -> Readings:
    """At rest for about 10 s, then a climb at about 0.3 m/s without any turn."""
    return _drifting(draw, np.array([0.0, 0.0, -1.0]))


def _drifting(draw: Draw, way: Array) -> Readings:
    begin, velocity = draw.about(10.0), draw.about(0.3) * way
    motion = paths.resting(draw, drift=lambda t: np.outer(ramped(t, begin, 2.0), velocity))
    return flown(draw, motion, 90.0)


def straight_then_turns(draw: Draw) -> Readings:
    """In the air from the first row, straight and level at 20 m/s; S-turns from about 45 s."""
    return flown(draw, paths.straight_then_turns(draw, draw.about(45.0)), 120.0)


def straight_then_turns_no_heading(draw: Draw) -> Readings:
    """The same without a magnetometer or a heading."""
    motion = paths.straight_then_turns(draw, draw.about(45.0))
    return flown(draw, motion, 120.0, has_mag=False)


def moving_start(draw: Draw) -> Readings:
    """The log begins in the middle of fast figure-eights (about 14 s)."""
    return flown(draw, paths.figure_eights(draw, draw.about(14.0, 0.1), AIRBORNE), 90.0)


def moving_start_late_fixes(draw: Draw) -> Readings:
    """The same, with fixes about 0.12 s late, with the stamp of their arrival."""
    motion = paths.figure_eights(draw, draw.about(14.0, 0.1), AIRBORNE)
    return flown(draw, motion, 90.0, delay=draw.about(0.12))


def car_no_heading(draw: Draw) -> Readings:
    """A car without a heading: at rest, gains about 11 m/s in 8 s straight ahead; bends later."""
    motion = paths.car(draw, draw.about(11.0), draw.about(8.0))
    return flown(draw, motion, 110.0, has_mag=False)


def disturbed_compass(draw: Draw) -> Readings:
    """Figure-eights; the magnetometer's own iron and its motors' currents exceed the field."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    readings.mag += draw.about(0.5) * draw.unit()
    for axis in range(3):
        readings.mag[:, axis] += draw.wander(draw.about(0.3), 8.0, 0.5)(readings.mag_t)
    return readings


CASES: tuple[Case, ...] = (
    slow_yaw,
    slow_then_rest,
    boat,
    quiet_drift,
    quiet_climb,
    straight_then_turns,
    straight_then_turns_no_heading,
    moving_start,
    moving_start_late_fixes,
    car_no_heading,
    disturbed_compass,
)
