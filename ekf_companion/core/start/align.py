"""Initial alignment: level and heading before the filter starts.

At rest the mean specific force points up and the mean rate is the gyro's bias. In motion the
specific force, summed in a frame that the gyro holds still, must equal the change of the GNSS
velocity less gravity: that gives down without standing still. North comes from a reference: a
heading, or the magnetic field.

Source: Groves 2013, section 5.6 (levelling); in motion: Silson 2011, "Coarse alignment of a ship's
strapdown inertial attitude reference system using velocity loci".
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids.delay import first_variance
from cython.cimports.ekf_companion.core.aids.heading import azimuth
from cython.cimports.ekf_companion.core.aids.rest import force_variance
from cython.cimports.ekf_companion.core.filter.rotation import (
    normalise,
    rotate,
    rotate_body,
    to_dcm,
    wrap,
)
from cython.cimports.ekf_companion.core.filter.slow_error import (
    clear_covariance,
    reset_variance,
    set_covariance,
    set_variance,
)
from cython.cimports.ekf_companion.core.memory.constants import UNKNOWN_ANGLE
from cython.cimports.ekf_companion.core.memory.enums import (
    AZIMUTH_FIELD,
    E_ATT,
    E_BA,
    E_BG,
    E_DELAY,
    E_HEADING,
    E_IRON,
    E_POS,
    E_VEL,
    MODE_ATTITUDE,
    MODE_LEVEL,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Motion, Pair, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start.yaw_reset import reset_yaw
from cython.cimports.libc.math import atan2, cos, isnan, sin, sqrt

REFERENCE_AGE = cython.declare(cython.double, 1.5e9)
"""Oldest heading reference to start from, ns."""
LONGEST_MOTION = cython.declare(cython.double, 5e9)
"""Longest stretch to level over in motion, ns: the gyro's bias turns the frame meanwhile."""
UNKNOWN_DELAY = cython.declare(cython.double, 0.05)
"""Delay of a receiver beside its sigma while nothing has shown it, s."""
SHAKEN = cython.declare(cython.double, 0.2)
"""Share of the force's spread that may be vibration which samples as a slow wave."""
SHAKEN_TIME = cython.declare(cython.double, 1.6)
"""Time for which such a wave pushes to one side, s."""
LARGEST_SHAKEN = cython.declare(cython.double, 300.0)
"""Largest doubt to start with."""
LEVEL_ENOUGH = cython.declare(cython.double, 0.1)
"""Largest acceleration to level in without north, as a share of gravity."""


def set_attitude(x: State, w: Scratch, p: Pair) -> None:
    """Set the attitude that turns p.b into p.n, with the reference at its azimuth.

    Without a reference the body's forward axis points north. Normalises the pair.
    """
    size_b = sqrt(p.b[0] * p.b[0] + p.b[1] * p.b[1] + p.b[2] * p.b[2])
    size_n = sqrt(p.n[0] * p.n[0] + p.n[1] * p.n[1] + p.n[2] * p.n[2])
    for i in range(3):
        p.b[i] = p.b[i] / size_b
        p.n[i] = p.n[i] / size_n
    # The shortest turn of b into n; opposite directions leave the axis open: take forward
    dot = p.b[0] * p.n[0] + p.b[1] * p.n[1] + p.b[2] * p.n[2]
    if dot > -0.999999:
        x.q_nb[0] = 1.0 + dot
        x.q_nb[1] = p.b[1] * p.n[2] - p.b[2] * p.n[1]
        x.q_nb[2] = p.b[2] * p.n[0] - p.b[0] * p.n[2]
        x.q_nb[3] = p.b[0] * p.n[1] - p.b[1] * p.n[0]
    else:
        x.q_nb[0] = 0.0
        x.q_nb[1] = 1.0
        x.q_nb[2] = 0.0
        x.q_nb[3] = 0.0
    normalise(x.q_nb)
    # Then about p.n until the reference's azimuth is right; that is not quite vertical, so iterate
    o = address(w.observation)
    reference = address(x.alignment.reference)
    bx = 1.0
    by = 0.0
    bz = 0.0
    target = 0.0
    if has_reference(x):
        bx = reference.direction_b[0]
        by = reference.direction_b[1]
        bz = reference.direction_b[2]
        target = reference.azimuth
    for _ in range(4):
        to_dcm(x.q_nb, o.C_nb)
        dot = wrap(
            target
            - atan2(
                o.C_nb[1][0] * bx + o.C_nb[1][1] * by + o.C_nb[1][2] * bz,
                o.C_nb[0][0] * bx + o.C_nb[0][1] * by + o.C_nb[0][2] * bz,
            )
        )
        rotate(x.q_nb, -p.n[0] * dot, -p.n[1] * dot, -p.n[2] * dot)


