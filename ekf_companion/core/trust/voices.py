"""Three voices of height: the receiver's height, its vertical velocity, and the barometer.

Each can go astray by itself: a barometer in the airflow, a receiver among houses, a velocity that
runs wild. What each says of the climb of the last half minute is compared in pairs. Where two agree
and the third contradicts both, the third is not heard until it agrees again; nor is the estimate
called good while any two disagree.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.slow_error import (
    add_covariance,
    add_variance,
    forget_offsets,
)
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_VELOCITY,
    E_BARO,
    E_POS,
    E_VEL,
    MODE_NAVIGATE,
    VOICE_ANY,
    VOICE_BARO,
    VOICE_HEIGHT,
    VOICE_NONE,
    VOICE_VELOCITY,
)
from cython.cimports.ekf_companion.core.memory.scratch import Fix
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import slide
from cython.cimports.libc.math import exp, fabs, isnan, sqrt

MEMORY = cython.declare(cython.double, 40.0)
"""Time constant over which the climbs are compared, s; that of a slide."""
LONG_MEMORY = cython.declare(cython.double, 1000.0)
"""The same while the receiver's height is not heard, or no third voice: it may come back from
afar, s."""
LONGEST = cython.declare(cython.double, 3.0)
"""Longest interval between two fixes to add a velocity up over, or of a barometer's silence, s."""
SMOOTH = cython.declare(cython.double, 2.0)
"""Time constant of what the receiver's height is compared by, s."""
SIGMAS = cython.declare(cython.double, 3.0)
BARO_STD = cython.declare(cython.double, 1.0)
"""One sigma of what weather, wind and rotors change in a barometer meanwhile, m."""
BACK = cython.declare(cython.double, 0.4)
"""Share of the limit below which a height is heard again."""
ALONE = cython.declare(cython.double, 0.8)
"""Share of it beyond which height and velocity contradict each other, without a third voice."""
ALONE_BACK = cython.declare(cython.double, 0.25)
"""Share of it below which they agree again."""
AGREED = cython.declare(cython.double, 10.0)
"""How long they must do so, s."""
RUSH_TIME = cython.declare(cython.double, 1.0)
"""Time constant over which barometer and vertical velocity are compared at once, s."""
RUSH = cython.declare(cython.double, 2.0)
"""What gusts and rotors may change in a pressure altitude within it, m."""
FELT = cython.declare(cython.double, 0.5)
"""Share of the difference that the inertial samples must not have felt."""
LARGEST_GAP = cython.declare(cython.double, 1.0)
"""What vertical velocity and samples may disagree by, m/s: the largest bias that is left, over the
time that they are compared."""
CONFIRMED = cython.declare(cython.double, 0.25)
"""Share of it up to which the barometer's difference from the velocity is its own noise."""
LARGEST = cython.declare(cython.double, 2.0)
"""A difference is kept up to so many times its limit: it must not last when its cause is gone."""


def add_baro(x: State, alt: float) -> None:
    """Add a pressure altitude (m) to the mean until the next fix."""
    voices = address(x.voices)
    if x.t - voices.t > LONGEST * 1e9:  # the mean is to be that before a fix
        voices.baro_sum = 0.0
        voices.baro_n = 0.0
    voices.baro_sum += alt
    voices.baro_n += 1.0


