"""Walk: how fast the gyro's biases and the compass's slow error truly change, learnt in flight.

Corrections of an error that walks as the filter assumes are independent from one stretch of time to
the next, and as large as it expects. Corrections of the gyro's biases that go on in one direction
show that these run away, as they do while a sensor warms up. Corrections of the compass's slow
error that stay far smaller than expected show that it changes more slowly: what is left of it is as
large as before, but lasts longer.

Source: what should be white and is not tells of the noise, Mehra 1970, "On the identification of
variances and adaptive Kalman filtering"; the corrections' own variance, Myers and Tapley 1976,
"Adaptive sequential estimation with unknown noise statistics".
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.enums import E_BG, E_HEADING
from cython.cimports.ekf_companion.core.state import State
from cython.cimports.libc.math import exp, sqrt

STRETCH = cython.declare(cython.double, 1.5)
"""Time over which corrections are added up, s: with 5 s a gyro that runs away from the start was
known to after a minute."""
HEADING_STRETCH = cython.declare(cython.double, 5.0)
"""The same for the heading's slow error."""
LEAST_SEEN = cython.declare(cython.double, 0.1)
"""Share of what a walk has added that must be seen in a stretch for it to tell anything."""
DRIFT_GAIN = cython.declare(cython.double, 1.0)
"""Change of the logarithm of the gyro's share for corrections that go on as they were."""
CHANCE = cython.declare(cython.double, 0.2)
"""Correlation of corrections that is taken for chance."""
LARGEST_DRIFT = cython.declare(cython.double, 1000.0)
"""Largest share of the gyro: more than what takes the walk from its least to its largest."""
HEADING_GAIN = cython.declare(cython.double, 0.25)
"""Change of the logarithm of the heading's share for a correction that is none."""
LARGEST_SQUARE = cython.declare(cython.double, 9.0)
"""Largest square of a correction that counts, of its variance."""
LEAST_HEADING = cython.declare(cython.double, 0.01)
"""Least share of the heading: its slow error is then constant for a flight."""


def restart(x: State) -> None:
    """Begin with walks as configured."""
    walk = address(x.walk)
    walk.drift = 1.0
    walk.heading_share = 1.0
    for j in range(3):
        walk.last[j] = 0.0
    begin_stretch(x)
    begin_heading_stretch(x)


def begin_stretch(x: State) -> None:
    """Begin a new stretch of the gyro's corrections."""
    walk = address(x.walk)
    walk.dt = 0.0
    for j in range(3):
        walk.bias[j] = x.gyro_bias[j]
        walk.var[j] = x.P[E_BG + j][E_BG + j]
        walk.added[j] = 0.0


def begin_heading_stretch(x: State) -> None:
    """Begin a new stretch of the heading's."""
    walk = address(x.walk)
    walk.heading_dt = 0.0
    walk.offset = x.heading_offset
    walk.offset_var = x.P[E_HEADING][E_HEADING]
    walk.offset_added = 0.0


def add_gyro_walk(x: State, axis: int, variance: float) -> None:
    """Let a gyro's bias walk by a variance, (rad/s)^2."""
    x.P[E_BG + axis][E_BG + axis] += variance
    x.walk.added[axis] += variance


def note_fading(x: State, faded: float, level: float) -> None:
    """Note that the heading's slow error has faded by a share, towards its level (rad^2)."""
    walk = address(x.walk)
    kept = (1.0 - faded) * (1.0 - faded)
    walk.offset *= 1.0 - faded
    walk.offset_var *= kept
    walk.offset_added = kept * walk.offset_added + (1.0 - kept) * level


def learn_walk(x: State, dt: float) -> None:
    """Learn from the stretches that the time dt (s) ends."""
    x.walk.dt += dt
    x.walk.heading_dt += dt
    if x.walk.dt >= STRETCH:
        learn_drift(x)
        begin_stretch(x)
    if x.walk.heading_dt >= HEADING_STRETCH:
        learn_heading_share(x)
        begin_heading_stretch(x)


def learn_drift(x: State) -> None:
    """Learn from the sign of the gyro's corrections: a sensor that warms up drifts on all axes.

    Only their correlation counts: whether they are as large as expected depends on much else.
    """
    walk = address(x.walk)
    both = 0.0
    power = 0.0
    for j in range(3):
        seen = walk.var[j] + walk.added[j] - x.P[E_BG + j][E_BG + j]
        term = 0.0
        if seen > LEAST_SEEN * walk.added[j]:
            term = (x.gyro_bias[j] - walk.bias[j]) / sqrt(seen)
        both += term * walk.last[j]
        power += 0.5 * (term * term + walk.last[j] * walk.last[j])
        walk.last[j] = term
    if power == 0.0:
        return
    walk.drift *= exp(DRIFT_GAIN * (both / power - CHANCE))
    walk.drift = walk.drift if walk.drift > 1.0 else 1.0
    walk.drift = walk.drift if walk.drift < LARGEST_DRIFT else LARGEST_DRIFT


def learn_heading_share(x: State) -> None:
    """Learn from how large the corrections of the heading's slow error are."""
    walk = address(x.walk)
    seen = walk.offset_var + walk.offset_added - x.P[E_HEADING][E_HEADING]
    if not seen > LEAST_SEEN * walk.offset_added:
        return
    change = x.heading_offset - walk.offset
    square = change * change / seen
    square = square if square < LARGEST_SQUARE else LARGEST_SQUARE
    weight = walk.offset_added / seen
    weight = weight if weight < 1.0 else 1.0
    walk.heading_share *= exp(HEADING_GAIN * weight * (square - 1.0))
    if walk.heading_share < LEAST_HEADING:
        walk.heading_share = LEAST_HEADING
    if walk.heading_share > 1.0:
        walk.heading_share = 1.0
