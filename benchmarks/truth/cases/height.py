"""Barometer and receiver disagree about the height."""

from __future__ import annotations

import numpy as np

from benchmarks.truth import paths
from benchmarks.truth.cases.case import (
    Case,
    away_and_back,
    climbing,
    end_baro,
    flown,
    thin_baro,
)
from benchmarks.truth.draw import Draw
from benchmarks.truth.sensors import Readings


def baro_drift(draw: Draw) -> Readings:
    """Figure-eights; the barometer drifts away by about 20 m over 60 s, and stays there."""
    readings = flown(draw, paths.figure_eights(draw), 150.0)
    share = np.clip((readings.baro_t - draw.about(45.0)) / draw.about(60.0), 0.0, 1.0)
    readings.baro += draw.about(20.0) * draw.sign() * share
    return readings


def baro_drift_1_hz(draw: Draw) -> Readings:
    """The same, of a barometer that is slower than the receiver."""
    readings = baro_drift(draw)
    thin_baro(readings, 25)
    return readings


def baro_step(draw: Draw) -> Readings:
    """Hover; the barometer steps by about 10 m."""
    readings = flown(draw, paths.hover(draw), 120.0)
    readings.baro[readings.baro_t > draw.about(60.0)] += draw.about(10.0) * draw.sign()
    return readings


def baro_frozen(draw: Draw) -> Readings:
    """Figure-eights; the barometer repeats its last value from about 50 s on."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    rows = np.flatnonzero(readings.baro_t > draw.about(50.0))
    readings.baro[rows] = readings.baro[rows[0]]
    return readings


def baro_by_speed(draw: Draw) -> Readings:
    """Steady flight, then stops and starts; the air makes the barometer 3 m wrong at full speed."""
    readings = flown(draw, paths.steady_and_stopping(draw), 160.0)
    velocity = readings.flight.vel_n[readings.flight.index(readings.baro_t)]
    pressure = np.sum(velocity**2, axis=1) / 15.0**2
    readings.baro += draw.about(3.0) * draw.sign() * pressure
    return readings


def receiver_height(draw: Draw) -> Readings:
    """Hover; the receiver's height goes about 15 m away within 60 s, and back in 60 s."""
    readings = flown(draw, paths.hover(draw), 180.0)
    share = away_and_back(draw, readings.fixes.t)
    readings.fixes.pos_error_n[:, 2] += draw.about(15.0) * draw.sign() * share
    return readings


def receiver_height_1_hz(draw: Draw) -> Readings:
    """The same, with a barometer that is slower than the receiver."""
    readings = receiver_height(draw)
    thin_baro(readings, 25)
    return readings


def receiver_height_alone(draw: Draw) -> Readings:
    """The same; there is no barometer."""
    readings = receiver_height(draw)
    end_baro(readings, 0.0)
    return readings


def vertical_velocity_biased(draw: Draw) -> Readings:
    """Hover; the receiver's vertical velocity about 1 m/s off for 30 s."""
    return climbing(draw, paths.hover(draw), 50.0, 30.0, 1.0)


CASES: tuple[Case, ...] = (
    baro_drift,
    baro_drift_1_hz,
    baro_step,
    baro_frozen,
    baro_by_speed,
    receiver_height,
    receiver_height_1_hz,
    receiver_height_alone,
    vertical_velocity_biased,
)