def has_reference(x: State) -> bool:
    """Return whether there is a direction of known azimuth, and it is not too old."""
    reference = address(x.alignment.reference)
    return reference.is_known != 0.0 and x.t - reference.t <= REFERENCE_AGE


def learnt_variance(x: State, first: int, count: int, std: float) -> float:
    """Return the variance of some states at the start: what is left of before, or the sigma's."""
    variance = 0.0
    for i in range(first, first + count):
        if x.P[i][i] > variance:
            variance = x.P[i][i]
    if x.mode == MODE_LEVEL and 0.0 < variance < std * std:
        return variance
    return std * std


def start_filter(x: State, k: Parameters, w: Scratch, tilt: float, gyro_bias: float) -> None:
    """Set the covariance of an attitude just found, by the sigmas of tilt and gyro bias.

    A levelled attitude is wrong by what is not known of the accelerometer's bias, so the two are
    correlated: ``theta_N = (C ba)_E / g``, ``theta_E = -(C ba)_N / g``. Biases and hard iron stay
    as they are, with the variances that there are: none, or what was learnt before the clock began
    anew. The receiver's delay stays as it was learnt, since no attitude has taught it.
    """
    o = address(w.observation)
    variance = learnt_variance(x, E_BA, 3, k.accel_bias_std)
    rate = learnt_variance(x, E_BG, 3, gyro_bias)
    delay = x.P[E_DELAY][E_DELAY]
    if not 0.0 < delay < first_variance(x, k):
        delay = first_variance(x, k)
    iron = learnt_variance(x, E_IRON, 3, k.iron_std)
    g = k.gravity
    clear_covariance(x)
    reset_variance(x, E_ATT, 2, tilt * tilt + variance / (g * g))
    reset_variance(x, E_BA, 3, variance)
    reset_variance(x, E_BG, 3, rate)
    to_dcm(x.q_nb, o.C_nb)
    for i in range(3):
        set_covariance(x, E_ATT, E_BA + i, variance * o.C_nb[1][i] / g)
        set_covariance(x, E_ATT + 1, E_BA + i, -variance * o.C_nb[0][i] / g)
    reset_variance(x, E_VEL, 3, 0.01)
    reset_variance(x, E_POS, 3, 1.0)
    reset_variance(x, E_DELAY, 1, delay)
    x.heading_offset = 0.0
    x.has_yaw = 0.0
    set_variance(x, E_ATT + 2, UNKNOWN_ANGLE)
    for i in range(3):
        x.vel_n[i] = 0.0
        x.pos_n[i] = 0.0
        if x.mode == MODE_NAVIGATE:  # else there is none, or it was given with the origin
            x.gnss_offset[i] = 0.0
        x.gnss_vel_offset[i] = 0.0
    reset_variance(x, E_IRON, 3, iron)
    reset_variance(x, E_HEADING, 1, x.heading_std * x.heading_std)
    x.mode = MODE_ATTITUDE
    for i in range(3):
        x.accel_n[i] = 0.0
        for j in range(3):
            x.accel_n[i] += o.C_nb[i][j] * (x.accel[j] - x.accel_bias[j])
    x.accel_n[2] += g
    if has_reference(x) and azimuth(x, o, address(x.alignment.reference)):
        # the attitude points there already; the row says how sure that is
        o.z[0] = 0.0
        reset_yaw(x, o)


def level_by_window(x: State, w: Scratch) -> None:
    """Set the attitude so that the window's mean specific force points up."""
    rest = address(x.alignment.rest)
    p = address(w.pair)
    for i in range(3):
        p.b[i] = rest.accel[i] - rest.n * x.accel_bias[i]
        p.n[i] = 0.0
    p.n[2] = -1.0
    set_attitude(x, w, p)


