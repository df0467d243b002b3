"""The current estimate: its status, its values, and one sigma of each."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import airspeed
from cython.cimports.ekf_companion.core.filter.rotation import rotate, to_dcm, wrap
from cython.cimports.ekf_companion.core.filter.slow_error import add_spread, copy_moving
from cython.cimports.ekf_companion.core.filter.strapdown import integrate_strapdown
from cython.cimports.ekf_companion.core.filter.update import copy_nominal
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_AIRSPEED,
    AID_HEADING,
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    AIDS,
    AZIMUTH_MAGNETIC,
    E_AIRSPEED,
    E_ATT,
    E_POS,
    E_VEL,
    MODE_ATTITUDE,
    MODE_INIT,
    MODE_LEVEL,
    MODE_NAVIGATE,
    REASON_ATTITUDE,
    REASON_AUTOPILOTS,
    REASON_CLIMB_ANY,
    REASON_CLIMB_BARO,
    REASON_CLIMB_HEIGHT,
    REASON_CLIMB_VELOCITY,
    REASON_COMPASS_MISSING,
    REASON_COMPASS_REFUSED,
    REASON_FALL,
    REASON_GAP,
    REASON_HEADING_MISSING,
    REASON_HEADING_REFUSED,
    REASON_HEIGHT_MISSING,
    REASON_HEIGHT_OFF,
    REASON_HEIGHT_REFUSED,
    REASON_POSITION_MISSING,
    REASON_POSITION_OFF,
    REASON_POSITION_REFUSED,
    REASON_SLIDE,
    REASON_SLOW_SAMPLES,
    REASON_UNAIDED,
    REASON_UNCERTAIN,
    REASON_UNPROVEN,
    REASON_VELOCITY_REFUSED,
    STATUS_ALIGNING,
    STATUS_ATTITUDE,
    STATUS_DEAD_RECKONING,
    STATUS_DEGRADED,
    STATUS_INIT,
    STATUS_INVALID,
    STATUS_OK,
    VOICE_BARO,
    VOICE_HEIGHT,
    VOICE_NONE,
    VOICE_VELOCITY,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Estimate, Motion, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import repair
from cython.cimports.ekf_companion.core.trust.gate import is_running, is_shown, is_timed_out
from cython.cimports.ekf_companion.core.trust.voices import is_fall_unconfirmed
from cython.cimports.libc.math import asin, atan2, cos, fabs, isnan, sin, sqrt

DEG = cython.declare(cython.double, 57.29577951308232)
SLOW_STREAM = cython.declare(cython.double, 0.15)
"""Usual interval beyond which a vehicle's attitude is a guess, s."""
VAGUE_VAR = cython.declare(cython.double, 0.0305)
"""Variance of an angle beyond which the attitude is not well known, rad^2: 10 degrees."""


def find_status(x: State, reasons: int) -> int:
    """Return the status of the state: a :class:`~.nav.state.Status`, the worst of its reasons."""
    if x.mode == MODE_INIT:
        return STATUS_INIT
    if x.mode == MODE_LEVEL:
        return STATUS_ALIGNING
    if x.mode == MODE_ATTITUDE:
        return STATUS_ATTITUDE
    if reasons & REASON_UNCERTAIN:
        return STATUS_INVALID
    if reasons & REASON_UNAIDED:
        return STATUS_DEAD_RECKONING
    return STATUS_DEGRADED if reasons else STATUS_OK


def mix(x: State, k: Parameters, w: Scratch) -> bool:
    """Return whether the fault hypotheses decide: then their bank holds what their mixture adds."""
    if not w.observation.has_bank or k.weighs_faults != WEIGH_ACT or x.mode != MODE_NAVIGATE:
        return False
    repair.mix(x, k, address(w.observation.bank[0]))
    return True


def find_reasons(x: State, k: Parameters, w: Scratch) -> int:
    """Return why a state that navigates is not OK, as bits: a :class:`~.nav.state.Reason`."""
    return judge(x, k, w, mix(x, k, w))


def judge(x: State, k: Parameters, w: Scratch, is_mixed: bool) -> int:
    """Return these reasons by what the mixture adds, where :func:`mix` has just written that."""
    reasons = judge_state(x, k)
    if is_mixed:
        b = address(w.observation.bank[0])
        reasons |= judge_spread(x, k, b)
        if repair.is_heading_found(b):
            reasons &= ~(REASON_COMPASS_REFUSED | REASON_HEADING_REFUSED)
    return reasons


def judge_spread(x: State, k: Parameters, b: Bank) -> int:
    """Return the reasons that follow from what is stated, with how far the hypotheses are apart."""
    reasons = cython.declare(cython.int, 0)
    var = 0.0
    for e in range(E_POS, E_POS + 2):
        var += x.P[e][e] + b.spread[e][e]
    if not var <= k.limit_pos * k.limit_pos:
        reasons |= REASON_UNCERTAIN
    for e in range(E_ATT, E_ATT + 3):
        if x.P[e][e] + b.spread[e][e] > VAGUE_VAR:
            reasons |= REASON_ATTITUDE
    return reasons


