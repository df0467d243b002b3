"""The receiver is lost, or jumps, drifts off or has a velocity fault."""

from __future__ import annotations

import numpy as np

from benchmarks.truth import paths
from benchmarks.truth.cases.case import (
    Case,
    away_and_back,
    climbing,
    during,
    end_baro,
    flown,
    lose,
    shake,
    shift,
    thin_baro,
)
from benchmarks.truth.draw import Draw
from benchmarks.truth.earth import Array
from benchmarks.truth.motion import Motion
from benchmarks.truth.sensors import Readings


def outage_60(draw: Draw) -> Readings:
    """Figure-eights; no fix for about 60 s."""
    readings = flown(draw, paths.figure_eights(draw), 160.0)
    lose(readings, draw.about(50.0), draw.about(60.0))
    return readings


def outage_30_straight(draw: Draw) -> Readings:
    """Straight on at 25 m/s; no fix for about 30 s."""
    readings = flown(draw, paths.fast_and_straight(draw), 120.0)
    lose(readings, draw.about(55.0), draw.about(30.0))
    return readings


def outage_120_hover(draw: Draw) -> Readings:
    """Hover in gusts; no fix for about 120 s."""
    readings = flown(draw, paths.hover(draw, 1.0), 240.0)
    lose(readings, draw.about(50.0), draw.about(120.0))
    return readings


def jump_80(draw: Draw) -> Readings:
    """Figure-eights; position about 80 m off for 10 s, velocity true."""
    return _jumping(draw, paths.figure_eights(draw), 80.0, 10.0)


def jump_25(draw: Draw) -> Readings:
    """Figure-eights; position about 25 m off for 20 s, velocity true."""
    return _jumping(draw, paths.figure_eights(draw), 25.0, 20.0)


def jump_25_hover(draw: Draw) -> Readings:
    """Hover; position about 25 m off for 20 s, velocity true."""
    return _jumping(draw, paths.hover(draw), 25.0, 20.0)


def _jumping(draw: Draw, motion: Motion, by: float, length: float) -> Readings:
    readings = flown(draw, motion, 120.0)
    shift(readings, draw.about(60.0), draw.about(length), draw.about(by) * draw.level())
    return readings


def slide_2(draw: Draw) -> Readings:
    """Figure-eights; position drifts off at about 2 m/s for 20 s, velocity true."""
    return _sliding(draw, paths.figure_eights(draw))


def slide_2_hover(draw: Draw) -> Readings:
    """Hover; position drifts off at about 2 m/s for 20 s, velocity true."""
    return _sliding(draw, paths.hover(draw))


def _sliding(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 120.0)
    _slide(draw, readings, 20.0, 2.0)
    return readings


def _slide(draw: Draw, readings: Readings, length: float, speed: float) -> None:
    begin, length = draw.about(60.0), draw.about(length)
    rows = during(readings.fixes.t, begin, length)
    since = readings.fixes.t[rows] - begin
    readings.fixes.pos_error_n[rows] += np.outer(since, draw.about(speed) * draw.level())


def slide_1_white(draw: Draw) -> Readings:
    """Figure-eights; drifts off at about 1 m/s for 40 s, of a receiver with white errors."""
    return _sliding_white(draw, paths.figure_eights(draw))


def slide_1_white_hover(draw: Draw) -> Readings:
    """Hover; drifts off at about 1 m/s for 40 s, of a receiver with white errors."""
    return _sliding_white(draw, paths.hover(draw))


def _sliding_white(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 150.0)
    fixes = readings.fixes
    declared = np.stack([fixes.std_h, fixes.std_h, fixes.std_v], axis=1)
    fixes.pos_error_n = declared * draw.rng.standard_normal(declared.shape)
    _slide(draw, readings, 40.0, 1.0)
    return readings


def slide_slow(draw: Draw) -> Readings:
    """Figure-eights; drifts about 15 m off within 60 s and back in 60 s, velocity true."""
    return _sliding_slowly(draw, paths.figure_eights(draw))


def slide_slow_hover(draw: Draw) -> Readings:
    """Hover; drifts about 15 m off within 60 s and back in 60 s, velocity true."""
    return _sliding_slowly(draw, paths.hover(draw))


def _sliding_slowly(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 200.0)
    share = away_and_back(draw, readings.fixes.t)
    readings.fixes.pos_error_n += np.outer(share, draw.about(15.0) * draw.level())
    return readings


def frozen(draw: Draw) -> Readings:
    """Figure-eights; the receiver repeats one fix for about 20 s."""
    return _freezing(draw, paths.figure_eights(draw))


def frozen_hover(draw: Draw) -> Readings:
    """Hover; the receiver repeats one fix for about 20 s."""
    return _freezing(draw, paths.hover(draw))


