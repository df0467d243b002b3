"""Start of navigation at a fix, and resets of position, height and velocity to one."""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import gnss
from cython.cimports.ekf_companion.core.aids.delay import forget_gain
from cython.cimports.ekf_companion.core.filter.slow_error import (
    forget_offsets,
    reset_variance,
    set_variance,
)
from cython.cimports.ekf_companion.core.filter.strapdown import set_origin
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2, UNKNOWN_ANGLE
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEADING,
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    E_ATT,
    E_BG,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_POS,
    E_VEL,
    MODE_LEVEL,
    MODE_NAVIGATE,
    NEEDS_FIX,
    NEEDS_TILT,
    RESET_GAP,
    RESET_ORIGIN,
    VERDICT_FUSED,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start import align, yaw_reset
from cython.cimports.ekf_companion.core.trust import doubt, slide
from cython.cimports.ekf_companion.core.trust.gate import begin_reset, count_verdict, note_used
from cython.cimports.ekf_companion.core.trust.repair import let_go
from cython.cimports.ekf_companion.core.trust.shape import take_off

LEAST_YAW_VAR = cython.declare(cython.double, 2.5e-3)
"""Variance of a heading found in motion, beside what the bank says, rad^2: in a steady turn a bias
of the accelerometer is taken for a part of the turn."""
PATIENCE = cython.declare(cython.double, 3e9)
"""Where no heading comes to find the attitude with, it is left to the filter after so long, ns."""
PROVING = cython.declare(cython.double, 2.5e9)
"""Time for which an attitude found in motion is not called good: fixes are to confirm it, ns."""
ANY = cython.declare(cython.double, 1e6)
"""Variance of an unknown position or velocity, m^2 or (m/s)^2."""


def start_navigation(x: State, k: Parameters, w: Scratch, has_vel: bool) -> None:
    """Begin to navigate at a fix; the first one ever is the origin of the local frame.

    Where the origin was given, so was the slow error that the receiver had: by that the position
    differs from the fix, and goes on from where it was before.
    """
    if x.origin.is_known == 0.0:
        set_origin(x, w.fix.lat, w.fix.lon, w.fix.alt)
    x.mode = MODE_NAVIGATE
    x.has_aid[AID_BARO] = 0.0
    north = x.gnss_offset[0]
    east = x.gnss_offset[1]
    down = x.gnss_offset[2]
    for i in range(3):
        x.vel_n[i] = 0.0
    reset_variance(x, E_VEL, 3, 0.04 if x.at_rest != 0.0 else 100.0)
    reset_to_fix(x, k, w, has_vel)
    move_to_offset(x, 0, north)
    move_to_offset(x, 1, east)
    move_to_offset(x, 2, down)
    x.proven_t = x.t if x.at_rest != 0.0 else x.t + PROVING
    x.used_t[AID_VELOCITY] = x.t
    x.used_t[AID_BARO] = x.t


def start_without_fix(x: State, std: float) -> None:
    """Begin to navigate at the position that an aid has written, of this sigma, m.

    Where that is on the Earth nobody knows: there is no origin, or no more.
    """
    if x.origin.is_known != 0.0:
        begin_reset(x, RESET_ORIGIN)
        x.origin.is_known = 0.0
    x.mode = MODE_NAVIGATE
    doubt.restart(x)  # no fix tells how much of the shaking is noise; by poses all would be
    forget_offsets(x)
    x.has_aid[AID_BARO] = 0.0
    for i in range(3):
        x.vel_n[i] = 0.0
    reset_variance(x, E_POS, 3, std * std)
    reset_variance(x, E_VEL, 3, 0.04 if x.at_rest != 0.0 else 25.0)
    x.proven_t = x.t if x.at_rest != 0.0 else x.t + PROVING


def join_fixes(x: State, k: Parameters, w: Scratch, has_vel: bool) -> bool:
    """Go on from a start without fixes when they come; return whether that could be.

    Where north is known the position stays, and the origin becomes the place that this makes of
    the fix. Where the start's frame was turned anyhow, the yaw bank has to find north first.
    """
    fix = address(w.fix)
    o = address(w.observation)
    if x.azimuth == 0.0:
        if not yaw_reset.is_ready(x):
            return False
        begin_reset(x, RESET_ORIGIN)
        start_from_yaw_bank(x, k, w)
        return True
    set_origin(x, fix.lat, fix.lon, fix.alt)
    gnss.position(x, k, fix, o)
    lat = fix.lat + o.z[0] / x.origin.scale_n
    lon = fix.lon + o.z[1] / x.origin.scale_e
    gnss.height(x, k, fix, o)
    set_origin(x, lat, lon, fix.alt - o.z[0])
    reset_to_fix(x, k, w, has_vel)
    return True