def compare_climbs(x: State, fix: Fix) -> None:
    """Compare what the three say of the climb since they were last heard; find the wrong one.

    A barometer may speak more rarely than the receiver, or pause: then it answers for the while.
    """
    voices = address(x.voices)
    since = (x.t - voices.t) * 1e-9
    baro_since = (x.t - voices.baro_t) * 1e-9
    is_next = cython.declare(cython.bint, since < LONGEST)
    has_vel = cython.declare(cython.bint, not isnan(fix.vel_n[2]))
    voices.has_vel = 1.0 if has_vel else 0.0
    down = fix.vel_n[2] if has_vel else 0.0
    by_height = fix.alt - voices.height
    by_velocity = -0.5 * since * (down + voices.down) if is_next and has_vel else NAN
    voices.by_height += by_height
    voices.by_velocity += by_velocity
    baro = NAN
    if voices.baro_n > 0.0:
        baro = voices.baro_sum / voices.baro_n
        voices.baro_t = x.t
    voices.baro_sum = 0.0
    voices.baro_n = 0.0
    # without an earlier height of both, nothing is known of their climb
    by_baro = baro - voices.baro if baro_since < MEMORY and since < MEMORY else NAN
    find_rush(x, fix, baro_since, by_baro - voices.by_velocity)
    is_kept = cython.declare(
        cython.bint,
        voices.loser == VOICE_HEIGHT or (voices.loser != VOICE_NONE and not hears_baro(x)),
    )
    memory = LONG_MEMORY if is_kept else MEMORY
    for i in range(3):
        if since >= MEMORY or (i > 0 and baro_since >= MEMORY):
            voices.difference[i] = 0.0
            voices.smooth[i] = 0.0
        elif is_next and (i == 0 or hears_baro(x)):
            voices.difference[i] *= exp(-since / memory)
    is_vel_heard = cython.declare(cython.bint, has_vel and voices.is_rushing == 0.0)
    if is_vel_heard and is_next:
        voices.difference[0] += by_height - by_velocity
    if not isnan(by_baro):
        voices.difference[1] += by_baro - voices.by_height
        if is_vel_heard and not isnan(voices.by_velocity):
            voices.difference[2] += by_baro - voices.by_velocity
    # a receiver's height is noisy from fix to fix
    for i in range(3):
        gain = since / (since + SMOOTH) if i < 2 and is_next else 1.0
        voices.smooth[i] += gain * (voices.difference[i] - voices.smooth[i])
    voices.t = x.t
    voices.height = fix.alt
    voices.down = down
    if not isnan(baro):
        voices.baro = baro
        voices.by_height = 0.0
        voices.by_velocity = 0.0
    find_loser(x, fix)


def take_height(x: State) -> None:
    """Begin to compare anew with the receiver's height as it is now: it was taken for right."""
    for i in range(2):
        x.voices.difference[i] = 0.0
        x.voices.smooth[i] = 0.0
    if x.voices.loser == VOICE_HEIGHT:
        x.voices.loser = VOICE_NONE


def hears_baro(x: State) -> bool:
    """Return whether the barometer was heard lately."""
    return x.t - x.voices.baro_t < LONGEST * 1e9


def find_rush(x: State, fix: Fix, dt: float, difference: float) -> None:
    """Find out whether the receiver's vertical velocity runs wild, within a second or two.

    It does where the barometer, of which this is the difference over the last dt (s), shows nothing
    of it, and the inertial samples deny it: they felt no such change, or the velocity is refused.
    It is not heard until the barometer agrees again.
    """
    voices = address(x.voices)
    if dt >= LONGEST:
        voices.rush = 0.0
        voices.is_rushing = 0.0
    elif not isnan(difference):
        before = voices.rush
        voices.rush = (before + difference) * exp(-dt / RUSH_TIME)
        size = fabs(voices.rush) / (RUSH + SIGMAS * RUSH_TIME * sqrt(fix.stated_var[2]))
        if voices.is_rushing != 0.0:
            voices.is_rushing = 1.0 if size > BACK else 0.0
        elif size > 1.0 and (
            voices.rush * x.is_fall_denied > 0.0
            or FELT * voices.rush * voices.rush < RUSH_TIME * voices.rush * x.fall_gap
            or x.refused_t[AID_VELOCITY] > x.used_t[AID_VELOCITY]
        ):
            voices.is_rushing = 1.0
            # what it said until now is no witness, and what was fused of it has led us along
            voices.difference[0] -= before
            voices.difference[2] -= before
            voices.smooth[0] -= before
            lead = voices.rush * voices.rush
            add_variance(x, E_POS + 2, lead)
            add_variance(x, E_VEL + 2, lead / (RUSH_TIME * RUSH_TIME))
    if voices.is_rushing != 0.0:
        fix.vel_n[2] = NAN


