"""Whether a receiver's position moves otherwise than its own velocity says.

Over some seconds that shows a jump, and that a refused fix is the receiver's own fault. Over half a
minute it shows a position that slides away so slowly that each fix is near the estimate, which
follows it at a small sigma. Which of the two is wrong cannot be told; so no estimate is called good
until they agree again, or a position that was refused has been proven.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import wrap
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import AID_POSITION, AID_VELOCITY
from cython.cimports.ekf_companion.core.memory.scratch import Fix
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import exp, fabs, isnan, sqrt

LONGEST = cython.declare(cython.double, 3.0)
"""Longest interval between two fixes to add a velocity up over, s."""
STEADY = cython.declare(cython.double, 1.5)
"""The same for a slide: within more, a turn is not the mean of its ends, s."""
SIGMAS = cython.declare(cython.double, 3.0)
ALONE = cython.declare(cython.double, 2.5)
"""Sigmas of a slide, which no third voice settles."""
SPLIT_TIME = cython.declare(cython.double, 10.0)
"""Time constant of the difference over some seconds, s."""
SPLIT_DRIFT = cython.declare(cython.double, 1.0)
"""What the slow error of the velocity adds to it, m."""
MEMORY = cython.declare(cython.double, 40.0)
"""Time constant of the difference over half a minute, s."""
LONG_MEMORY = cython.declare(cython.double, 1000.0)
"""The same while they disagree: the position may come back from afar, s."""
SMOOTH = cython.declare(cython.double, 2.0)
"""Time constant that a position's noise is smoothed with, s."""
SLOW_VELOCITY = cython.declare(cython.double, 0.3)
"""Slow error of a velocity, as a share of its stated sigma."""
SLOW_TIME = cython.declare(cython.double, 20.0)
"""Its time constant, s."""
BACK = cython.declare(cython.double, 0.25)
"""Share of the limit below which they agree again, but for what has led meanwhile."""
AGREED = cython.declare(cython.double, 10.0)
"""How long they must agree until they are believed again, s."""
OFFSET = cython.declare(cython.double, 2.0)
"""Sigmas of the receiver's slow error that are no slide."""


def compare_fixes(x: State, fix: Fix) -> None:
    """Add to what the receiver's position has moved beside the integral of its velocity."""
    dt = (x.t - x.split_t) * 1e-9
    is_next = cython.declare(cython.bint, dt < LONGEST)
    # while it is refused, the velocity is known to be wrong
    is_heard = cython.declare(cython.bint, x.refused_t[AID_VELOCITY] <= x.used_t[AID_VELOCITY])
    for i in range(3):
        here = -fix.alt
        if i == 0:
            here = (fix.lat - x.origin.lat) * x.origin.scale_n
        if i == 1:
            here = wrap(fix.lon - x.origin.lon) * x.origin.scale_e
        v = 0.0 if isnan(fix.vel_n[i]) else fix.vel_n[i]
        here -= fix.lag * v  # when the velocity was true
        way = 0.5 * dt * (v + x.split_vel[i])
        x.split[i] = (
            x.split[i] * exp(-dt / SPLIT_TIME) + here - x.split_pos[i] - way if is_next else 0.0
        )
        if i < 2:
            x.slide.way[i] += way if dt < STEADY and is_heard and not isnan(fix.vel_n[i]) else NAN
        x.split_pos[i] = here
        x.split_vel[i] = v
    x.split_t = x.t


def refuse(x: State) -> None:
    """Note how far off the first fix is whose position is refused: a jump, or still a slide."""
    for i in range(2):
        x.slide.jump[i] = beside(x, i)


