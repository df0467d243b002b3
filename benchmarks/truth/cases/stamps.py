"""Stamps that are not the time."""

from __future__ import annotations

from benchmarks.truth import paths
from benchmarks.truth.cases.case import Case, flown
from benchmarks.truth.draw import Draw
from benchmarks.truth.sensors import Readings


def stamp_ahead(draw: Draw) -> Readings:
    """Figure-eights; one inertial stamp 0.25 to 1 s ahead."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    row = int(draw.about(60.0) * 125)
    readings.inertial.stamp[row] += draw.rng.uniform(0.25, 1.0)
    return readings


def stamp_ahead_each_second(draw: Draw) -> Readings:
    """Figure-eights; one inertial stamp of each second 0.25 to 1 s ahead."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    rows = slice(int(draw.rng.integers(125)), None, 125)
    count = len(readings.inertial.stamp[rows])
    readings.inertial.stamp[rows] += draw.rng.uniform(0.25, 1.0, count)
    return readings


def clock_back(draw: Draw) -> Readings:
    """Figure-eights; the clock of the whole log is set back by 0.5 to 1.5 s."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    # whole inertial intervals, so that the truth has their stamps
    moment = round(draw.about(60.0) * 25.0) / 25.0
    readings.set_back = moment, float(draw.rng.integers(13, 38)) / 25.0
    return readings


CASES: tuple[Case, ...] = (stamp_ahead, stamp_ahead_each_second, clock_back)
