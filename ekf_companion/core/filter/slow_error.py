"""Error states set by hand: drawn anew, inflated, copied.

With :mod:`.update` and :mod:`.covariance` the only place that writes P.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.enums import AID_BARO, AIDS, CORE, N
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.state import State


def carried(x: State) -> int:
    """Return how many error states are carried: those beyond are of aids that have not begun."""
    return CORE + cython.cast(cython.Py_ssize_t, x.begun)


def carry(x: State, k: Parameters, aid: int) -> None:
    """Carry the slow errors of an aid from now on."""
    beyond = k.aid[aid].error + k.aid[aid].errors - CORE
    if beyond > x.begun:
        x.begun = beyond


def reset_variance(x: State, first: int, count: int, variance: float) -> None:
    """Make some error states uncorrelated with all others, each of this variance.

    They are counted as drawn anew: what is known of them later says nothing of them before.
    """
    for i in range(first, first + count):
        x.redrawn[i] += 1.0
        x.copied[i] = -1.0
        for j in range(N):
            x.P[i][j] = 0.0
            x.P[j][i] = 0.0
        x.P[i][i] = variance


def add_variance(x: State, e: int, variance: float) -> None:
    """Add to the variance of an error state; its correlations become weaker."""
    x.P[e][e] += variance


def add_covariance(x: State, e: int, other: int, covariance: float) -> None:
    """Add to the covariance of two different error states."""
    x.P[e][other] += covariance
    x.P[other][e] += covariance


def set_variance(x: State, e: int, variance: float) -> None:
    """Set the variance of an error state and leave its covariances."""
    x.P[e][e] = variance


def set_covariance(x: State, e: int, other: int, covariance: float) -> None:
    """Set the covariance of two error states."""
    x.P[e][other] = covariance
    x.P[other][e] = covariance


def scale_correlation(x: State, e: int, share: float) -> None:
    """Multiply the row and the column of an error state by a share."""
    for i in range(N):
        x.P[e][i] *= share
        x.P[i][e] = x.P[e][i]


def copy_error(x: State, e: int, source: int, variance: float) -> None:
    """Make an error state the error of another one and white noise of this variance."""
    for j in range(N):
        x.P[e][j] = x.P[source][j]
        x.P[j][e] = x.P[source][j]
    x.P[e][e] = x.P[source][source] + variance
    x.redrawn[e] += 1.0
    x.copied[e] = source


def add_error(x: State, e: int, source: int, share: float) -> None:
    """Add a share of another error state to one: its correlations with all others follow."""
    for j in range(N):
        x.P[e][j] += share * x.P[source][j]
    for j in range(N):
        x.P[j][e] = x.P[e][j]
    x.P[e][e] += share * x.P[e][source]


def forget_offsets(x: State) -> None:
    """Let the aids' slow errors be found anew; the barometer's is judged with the height."""
    for aid in range(AIDS):
        if aid != AID_BARO:
            x.has_aid[aid] = 0.0


def clear_covariance(x: State) -> None:
    """Make P zero."""
    for i in range(N):
        for j in range(N):
            x.P[i][j] = 0.0


def copy_covariance(x: State, source: State) -> None:
    """Copy P of another state."""
    for i in range(N):
        for j in range(N):
            x.P[i][j] = source.P[i][j]


def copy_moving(x: State, source: State) -> None:
    """Copy the covariance of attitude, velocity and position of another state."""
    for i in range(9):
        for j in range(9):
            x.P[i][j] = source.P[i][j]


def add_spread(x: State, b: Bank) -> None:
    """Add to that how far the fault hypotheses are apart."""
    for i in range(9):
        for j in range(9):
            x.P[i][j] += b.spread[i][j]