def move_to_offset(x: State, axis: int, offset: float) -> None:
    """Take a part of the fix along one axis, which position was set from, for its slow error."""
    x.gnss_offset[axis] += offset
    x.pos_n[axis] -= offset
    x.moved.pos_n[axis] -= offset


def start_from_yaw_bank(x: State, k: Parameters, w: Scratch) -> None:
    """Start, or start again, at a fix with the attitude that the yaw bank has found."""
    yaw_std = x.yaw_bank.yaw_std
    height = x.pos_n[2]
    height_var = x.P[E_POS + 2][E_POS + 2]
    keeps_height = cython.declare(
        cython.bint, x.mode == MODE_NAVIGATE and x.voices.is_rushing != 0.0
    )
    if k.weighs_faults == WEIGH_ACT:  # what was declared beside a wrong attitude may be its work
        if x.mode == MODE_NAVIGATE:
            doubt_jump(x, k, w)
        let_go(x, k, address(w.observation.bank[0]), address(w.observation))
    x.moved.yaw += yaw_reset.yaw_error(x)
    yaw_reset.take_attitude(x)
    if x.mode != MODE_LEVEL:
        # learnt by a wrong attitude
        for i in range(3):
            x.accel_bias[i] = 0.0
            x.hard_iron[i] = 0.0
    for i in range(3):
        # the bank has its own
        set_variance(x, E_BG + i, 0.0)
    x.alignment.reference.is_known = 0.0
    if x.mode == MODE_NAVIGATE:
        # it begins at zero, and what it is set to from there is no jump
        for i in range(3):
            x.moved.pos_n[i] -= x.pos_n[i]
            x.moved.vel_n[i] -= x.vel_n[i]
    align.start_filter(x, k, w, x.yaw_bank.tilt_std, x.yaw_bank.gyro_bias_std)
    forget_gain(x)
    x.has_yaw = 1.0
    x.used_t[AID_HEADING] = x.t
    reset_variance(x, E_ATT + 2, 1, yaw_std * yaw_std + LEAST_YAW_VAR)
    # what a compass has said until now counts for nothing: its error is to be found
    reset_variance(x, E_HEADING, 1, UNKNOWN_ANGLE)
    start_navigation(x, k, w, True)
    if keeps_height:  # the receiver's is not heard
        x.moved.pos_n[2] += height - x.pos_n[2]
        x.pos_n[2] = height
        reset_variance(x, E_POS + 2, 1, height_var)


def doubt_jump(x: State, k: Parameters, w: Scratch) -> None:
    """Take as much of a jump that nothing explains for the receiver's error as for ours.

    At a reset to a fix that is further off than what is known of both: nothing shows whose it is.
    """
    o = address(w.observation)
    b = address(o.bank[0])
    gnss.position(x, k, address(w.fix), o)
    take_off(x, o, AID_POSITION)
    if innovate(x, o) > 2.0 * THREE_SIGMA2:
        for i in range(2):
            b.let_go[0] += 0.5 * o.z[i] * o.z[i]
            x.gnss_offset_var[0] += 0.5 * o.z[i] * o.z[i]
    gnss.height(x, k, address(w.fix), o)
    take_off(x, o, AID_HEIGHT)
    if innovate(x, o) > THREE_SIGMA2:
        b.let_go[1] += 0.5 * o.z[0] * o.z[0]
        x.gnss_offset_var[1] += 0.5 * o.z[0] * o.z[0]


def resume_after_gap(x: State, k: Parameters, w: Scratch, has_vel: bool) -> None:
    """Go by the fixes alone after a long gap, until they have shown the attitude.

    Nobody saw the vehicle turn: by an attitude that may be half a radian and more off no fix can
    be judged, and what a linear filter learns from it is wrong and claims to be right.
    """
    if x.needs_reset == NEEDS_FIX:
        x.needs_reset = NEEDS_TILT
        begin_reset(x, RESET_GAP)
    if not has_vel or align.level_again(x, k, w) or x.t - x.alignment.motion.fix_t > PATIENCE:
        x.needs_reset = 0.0
        x.alignment.motion.has_fix = 0.0
    reset_to_fix(x, k, w, has_vel)