def judge_state(x: State, k: Parameters) -> int:
    """Return the reasons that follow from the state alone."""
    reasons = cython.declare(cython.int, 0)
    if x.mode != MODE_NAVIGATE:
        return reasons
    if not x.P[E_POS][E_POS] + x.P[E_POS + 1][E_POS + 1] <= k.limit_pos * k.limit_pos:
        reasons |= REASON_UNCERTAIN
    late = late_fix(x)
    is_judged = cython.declare(cython.bint, k.weighs_faults == WEIGH_ACT)
    is_led = cython.declare(cython.bint, is_shown(x, k, 1.0))
    if is_timed_out(x, AID_POSITION, late) and is_timed_out(x, AID_VELOCITY, late) and not is_led:
        reasons |= REASON_UNAIDED
    if x.needs_reset != 0.0:
        reasons |= REASON_GAP
    if x.dt > SLOW_STREAM:
        reasons |= REASON_SLOW_SAMPLES
    if x.t < x.proven_t:
        reasons |= REASON_UNPROVEN
    # by the autopilot's own position, whose errors last
    if k.use_derived == 2.0 or x.fix_t > x.raw_fix_t:
        reasons |= REASON_AUTOPILOTS
    if is_judged:
        pass
    elif isnan(x.last_fix_vel[0]):
        pass  # where no velocity comes any more, none is refused
    elif is_running(x, AID_VELOCITY) or (x.is_gradual != 0.0 and is_refused(x, AID_VELOCITY)):
        reasons |= REASON_VELOCITY_REFUSED
    if is_timed_out(x, AID_POSITION, late + 1.0):
        is_wrong = is_refused(x, AID_POSITION)
        if not is_wrong:  # nothing contradicts what is led by an aid
            reasons |= REASON_POSITION_MISSING
        elif not is_judged:
            reasons |= REASON_POSITION_REFUSED
    if x.is_one_sided[AID_POSITION] != 0.0:
        reasons |= REASON_POSITION_OFF
    if x.slide.is_sliding != 0.0:
        reasons |= REASON_SLIDE
    for e in range(E_ATT, E_ATT + 3):
        if x.P[e][e] > VAGUE_VAR:
            reasons |= REASON_ATTITUDE
    if is_timed_out(x, AID_HEADING, 5.0) and x.azimuth != 0.0:
        # where there never was a compass, turns show the heading as well
        is_magnetic = cython.declare(cython.bint, x.azimuth >= AZIMUTH_MAGNETIC)
        if is_refused(x, AID_HEADING):
            reasons |= REASON_COMPASS_REFUSED if is_magnetic else REASON_HEADING_REFUSED
        elif not is_judged or (is_magnetic and x.natural_fields == 0.0):
            reasons |= REASON_COMPASS_MISSING if is_magnetic else REASON_HEADING_MISSING
    if is_timed_out(x, AID_HEIGHT, late + 1.0):
        is_wrong = is_refused(x, AID_HEIGHT)
        if not is_wrong:
            reasons |= REASON_HEIGHT_MISSING
        elif not is_judged:
            reasons |= REASON_HEIGHT_REFUSED
    if x.is_one_sided[AID_HEIGHT] != 0.0:
        reasons |= REASON_HEIGHT_OFF
    if x.voices.loser == VOICE_HEIGHT:
        reasons |= REASON_CLIMB_HEIGHT
    elif x.voices.loser == VOICE_VELOCITY:
        reasons |= REASON_CLIMB_VELOCITY
    elif x.voices.loser == VOICE_BARO:
        reasons |= REASON_CLIMB_BARO
    elif x.voices.loser != VOICE_NONE:
        reasons |= REASON_CLIMB_ANY
    if is_fall_unconfirmed(x):
        reasons |= REASON_FALL
    return reasons


def late_fix(x: State) -> float:
    """Return the time in which a fix should come, s: a second beyond the receiver's interval."""
    return 1.0 + (x.fix_dt if x.fix_dt < 2.0 else 2.0)


def is_refused(x: State, aid: int) -> bool:
    """Return whether the last of an aid was refused."""
    return x.refused_t[aid] > x.used_t[aid]