def level_at_rest(x: State, k: Parameters, w: Scratch) -> None:
    """Set attitude and gyro bias from a window of rest."""
    rest = address(x.alignment.rest)
    n = rest.n
    var_gyro = 0.0
    for i in range(3):
        mean = rest.gyro[i] / n
        var_gyro += rest.gyro2[i] / n - mean * mean
    level_by_window(x, w)
    # Equal samples have no variance, but rounding may leave it below zero
    x.rest_gyro = var_gyro if var_gyro > 0.0 else 0.0
    x.rest_accel = force_variance(x)
    start_filter(x, k, w, sqrt(x.rest_accel / n) / k.gravity + 1e-3, k.gyro_bias_std)


def level_roughly(x: State, k: Parameters, w: Scratch) -> None:
    """Set the attitude from the mean specific force of a window with motion."""
    level_by_window(x, w)
    start_filter(x, k, w, 0.15, k.gyro_bias_std)


def begin_motion(x: State, fix: Fix) -> None:
    """Begin to sum the specific force at a fix that has a velocity."""
    motion = address(x.alignment.motion)
    motion.has_fix = 1.0
    motion.fix_t = x.t
    motion.fix_std = fix.std[2]
    for i in range(3):
        motion.force[i] = x.accel[i]
    motion.q[0] = 1.0
    for i in range(3):
        motion.fix_vel[i] = fix.vel_n[i]
        motion.q[i + 1] = 0.0
        motion.dv[i] = 0.0


def integrate(x: State, m: Motion, dt: float) -> None:
    """Carry the reference along with the turning body, and the force summed in a still frame."""
    b = address(x.alignment.reference)
    motion = address(x.alignment.motion)
    px = (m.rate[0] - x.gyro_bias[0]) * dt
    py = (m.rate[1] - x.gyro_bias[1]) * dt
    pz = (m.rate[2] - x.gyro_bias[2]) * dt
    if b.is_known != 0.0:
        # what stands still turns against the body: b - p x b + p x (p x b) / 2
        cx = py * b.direction_b[2] - pz * b.direction_b[1]
        cy = pz * b.direction_b[0] - px * b.direction_b[2]
        cz = px * b.direction_b[1] - py * b.direction_b[0]
        b.direction_b[0] += 0.5 * (py * cz - pz * cy) - cx
        b.direction_b[1] += 0.5 * (pz * cx - px * cz) - cy
        b.direction_b[2] += 0.5 * (px * cy - py * cx) - cz
    if motion.has_fix == 0.0:
        return
    rotate_body(motion.q, 0.5 * px, 0.5 * py, 0.5 * pz)
    to_dcm(motion.q, m.C_fb)
    for i in range(3):
        motion.dv[i] += dt * (
            m.C_fb[i][0] * (m.force[0] - x.accel_bias[0])
            + m.C_fb[i][1] * (m.force[1] - x.accel_bias[1])
            + m.C_fb[i][2] * (m.force[2] - x.accel_bias[2])
        )
    rotate_body(motion.q, 0.5 * px, 0.5 * py, 0.5 * pz)


def turn_to_field(x: State, w: Scratch, p: Pair) -> float:
    """Turn the attitude about p.n (unit) until the magnetic field points where it does here.

    Return the variance of that turn, rad^2. The azimuth of a steep field alone would say little
    about a turn round an axis that leans towards it.
    """
    b = address(x.alignment.reference)
    o = address(w.observation)
    to_dcm(x.q_nb, o.C_nb)
    size = sqrt(
        b.direction_b[0] * b.direction_b[0]
        + b.direction_b[1] * b.direction_b[1]
        + b.direction_b[2] * b.direction_b[2]
    )
    n = 0.0
    e = 0.0
    d = 0.0
    for i in range(3):
        n += o.C_nb[0][i] * b.direction_b[i] / size
        e += o.C_nb[1][i] * b.direction_b[i] / size
        d += o.C_nb[2][i] * b.direction_b[i] / size
    dn = p.n[0]
    de = p.n[1]
    dd = p.n[2]
    along = n * dn + e * de + d * dd
    level = n * n + e * e
    if x.azimuth == AZIMUTH_FIELD and x.field.strength > 0.0:
        fn = cos(x.field.inclination) * cos(x.field.declination)
        fe = cos(x.field.inclination) * sin(x.field.declination)
        fd = sin(x.field.inclination)
        a = atan2(
            dn * (e * fd - d * fe) + de * (d * fn - n * fd) + dd * (n * fe - e * fn),
            n * fn + e * fe + d * fd - along * (fn * dn + fe * de + fd * dd),
        )
        rotate(x.q_nb, a * dn, a * de, a * dd)
        level = fn * fn + fe * fe
    across = 1.0 - along * along
    if across < 0.01:
        across = 0.01
    return (x.heading_std * x.heading_std + b.std * b.std) * level / across