def is_fall_unconfirmed(x: State) -> bool:
    """Return whether the samples deny the vertical velocity, and no barometer confirms it."""
    voices = address(x.voices)
    gap = x.fall_gap
    if fabs(gap) <= LARGEST_GAP:
        return False
    return voices.baro_t < voices.t or voices.rush * gap > CONFIRMED * RUSH_TIME * gap * gap


def find_loser(x: State, fix: Fix) -> None:
    """Find the voice that contradicts two others that agree; what it said until now is doubted."""
    voices = address(x.voices)
    before = voices.loser
    by_velocity = slide.led_var(fix, MEMORY)
    # of the pairs: height and velocity, baro and height, baro and velocity
    a = compare(x, 0, fix.stated_var[1] + by_velocity)
    b = compare(x, 1, fix.stated_var[1] + BARO_STD * BARO_STD)
    c = compare(x, 2, by_velocity + BARO_STD * BARO_STD)
    voices.loser = VOICE_NONE
    if not hears_baro(x):  # who is wrong cannot be told, until they agree again
        if a > (ALONE if before == VOICE_NONE else ALONE_BACK) or b > 1.0 or c > 1.0:
            voices.apart_t = x.t
        if before != VOICE_NONE and slide.is_led(x, 2):
            voices.apart_t = x.t
        if x.t - voices.apart_t < AGREED * 1e9:
            voices.loser = VOICE_ANY
    elif voices.is_rushing != 0.0:  # it comes of the same receiver
        voices.loser = VOICE_HEIGHT
    elif before == VOICE_HEIGHT and b > BACK:
        voices.loser = VOICE_HEIGHT
    elif a > 1.0 or b > 1.0 or c > 1.0:
        voices.loser = find_third(x, a, b, c)
    if hears_baro(x) and voices.loser != VOICE_HEIGHT:
        bound(x, 0, a)
        bound(x, 1, b)
        bound(x, 2, c)
    if voices.loser != VOICE_NONE and before == VOICE_NONE and x.mode == MODE_NAVIGATE:
        doubt_height(x)


def find_third(x: State, a: float, b: float, c: float) -> int:
    """Return the voice that contradicts two others that agree, by the shares of the pairs."""
    if x.voices.has_vel == 0.0:
        return VOICE_ANY
    if agrees(a, b, c):
        # both come of one receiver: the inertial samples may deny them
        is_denied = cython.declare(cython.bint, x.refused_t[AID_VELOCITY] > x.used_t[AID_VELOCITY])
        return VOICE_HEIGHT if is_denied else VOICE_BARO
    if agrees(c, a, b):
        return VOICE_HEIGHT
    if agrees(b, a, c):
        return VOICE_VELOCITY
    return VOICE_ANY


def agrees(pair: float, other: float, third: float) -> bool:
    """Return whether a pair agrees, and much better than the other two."""
    return pair <= 1.0 and 2.0 * pair <= other and 2.0 * pair <= third


def doubt_height(x: State) -> None:
    """Doubt the height by half of what the voices differ by: until now it was led astray.

    An offset of the barometer that was found by a wrong height is wrong by as much; those of other
    aids are found anew.
    """
    voices = address(x.voices)
    doubt = 0.0
    for i in range(3):
        doubt += 0.25 * voices.smooth[i] * voices.smooth[i]
    add_variance(x, E_POS + 2, doubt)
    forget_offsets(x)
    if voices.loser != VOICE_BARO:
        add_variance(x, E_BARO, doubt)
        add_covariance(x, E_POS + 2, E_BARO, doubt)


def compare(x: State, pair: int, variance: float) -> float:
    """Return the difference of a pair as a share of its limit."""
    return fabs(x.voices.smooth[pair]) / (SIGMAS * sqrt(variance))


def bound(x: State, pair: int, share: float) -> None:
    """Bound the difference of a pair, which is this share of its limit."""
    if share > LARGEST:
        x.voices.difference[pair] *= LARGEST / share
        x.voices.smooth[pair] *= LARGEST / share