def write_estimate(x: State, k: Parameters, y: State, w: Scratch, out: Estimate) -> int:
    """Write the estimate of now; return its status.

    Now is the sample's stamp: the state is carried on, in y, by the lag of the inertial sensor.
    What is not known yet is NaN.
    """
    m = address(w.motion)
    is_mixed = mix(x, k, w)
    reasons = judge(x, k, w, is_mixed)
    status = find_status(x, reasons)
    copy_nominal(y, x)
    y.origin = x.origin
    copy_moving(y, x)
    if is_mixed:
        b = address(w.observation.bank[0])
        add_spread(y, b)
        rotate(y.q_nb, b.mean[0], b.mean[1], b.mean[2])
        for i in range(3):
            y.vel_n[i] += b.mean[3 + i]
            y.pos_n[i] += b.mean[6 + i]
    if k.lag > 0.0 and x.mode >= MODE_ATTITUDE:
        for i in range(3):
            m.rate[i] = x.gyro[i]
            m.force[i] = x.accel[i]
            m.rate_slope[i] = 0.0
            m.force_slope[i] = 0.0
        integrate_strapdown(y, k, m, k.lag)
    clear(out)
    out.status = status
    out.resets = x.resets
    out.reasons = reasons
    if x.mode < MODE_ATTITUDE:
        return status
    write_attitude(x, y, m, out)
    for i in range(3):
        out.gyro_bias[i] = x.gyro_bias[i]
        out.accel_bias[i] = x.accel_bias[i]

    # Height without GNSS is over the start, by the aids that found it
    if x.mode < MODE_NAVIGATE:
        for aid in range(AIDS):
            if x.has_aid[aid] != 0.0:
                write_axis(x, y, out, 2)
        return status
    for i in range(3):
        write_axis(x, y, out, i)
    if x.origin.is_known == 0.0:
        return status
    out.lla[0] = (x.origin.lat + y.pos_n[0] / x.origin.scale_n) * DEG
    out.lla[1] = wrap(x.origin.lon + y.pos_n[1] / x.origin.scale_e) * DEG
    out.lla[2] = x.origin.alt - y.pos_n[2]
    if x.has_aid[AID_AIRSPEED] != 0.0 and airspeed.is_plausible(x, k):
        write_wind(x, out)
    return status


def clear(out: Estimate) -> None:
    """Write NaN to all numbers of an estimate."""
    for i in range(3):
        out.lla[i] = NAN
        out.pos_n[i] = NAN
        out.vel_n[i] = NAN
        out.euler[i] = NAN
        out.gyro_bias[i] = NAN
        out.accel_bias[i] = NAN
        out.std_pos[i] = NAN
        out.std_vel[i] = NAN
        out.std_euler[i] = NAN
    for i in range(4):
        out.q_nb[i] = NAN
    for i in range(2):
        out.wind[i] = NAN
        out.std_wind[i] = NAN


def write_wind(x: State, out: Estimate) -> None:
    """Write the wind that velocity and airspeed have shown."""
    out.wind[0] = x.airspeed_wind_n
    out.wind[1] = x.airspeed_wind_e
    for i in range(2):
        out.std_wind[i] = sqrt(x.P[E_AIRSPEED + i][E_AIRSPEED + i])


def write_axis(x: State, y: State, out: Estimate, axis: int) -> None:
    """Write position and velocity along one axis of n."""
    out.pos_n[axis] = y.pos_n[axis]
    out.vel_n[axis] = y.vel_n[axis]
    out.std_pos[axis] = sqrt(y.P[E_POS + axis][E_POS + axis])
    out.std_vel[axis] = sqrt(y.P[E_VEL + axis][E_VEL + axis])


def write_attitude(x: State, y: State, m: Motion, out: Estimate) -> None:
    """Write the attitude, and its error in n as errors of the Euler angles."""
    to_dcm(y.q_nb, m.C_nb)
    sp = -m.C_nb[2][0]
    if sp > 1.0:
        sp = 1.0
    if sp < -1.0:
        sp = -1.0
    yaw = atan2(m.C_nb[1][0], m.C_nb[0][0])
    sign = -1.0 if y.q_nb[0] < 0.0 else 1.0
    for i in range(4):
        out.q_nb[i] = sign * y.q_nb[i]
    out.euler[0] = atan2(m.C_nb[2][1], m.C_nb[2][2])
    out.euler[1] = asin(sp)
    out.euler[2] = yaw

    cp = sqrt(1.0 - sp * sp)
    if cp < 1e-3:
        cp = 1e-3
    c = cos(yaw)
    s = sin(yaw)
    p00 = y.P[0][0]
    p01 = y.P[0][1]
    p02 = y.P[0][2]
    p11 = y.P[1][1]
    p12 = y.P[1][2]
    p22 = y.P[2][2]
    along = c * c * p00 + 2.0 * c * s * p01 + s * s * p11
    out.std_euler[0] = sqrt(along) / cp
    out.std_euler[1] = sqrt(s * s * p00 - 2.0 * c * s * p01 + c * c * p11)
    out.std_euler[2] = sqrt(
        fabs(p22 + sp * sp / (cp * cp) * along + 2.0 * sp / cp * (c * p02 + s * p12))
    )
    if x.has_yaw == 0.0:
        out.euler[2] = NAN
        out.std_euler[2] = NAN