def reset_to_fix(x: State, k: Parameters, w: Scratch, has_vel: bool) -> None:
    """Set velocity, position and height from a fix."""
    if has_vel:
        reset_velocity(x, k, w)
        count_verdict(x, AID_VELOCITY, VERDICT_FUSED)
    reset_position(x, k, w)
    reset_height(x, k, w)
    count_verdict(x, AID_POSITION, VERDICT_FUSED)
    count_verdict(x, AID_HEIGHT, VERDICT_FUSED)


def reset_position(x: State, k: Parameters, w: Scratch) -> None:
    """Set the horizontal position from a fix, which has its slow error."""
    o = address(w.observation)
    for i in range(2):
        x.gnss_offset[i] = 0.0
    reset_variance(x, E_GNSS, 2, x.gnss_offset_var[0])
    reset_variance(x, E_POS, 2, ANY)
    gnss.position(x, k, address(w.fix), o)
    if o.has_bank:
        take_off(x, o, AID_POSITION)
    for i in range(2):
        x.pos_n[i] += o.z[i]
        x.moved.pos_n[i] += o.z[i]
        o.z[i] = 0.0
    innovate(x, o)
    apply_update(x, o)
    x.innovation_mean[0] = 0.0
    x.innovation_mean[1] = 0.0
    x.is_one_sided[AID_POSITION] = 0.0
    note_used(x, AID_POSITION)
    slide.follow(x, address(w.fix), True)


def reset_height(x: State, k: Parameters, w: Scratch) -> None:
    """Set the height from a fix, which has its slow error."""
    o = address(w.observation)
    forget_offsets(x)
    x.gnss_offset[2] = 0.0
    reset_variance(x, E_GNSS + 2, 1, x.gnss_offset_var[1])
    reset_variance(x, E_POS + 2, 1, ANY)
    gnss.height(x, k, address(w.fix), o)
    if o.has_bank:
        take_off(x, o, AID_HEIGHT)
    x.pos_n[2] += o.z[0]
    x.moved.pos_n[2] += o.z[0]
    o.z[0] = 0.0
    innovate(x, o)
    apply_update(x, o)
    x.innovation_mean[2] = 0.0
    x.is_one_sided[AID_HEIGHT] = 0.0
    note_used(x, AID_HEIGHT)


def redraw_vel_offset(x: State) -> None:
    """Draw the error of the receiver's slow velocity anew, by what it is in the long run."""
    reset_variance(x, E_GNSS_VEL, 2, x.gnss_vel_offset_var[0])
    reset_variance(x, E_GNSS_VEL + 2, 1, x.gnss_vel_offset_var[1])


def forget_vel_offset(x: State) -> None:
    """Forget the slow error of the velocity: what taught it is wrong, or of before."""
    for i in range(3):
        x.gnss_vel_offset[i] = 0.0
    redraw_vel_offset(x)


def reset_velocity(x: State, k: Parameters, w: Scratch) -> None:
    """Set the velocity from a fix, with its slow error; an unknown vertical one: 0, sigma 2 m/s."""
    o = address(w.observation)
    if k.weighs_faults == WEIGH_ACT:  # a declared fault lives on in it
        redraw_vel_offset(x)
    else:
        forget_vel_offset(x)
    reset_variance(x, E_VEL, 3, ANY)
    gnss.velocity(x, k, address(w.fix), o)
    if o.has_bank:
        take_off(x, o, AID_VELOCITY)
    for i in range(o.rows):
        x.vel_n[i] += o.z[i]
        x.moved.vel_n[i] += o.z[i]
        o.z[i] = 0.0
    innovate(x, o)
    apply_update(x, o)
    if o.rows == 2:
        x.moved.vel_n[2] -= x.vel_n[2]
        x.vel_n[2] = 0.0
        reset_variance(x, E_VEL + 2, 1, 0.04 if x.at_rest != 0.0 else 4.0)
    note_used(x, AID_VELOCITY)


def reset_unknown_velocity(x: State, first: int, count: int) -> None:
    """Reset a velocity that has drifted with the position: to 0 with one sigma of 5 m/s."""
    for i in range(first, first + count):
        x.moved.vel_n[i] -= x.vel_n[i]
        x.vel_n[i] = 0.0
    reset_variance(x, E_VEL + first, count, 25.0)