def find_down(x: State, k: Parameters, w: Scratch) -> float:
    """Set the attitude at the fix ``w.fix`` from the velocity gained since the first one.

    Turns the summed force into the body frame of now, so that the attitude is of now. Return one
    sigma of the tilt, rad; 0 if it is too early, or too much was gained where nothing gives north.
    """
    fix = address(w.fix)
    motion = address(x.alignment.motion)
    o = address(w.observation)
    p = address(w.pair)
    span = (x.t - motion.fix_t) * 1e-9
    if motion.has_fix == 0.0 or x.t - motion.fix_t > LONGEST_MOTION:
        begin_motion(x, fix)
        return 0.0
    if span < k.align_time:
        return 0.0
    down = 0.0
    doubt = 2.0 * fix.std[2]
    if isnan(fix.vel_n[2]) or isnan(motion.fix_vel[2]):
        doubt = doubt + 1.0  # a climb that began meanwhile; it hardly tilts
    else:
        down = fix.vel_n[2] - motion.fix_vel[2]
    dn = fix.vel_n[0] - motion.fix_vel[0]
    de = fix.vel_n[1] - motion.fix_vel[1]
    down = down - k.gravity * span
    to_dcm(motion.q, o.C_nb)
    change = 0.0
    for i in range(3):
        p.b[i] = (
            o.C_nb[0][i] * motion.dv[0] + o.C_nb[1][i] * motion.dv[1] + o.C_nb[2][i] * motion.dv[2]
        )
        gained = -motion.force[i]
        for j in range(3):
            gained += o.C_nb[i][j] * x.accel[j]
        change += gained * gained
    # A receiver that is late tells of another stretch
    doubt = doubt + sqrt(change) * (k.delay_std + UNKNOWN_DELAY)
    doubt = doubt + SHAKEN * sqrt(force_variance(x)) * span
    if not has_reference(x):
        # without north, what was gained is tilt
        doubt = doubt + sqrt(dn * dn + de * de)
        if doubt > LEVEL_ENOUGH * k.gravity * span:
            return 0.0
        dn = 0.0
        de = 0.0
    p.n[0] = dn
    p.n[1] = de
    p.n[2] = down
    set_attitude(x, w, p)
    # A wrong turn about a force that was not upright is tilt as well
    size = sqrt(dn * dn + de * de + down * down)
    turned = turn_to_field(x, w, p) if has_reference(x) else 0.0
    doubt = doubt / (k.gravity * span) + k.gyro_bias_std * span + 0.02
    return sqrt(doubt * doubt + turned * (dn * dn + de * de) / (size * size))


def level_in_motion(x: State, k: Parameters, w: Scratch) -> bool:
    """Start the filter at the fix ``w.fix`` if its attitude can be found in motion."""
    tilt = find_down(x, k, w)
    if tilt == 0.0:
        return False
    start_filter(x, k, w, tilt, k.gyro_bias_std)
    # what shakes it is motion or vibration: the first fixes will tell
    shaken = SHAKEN * sqrt(force_variance(x)) / k.accel_noise
    shaken = shaken * shaken * SHAKEN_TIME
    shaken = shaken if shaken < LARGEST_SHAKEN else LARGEST_SHAKEN
    if x.doubt < shaken:
        x.doubt = shaken
    return x.has_yaw != 0.0


def level_again(x: State, k: Parameters, w: Scratch) -> bool:
    """Find the attitude of a running filter anew at the fix ``w.fix``, if it can be found."""
    if not has_reference(x) and x.alignment.motion.has_fix != 0.0:
        return False
    tilt = find_down(x, k, w)
    if tilt == 0.0:
        return False
    reset_variance(x, E_ATT, 2, tilt * tilt)
    # right already, but how sure it is the next heading says, by the tilt that it is seen with
    reset_variance(x, E_ATT + 2, 1, UNKNOWN_ANGLE)
    reset_variance(x, E_HEADING, 1, x.heading_std * x.heading_std)
    x.heading_offset = 0.0
    return True
