"""Observation: an empty one, and what a timing error adds to its noise."""

from __future__ import annotations

from cython.cimports.ekf_companion.core.memory.enums import N
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.scratch import Observation


def clear(o: Observation, rows: int, variance: float) -> None:
    """Begin an observation: H is zero, R diagonal, and it does not move the delay."""
    o.rows = rows
    o.shows_delay = 0
    for r in range(rows):
        for i in range(N):
            o.H[r][i] = 0.0
        for c in range(rows):
            o.R[r][c] = 0.0
        o.R[r][r] = variance


def add_timing_noise(o: Observation, var: float, rate: Vector) -> None:
    """Add to R what an error in time, s^2, does to what changes at these rates, one a row."""
    for r in range(o.rows):
        for c in range(o.rows):
            o.R[r][c] += var * rate[r] * rate[c]


def row_variance(o: Observation, r: int) -> float:
    """Return the variance of a row of the innovation."""
    var = 0.0
    for j in range(r + 1):
        var += o.L[r][j] * o.L[r][j]
    return var
