"""Walk: how fast slow errors of gyro, compass and barometer truly change, learnt in flight.

Corrections of an error that walks as the filter assumes are independent from one stretch of time to
the next, and as large as it expects. Corrections of the gyro's biases that go on in one direction
show that these run away, as they do while a sensor warms up. Corrections of the compass's slow
error that stay far smaller than expected show that it changes more slowly: what is left of it is as
large as before, but lasts longer. Those of the barometer's offset while the speed changes show how
much the pressure of the air on the hull disturbs it.

Source: what should be white and is not tells of the noise, Mehra 1970, "On the identification of
variances and adaptive Kalman filtering"; the corrections' own variance, Myers and Tapley 1976,
"Adaptive sequential estimation with unknown noise statistics".
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.memory.enums import E_BARO, E_BG, E_HEADING
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import exp, sqrt

STRETCH = cython.declare(cython.double, 1.5)
"""Time over which corrections are added up, s: with 5 s a gyro that runs away from the start was
known to after a minute."""
SLOW_STRETCH = cython.declare(cython.double, 5.0)
"""The same for the slow errors of heading and barometer."""
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
SPEED_GAIN = cython.declare(cython.double, 0.5)
"""Change of the logarithm of the barometer's share for a correction that is none, from rest to full
speed or back."""
LEAST_SPEED = cython.declare(cython.double, 0.05)
"""Least share of the barometer's walk by speed."""


def restart(x: State) -> None:
    """Begin with walks as configured."""
    walk = address(x.walk)
    walk.drift = 1.0
    walk.heading_share = 1.0
    walk.speed_share = 1.0
    for j in range(3):
        walk.last[j] = 0.0
    begin_stretch(x)
    begin_slow_stretch(x)


def begin_stretch(x: State) -> None:
    """Begin a new stretch of the gyro's corrections."""
    walk = address(x.walk)
    walk.dt = 0.0
    for j in range(3):
        walk.bias[j] = x.gyro_bias[j]
        walk.var[j] = x.P[E_BG + j][E_BG + j]
        walk.added[j] = 0.0


def begin_slow_stretch(x: State) -> None:
    """Begin a new stretch of those of heading and barometer."""
    walk = address(x.walk)
    walk.slow_dt = 0.0
    walk.offset = x.heading_offset
    walk.offset_var = x.P[E_HEADING][E_HEADING]
    walk.offset_added = 0.0
    walk.baro = x.baro_offset
    walk.baro_var = x.P[E_BARO][E_BARO]
    walk.baro_added = 0.0
    walk.speed_added = 0.0
    walk.least_speed = 1e18
    walk.largest_speed = 0.0
    walk.redrawn = x.redrawn[E_BARO]


def note_gyro_walk(x: State, variance: float) -> None:
    """Note that each of the gyro's biases walks by a variance, (rad/s)^2."""
    for j in range(3):
        x.walk.added[j] += variance


def note_baro_walk(x: State, variance: float, by_speed: float, speed2: float) -> None:
    """Note that the barometer's offset walks: by a variance (m^2) and by one of speed, (m/s)^2."""
    walk = address(x.walk)
    walk.baro_added += variance + by_speed
    walk.speed_added += by_speed
    walk.least_speed = speed2 if speed2 < walk.least_speed else walk.least_speed
    walk.largest_speed = speed2 if speed2 > walk.largest_speed else walk.largest_speed


def note_fading(x: State, faded: float, level: float) -> None:
    """Note that the heading's slow error fades by a share, towards its level (rad^2)."""
    walk = address(x.walk)
    kept = (1.0 - faded) * (1.0 - faded)
    walk.offset *= 1.0 - faded
    walk.offset_var *= kept
    walk.offset_added = kept * walk.offset_added + (1.0 - kept) * level


def learn_walk(x: State, dt: float) -> None:
    """Learn from the stretches that the time dt (s) ends."""
    x.walk.dt += dt
    x.walk.slow_dt += dt
    if x.walk.dt >= STRETCH:
        learn_drift(x)
        begin_stretch(x)
    if x.walk.slow_dt >= SLOW_STRETCH:
        learn_heading_share(x)
        learn_speed_share(x)
        begin_slow_stretch(x)


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
    if seen > LEAST_SEEN * walk.offset_added:
        change = x.heading_offset - walk.offset
        weight = walk.offset_added / seen
        walk.heading_share = learnt_share(
            walk.heading_share, LEAST_HEADING, change * change / seen, HEADING_GAIN, weight
        )


def learn_speed_share(x: State) -> None:
    """Learn from how large the corrections of the barometer's offset are while the speed changes.

    At a steady speed the pressure on the hull is steady too, and nothing shows it.
    """
    walk = address(x.walk)
    seen = walk.baro_var + walk.baro_added - x.P[E_BARO][E_BARO]
    is_same = cython.declare(cython.bint, x.redrawn[E_BARO] == walk.redrawn)
    if is_same and walk.speed_added > 0.0 and seen > LEAST_SEEN * walk.baro_added:
        change = x.baro_offset - walk.baro
        gain = SPEED_GAIN * (1.0 - sqrt(walk.least_speed / walk.largest_speed))
        walk.speed_share = learnt_share(
            walk.speed_share, LEAST_SPEED, change * change / seen, gain, walk.speed_added / seen
        )


def learnt_share(share: float, least: float, square: float, gain: float, weight: float) -> float:
    """Return a share of what is configured after a correction, given its square, sigmas.

    ``weight`` is how much of what was seen the walk had added.
    """
    square = square if square < LARGEST_SQUARE else LARGEST_SQUARE
    weight = weight if weight < 1.0 else 1.0
    share *= exp(gain * weight * (square - 1.0))
    share = share if share > least else least
    return share if share < 1.0 else 1.0