def _freezing(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 120.0)
    rows = np.flatnonzero(during(readings.fixes.t, draw.about(60.0), draw.about(20.0)))
    readings.fixes.said[rows] = rows[0]
    return readings


def return_wrong(draw: Draw) -> Readings:
    """Figure-eights; no fix for about 20 s, then positions 300 m off for 20 s, then right ones."""
    readings = flown(draw, paths.figure_eights(draw), 150.0)
    begin, gap = draw.about(50.0), draw.about(20.0)
    lose(readings, begin, gap)
    shift(readings, begin + gap, draw.about(20.0), draw.about(300.0) * draw.level())
    return readings


def return_right(draw: Draw) -> Readings:
    """Figure-eights; no fix for about 30 s, then right ones."""
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    lose(readings, draw.about(50.0), draw.about(30.0))
    return readings


def velocity_biased(draw: Draw) -> Readings:
    """Figure-eights; the receiver's horizontal velocity about 0.6 m/s off for 40 s."""
    return _drifting(draw, paths.figure_eights(draw))


def velocity_biased_hover(draw: Draw) -> Readings:
    """Hover; the receiver's horizontal velocity about 0.6 m/s off for 40 s."""
    return _drifting(draw, paths.hover(draw))


def _drifting(draw: Draw, motion: Motion) -> Readings:
    readings = flown(draw, motion, 130.0)
    rows = during(readings.fixes.t, draw.about(50.0), draw.about(40.0))
    readings.fixes.vel_error_n[rows] += draw.about(0.6) * draw.level()
    return readings


def vertical_velocity_wild(draw: Draw) -> Readings:
    """Figure-eights; the receiver's vertical velocity about 10 m/s off for 15 s."""
    return climbing(draw, paths.figure_eights(draw), 60.0, 15.0, 10.0)


def vertical_velocity_wild_hover(draw: Draw) -> Readings:
    """Hover; the receiver's vertical velocity about 10 m/s off for 15 s, the barometer flat."""
    return climbing(draw, paths.hover(draw), 60.0, 15.0, 10.0)


def receiver_wild(draw: Draw) -> Readings:
    """Hover; the receiver's velocity is erratic for 3 s, its descent for 15 s; position follows."""
    return _running_wild(draw, flown(draw, paths.hover(draw), 150.0))


def receiver_wild_shaken(draw: Draw) -> Readings:
    """The same; inertial rows at 40 Hz, shaken by a slow wave of about 1 m/s2."""
    readings = flown(draw, paths.hover(draw), 150.0, imu_rate=40)
    shake(draw, readings, 1.0, 0.02)
    return _running_wild(draw, readings)


def receiver_wild_1_hz(draw: Draw) -> Readings:
    """The same as receiver-wild, with a barometer at 1 Hz."""
    readings = receiver_wild(draw)
    thin_baro(readings, 25)
    return readings


def receiver_wild_baro_lost(draw: Draw) -> Readings:
    """The same as receiver-wild; the barometer ends during the descent."""
    readings = receiver_wild(draw)
    end_baro(readings, 97.0)
    return readings


def _running_wild(draw: Draw, readings: Readings) -> Readings:
    burst = draw.about(50.0) * draw.level() + np.array([0.0, 0.0, draw.about(25.0) * draw.sign()])
    _mislead(readings, draw.about(50.0), draw.about(3.0), burst)
    descent = np.array([0.0, 0.0, draw.about(7.0) * draw.sign()])
    _mislead(readings, draw.about(90.0, 0.1), draw.about(15.0), descent)
    return readings


def _mislead(readings: Readings, begin: float, length: float, most_n: Array) -> None:
    """Let a velocity error rise to ``most_n`` (m/s) and fall; the position loses it in 5 s."""
    t, dt, memory = readings.fixes.t, 0.2, 5.0
    shape = np.sin(np.pi * np.clip((t - begin) / length, 0.0, 1.0)) ** 2
    led = np.zeros_like(shape)
    for i in range(1, len(t)):
        led[i] = led[i - 1] * np.exp(-dt / memory) + dt * shape[i]
    readings.fixes.vel_error_n += np.outer(shape, most_n)
    readings.fixes.pos_error_n += np.outer(led, most_n)


CASES: tuple[Case, ...] = (
    outage_60,
    outage_30_straight,
    outage_120_hover,
    jump_80,
    jump_25,
    jump_25_hover,
    slide_2,
    slide_2_hover,
    slide_1_white,
    slide_1_white_hover,
    slide_slow,
    slide_slow_hover,
    frozen,
    frozen_hover,
    return_wrong,
    return_right,
    velocity_biased,
    velocity_biased_hover,
    vertical_velocity_wild,
    vertical_velocity_wild_hover,
    receiver_wild,
    receiver_wild_shaken,
    receiver_wild_1_hz,
    receiver_wild_baro_lost,
)
