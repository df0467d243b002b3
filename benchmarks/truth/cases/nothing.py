"""Nothing is wrong, or only errors that a receiver does not report."""

from __future__ import annotations

from benchmarks.truth import paths
from benchmarks.truth.cases.case import Case, flown
from benchmarks.truth.draw import Draw
from benchmarks.truth.sensors import Readings, gauss_markov


def fig8(draw: Draw) -> Readings:
    """Figure-eights; nothing wrong."""
    return flown(draw, paths.figure_eights(draw), 120.0)


def hover(draw: Draw) -> Readings:
    """Hover in gusts; nothing wrong."""
    return flown(draw, paths.hover(draw), 120.0)


def circuits(draw: Draw) -> Readings:
    """An aeroplane's circuits in gusts, in the air from the start; nothing wrong."""
    return flown(draw, paths.circuits(draw), 120.0)


def aerobatics(draw: Draw) -> Readings:
    """Loops and rolls, in the air from the start; nothing wrong."""
    return flown(draw, paths.aerobatics(draw), 120.0)


def velocity_correlated_1(draw: Draw) -> Readings:
    """Figure-eights; error of the receiver's velocity about 0.15 m/s over 1 s, declared 0.1 m/s."""
    return _correlated(draw, 0.15, 1.0)


def velocity_correlated_20(draw: Draw) -> Readings:
    """Figure-eights; error of the receiver's velocity about 0.06 m/s over 20 s."""
    return _correlated(draw, 0.06, 20.0)


def _correlated(draw: Draw, std: float, time: float) -> Readings:
    readings = flown(draw, paths.figure_eights(draw), 120.0)
    shape = readings.fixes.vel_error_n.shape
    readings.fixes.vel_error_n[:] = 0.03 * draw.rng.standard_normal(shape)
    readings.fixes.vel_error_n += gauss_markov(
        draw.rng, shape, draw.about(std), draw.about(time), 0.2
    )
    return readings


def delay_025(draw: Draw) -> Readings:
    """Figure-eights; fixes about 0.25 s late with the stamp of their arrival."""
    return flown(draw, paths.figure_eights(draw), 120.0, delay=draw.about(0.25))


CASES: tuple[Case, ...] = (
    fig8,
    hover,
    circuits,
    aerobatics,
    velocity_correlated_1,
    velocity_correlated_20,
    delay_025,
)