def follow(x: State, fix: Fix, is_reset: bool) -> None:
    """Add to a slide what the estimate is led by a fix that is fused, or reset to.

    Fixes that are refused lead nowhere, and a jump that a reset makes up for has been proven. But
    where the position slid before it, or while it was refused, that may go on, or back.
    """
    slide = address(x.slide)
    since = (x.t - slide.t) * 1e-9
    limit = ALONE * ALONE * (fix.stated_var[0] + led_var(fix, MEMORY) + lag_var(fix))
    was_refused = cython.declare(cython.bint, x.refused_t[AID_POSITION] > slide.t)
    if is_reset and was_refused and slide.is_sliding == 0.0 and has_slid(x, fix, limit):
        slide.is_sliding = 1.0
        slide.onset_t = x.t
        slide.apart_t = x.t
    is_added = cython.declare(
        cython.bint,
        not isnan(beside(x, 0) + beside(x, 1)) and (not is_reset or slide.is_sliding != 0.0),
    )
    if not is_added:
        slide.begin_t = x.t
    memory = LONG_MEMORY
    if slide.is_sliding == 0.0:
        # the noise of the position that it begins with must not last
        memory = (x.t - slide.begin_t) * 1e-9
        memory = memory if memory > since else since
        memory = memory if memory < MEMORY else MEMORY
    faded = exp(-since / memory) if since > 0.0 else 1.0
    gain = since / (since + SMOOTH)
    square = 0.0
    for i in range(2):
        slide.led[i] *= faded
        if is_added:
            slide.led[i] += beside(x, i)
        slide.smooth[i] += gain * (slide.led[i] - slide.smooth[i])
        square += slide.smooth[i] * slide.smooth[i]
    for i in range(2):
        slide.pos[i] = x.split_pos[i]
        slide.way[i] = 0.0 if x.split_t == x.t else NAN
    slide.t = x.t
    if slide.is_sliding == 0.0:
        slide.onset_t = x.t
        slide.apart_t = x.t
        slide.is_sliding = 1.0 if square > limit else 0.0
        return
    limit = BACK * BACK * limit + led_var(fix, (x.t - slide.onset_t) * 1e-9)
    if square > limit or is_led(x, 0) or is_led(x, 1):
        slide.apart_t = x.t
    slide.is_sliding = 1.0 if x.t - slide.apart_t < AGREED * 1e9 else 0.0


def has_slid(x: State, fix: Fix, limit: float) -> bool:
    """Return whether a position to reset to is off by a limit (m^2), and not by a jump alone."""
    noise = 2.0 * SIGMAS * SIGMAS * fix.std[0] * fix.std[0]
    whole = 0.0
    slid = 0.0
    for i in range(2):
        way = x.slide.led[i] + beside(x, i)
        whole += way * way
        slid += (way - x.slide.jump[i]) * (way - x.slide.jump[i])
    return whole > limit + noise and slid > limit + noise


def beside(x: State, axis: int) -> float:
    """Return what the position moved since one was fused, beside the velocity's integral, m."""
    if x.split_t != x.t:
        return NAN
    return x.split_pos[axis] - x.slide.pos[axis] - x.slide.way[axis]


def is_led(x: State, axis: int) -> bool:
    """Return whether a slide is still taken for a slow error of the receiver, that it never has."""
    offset = x.gnss_offset[axis]
    variance = x.gnss_offset_var[0 if axis < 2 else 1]
    return variance > 0.0 and offset * offset > OFFSET * OFFSET * variance


def led_var(fix: Fix, span: float) -> float:
    """Return the variance of what the velocity's slow error adds up to over so many s, m^2."""
    return SLOW_VELOCITY * SLOW_VELOCITY * fix.stated_var[2] * SLOW_TIME * span


def lag_var(fix: Fix) -> float:
    """Return the variance of the way that the velocity's lag hides, m^2."""
    if fix.lag_var == 0.0:
        return 0.0
    return fix.lag_var * (fix.vel_n[0] * fix.vel_n[0] + fix.vel_n[1] * fix.vel_n[1])


def contradicts_itself(x: State, fix: Fix) -> bool:
    """Return whether the receiver's position lately moved otherwise than its velocity says."""
    level = SIGMAS * sqrt(fix.stated_var[0]) + SPLIT_DRIFT
    vertical = SIGMAS * sqrt(fix.stated_var[1]) + SPLIT_DRIFT
    if x.split[0] * x.split[0] + x.split[1] * x.split[1] > level * level:
        return True
    return not isnan(fix.vel_n[2]) and fabs(x.split[2]) > vertical
