"""Shapes of the faults: where each enters, the state at its onset or the readings since.

What a fault of unit size adds to the state when it begins is ``U``; to a reading it adds ``D``.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.past import acceleration_at, gained_until
from cython.cimports.ekf_companion.core.memory.bank import MOVING, Bank, Instance
from cython.cimports.ekf_companion.core.memory.constants import SETTLING, THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEADING,
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    AZIMUTH_MAGNETIC,
    E_ATT,
    E_BA,
    E_BG,
    E_DELAY,
    E_GNSS_VEL,
    E_IRON,
    E_POS,
    E_VEL,
    FAULT_ACCEL_LOUD,
    FAULT_ACCEL_NOISE,
    FAULT_ACCEL_STEP,
    FAULT_ALIGNMENT,
    FAULT_BARO_RAMP,
    FAULT_BARO_SCALE,
    FAULT_BARO_SPEED,
    FAULT_BARO_STEP,
    FAULT_BARO_WILD,
    FAULT_BODY_FIELD,
    FAULT_CLIMB_STEP,
    FAULT_DELAY,
    FAULT_DRAG,
    FAULT_DRAG_RAMP,
    FAULT_FADE,
    FAULT_FADE_HEIGHT,
    FAULT_FALL,
    FAULT_FALL_RAMP,
    FAULT_FALL_WILD,
    FAULT_FIELD,
    FAULT_GYRO_LOUD,
    FAULT_GYRO_NOISE,
    FAULT_GYRO_STEP,
    FAULT_HALT,
    FAULT_HALT_BARO,
    FAULT_HALT_HEIGHT,
    FAULT_HEADING_STEP,
    FAULT_HEIGHT_RAMP,
    FAULT_HEIGHT_STEP,
    FAULT_KICK,
    FAULT_LED,
    FAULT_LED_ON,
    FAULT_LEVER,
    FAULT_POSITION_RAMP,
    FAULT_POSITION_STEP,
    FAULT_POSITION_WILD,
    FAULT_RECOVERY,
    FAULT_RECOVERY_HEADING,
    FAULT_RECOVERY_HEIGHT,
    FAULT_SETTLE,
    FAULT_SETTLE_HEIGHT,
    FAULT_TILT,
    FAULT_VELOCITY_LAG,
    FAULT_VELOCITY_SCALE,
    FAULT_VELOCITY_STEP,
    FAULT_VELOCITY_TURN,
    FAULT_YAW,
    FAULTS,
    SOURCE_BARO,
    SOURCE_CLIMB,
    SOURCE_DRAG,
    SOURCE_FALL,
    SOURCE_HEIGHT,
    SOURCE_POSITION,
    SOURCE_VELOCITY,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Dcm
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import delay_search
from cython.cimports.libc.math import exp, sqrt

SETTLING_VAR = cython.declare(cython.double, 0.4)
"""Variance of the logarithm of that: 1.9 times faster or slower, half of what the times of
``onsets.begin_settling`` are apart."""
ALIGNING = cython.declare(cython.double, 1.0)
"""Rate at which an autopilot's heading comes back, 1/s: PX4's did by 2 in flight, ArduPilot's by
half of one after its start, as recorded."""
FAST = cython.declare(cython.double, 225.0)
"""Square of the speed that the barometer's error by speed is given at, (m/s)^2."""


def is_end(kind: int) -> bool:
    """Return whether a hypothesis is that declared faults have ended."""
    return (
        kind == FAULT_RECOVERY
        or kind == FAULT_RECOVERY_HEIGHT
        or is_halt(kind)
        or is_fading(kind)
        or kind == FAULT_RECOVERY_HEADING
    )


def is_halt(kind: int) -> bool:
    """Return whether a hypothesis is that a declared slide has stopped where it was."""
    return kind == FAULT_HALT or kind == FAULT_HALT_HEIGHT or kind == FAULT_HALT_BARO


def is_fading(kind: int) -> bool:
    """Return whether a hypothesis is that what was declared fades."""
    return kind == FAULT_FADE or kind == FAULT_FADE_HEIGHT


def is_wild(kind: int) -> bool:
    """Return whether a hypothesis is that a source is wrong in no shape."""
    return kind == FAULT_BARO_WILD or FAULT_POSITION_WILD <= kind <= FAULT_FALL_WILD


def rows_of(aid: int, source: int) -> int:
    """Return which rows of an aid a source makes: 0, the level; 1, the vertical; -1, none."""
    if aid == AID_VELOCITY:
        if source == SOURCE_VELOCITY or source == SOURCE_DRAG:
            return 0
        return 1 if source == SOURCE_CLIMB or source == SOURCE_FALL else -1
    if aid == AID_POSITION:
        return 0 if source == SOURCE_POSITION or source == SOURCE_DRAG else -1
    if aid == AID_HEIGHT:
        return 1 if source == SOURCE_HEIGHT or source == SOURCE_FALL else -1
    return 1 if aid == AID_BARO and source == SOURCE_BARO else -1


def offset_of(aid: int, group: int) -> int:
    """Return the fault that is an offset of the level (0) or vertical (1) rows of an aid."""
    if aid == AID_POSITION:
        return FAULT_POSITION_STEP
    if aid == AID_VELOCITY:
        return FAULT_VELOCITY_STEP if group == 0 else FAULT_CLIMB_STEP
    return FAULT_HEIGHT_STEP if aid == AID_HEIGHT else FAULT_BARO_STEP


def first_axis(kind: int) -> int:
    """Return the first of the axes that an end is about: position n e d, barometer."""
    if kind == FAULT_RECOVERY or kind == FAULT_HALT or kind == FAULT_FADE:
        return 0
    return 3 if kind == FAULT_HALT_BARO else 2


def last_axis(kind: int) -> int:
    """Return the last of them."""
    return 1 if first_axis(kind) == 0 else first_axis(kind)


def can_begin(x: State, b: Bank, kind: int) -> bool:
    """Return whether a fault can begin: what ends is larger than all that is not known of it."""
    if is_halt(kind):
        return slide_square(b, kind) > 0.0
    if is_fading(kind) and slide_square(b, kind) > 0.0:  # it slides on, and does not come back
        return False
    return not is_end(kind) or held_square(b, kind) > THREE_SIGMA2 * end_variance(x, b, kind)


def held_square(b: Bank, kind: int) -> float:
    """Return the square of what is held of a receiver's position, or height, m^2."""
    square = 0.0
    for axis in range(first_axis(kind), last_axis(kind) + 1):
        square += b.held[axis] * b.held[axis]
    return square


def slide_square(b: Bank, kind: int) -> float:
    """Return the square of the rate at which a declared slide goes on, (m/s)^2."""
    square = 0.0
    for axis in range(first_axis(kind), last_axis(kind) + 1):
        square += b.drift[axis] * b.drift[axis]
    return square


def end_variance(x: State, b: Bank, kind: int) -> float:
    """Return the variance of how far ours is from where the receiver is right again, m^2."""
    if first_axis(kind) == 0:
        return x.P[E_POS][E_POS] + x.P[E_POS + 1][E_POS + 1] + b.natural[0]
    return x.P[E_POS + 2][E_POS + 2] + b.natural[1]


def aid_of(kind: int) -> int:
    """Return the aid in whose readings an end shows."""
    first = first_axis(kind)
    if first == 0:
        return AID_POSITION
    return AID_HEIGHT if first == 2 else AID_BARO


def begin(x: State, k: Parameters, b: Bank, i: int) -> None:
    """Write what a fault of the state adds to it at once: U."""
    h = address(b.instance[i])
    kind = h.kind
    if kind == FAULT_ACCEL_STEP or kind == FAULT_ACCEL_NOISE:
        for c in range(3):
            b.U[c][E_BA + c][i] = 1.0
    elif kind == FAULT_GYRO_STEP or kind == FAULT_GYRO_NOISE:
        for c in range(3):
            b.U[c][E_BG + c][i] = 1.0
    elif kind == FAULT_GYRO_LOUD:
        for c in range(3):
            b.U[c][E_ATT + c][i] = 1.0
    elif kind == FAULT_KICK or kind == FAULT_ACCEL_LOUD:
        for c in range(3):
            b.U[c][E_VEL + c][i] = 1.0
    elif kind == FAULT_LED or kind == FAULT_LED_ON:
        # what seems to be at rest may be as wrong as another velocity
        off = k.fault[FAULT_VELOCITY_STEP].std
        speed = sqrt(x.vel_n[0] * x.vel_n[0] + x.vel_n[1] * x.vel_n[1] + off * off)
        for c in range(2):
            b.U[c][E_POS + c][i] = x.fix_dt * speed
            if kind == FAULT_LED_ON:
                b.U[2 + c][E_VEL + c][i] = speed
    elif kind == FAULT_TILT:
        b.U[0][E_ATT][i] = 1.0
        b.U[1][E_ATT + 1][i] = 1.0
    elif kind == FAULT_YAW:
        b.U[0][E_ATT + 2][i] = 1.0
    elif kind == FAULT_SETTLE:  # ours began at the first fix
        b.U[0][E_POS][i] = -1.0
        b.U[1][E_POS + 1][i] = -1.0
    elif kind == FAULT_SETTLE_HEIGHT:
        b.U[0][E_POS + 2][i] = -1.0
    elif is_wild(kind):  # what its readings have done is known
        h.b[0] = 1.0
        h.M[0][0] = 0.0
    elif kind == FAULT_DELAY:  # about what fits best; what that adds is known, and no part of b
        h.tau = delay_search.best(b)
        h.b[0] = h.tau
        h.b[1] = 1.0
        h.M[1][1] = 0.0
    elif kind == FAULT_ALIGNMENT:  # all angles are as likely
        h.b[0] = -1.0
    elif kind == FAULT_RECOVERY_HEADING:
        h.M[1][1] = SETTLING_VAR
    elif is_end(kind):
        h.b[0] = 1.0
        if is_halt(kind):
            h.M[0][0] = b.drift_var[first_axis(kind)] / slide_square(b, kind)
        else:
            h.M[0][0] = end_variance(x, b, kind) / held_square(b, kind)
        h.M[1][1] = SETTLING_VAR if is_fading(kind) else 0.0
        for axis in range(first_axis(kind), last_axis(kind) + 1):
            if axis < 3:
                b.U[0][E_GNSS_VEL + axis][i] = -x.gnss_vel_offset[axis]


def find_copies(x: State, b: Bank, i: int) -> None:
    """Let the slow errors that were found by ours have of a fault what ours has.

    Of one that has been since before: the height of the ground below a height that is off is as far
    off, and so is the barometer's offset. As far as the two still go together.
    """
    for e in range(N):
        source = cython.cast(cython.Py_ssize_t, x.copied[e])
        if x.redrawn[e] > 0.0 and source >= 0 and x.P[source][source] > 0.0:
            share = x.P[e][source] / x.P[source][source]
            for c in range(b.instance[i].rows):
                b.U[c][e][i] = share * b.U[c][source][i]


def is_absorbed(x: State, b: Bank, i: int) -> bool:
    """Return whether of an error of our own nothing is left beyond what is not known anyway.

    It has no source that goes on to be wrong: the filter itself has found it.
    """
    h = address(b.instance[i])
    for e in range(MOVING):
        off = 0.0
        var = 0.0
        for c in range(h.rows):
            off += b.U[c][e][i] * h.b[c]
            for d in range(h.rows):
                var += b.U[c][e][i] * h.M[c][d] * b.U[d][e][i]
        if off * off + var > x.P[e][e]:
            return False
    return True


def keep_field_slope(b: Bank, o: Observation) -> None:
    """Keep what a field in n does to the azimuth that is observed."""
    for c in range(2):
        b.field_slope[c] = 0.0
        for i in range(3):
            b.field_slope[c] += o.H[0][E_IRON + i] * o.C_nb[c][i]


def take_off(x: State, o: Observation, aid: int) -> None:
    """Take off an innovation what declared faults add to it, that no error state holds."""
    b = address(o.bank[0])
    if aid == AID_POSITION:
        o.z[0] -= b.held[0]
        o.z[1] -= b.held[1]
    elif aid == AID_HEIGHT:
        o.z[0] -= b.held[2]
    elif aid == AID_BARO:
        o.z[0] -= b.held[3]
    for kind in range(FAULTS):
        if b.declared[kind] == 0.0 or b.taken[kind][0] == 0.0:
            continue
        for r in range(3):
            for c in range(3):
                b.trial.D[r][c] = 0.0
        since = (x.t - b.taken_t[kind]) * 1e-9
        add_shape(x, b, kind, since, b.taken_tau[kind], b.taken_reference[kind], o, aid, b.trial.D)
        for r in range(o.rows):
            for c in range(3):
                o.z[r] -= b.trial.D[r][c] * b.taken[kind][c]
                o.R[r][r] += b.trial.D[r][c] * b.trial.D[r][c] * b.taken_var[kind][c]


def find_direct(x: State, b: Bank, h: Instance, o: Observation, aid: int) -> None:
    """Write what a fault adds to the reading itself: D, as ``b.trial.D[row][component]``."""
    for r in range(3):
        for c in range(3):
            b.trial.D[r][c] = 0.0
    if h.kind != FAULT_DELAY:
        add_shape(x, b, h.kind, (x.t - h.t0) * 1e-9, h.tau, h.reference, o, aid, b.trial.D)
    elif aid <= AID_VELOCITY:
        add_delay(x, b, h.tau, o, aid, b.trial.D)


def add_delay(x: State, b: Bank, later: float, o: Observation, aid: int, T: Dcm) -> None:
    """Add D of fixes that are later than taken to be, s: its slope there, and what is left of it.

    A velocity was another one then; a position was less far, by Simpson's rule.
    """
    if later == 0.0:
        for r in range(o.rows):
            T[r][0] += o.H[r][E_DELAY]
        return
    t = x.t - o.then.late * 1e9
    gained_until(x, t - 0.5e9 * later, b.trial.gain)
    gained_until(x, t - later * 1e9, b.trial.b)
    acceleration_at(x, t - later * 1e9, b.trial.M[0], b.trial.M[1])
    for r in range(o.rows):
        axis = r if aid != AID_HEIGHT else 2
        now = x.past.gained[axis] - x.vel_n[axis]
        if aid == AID_VELOCITY:
            slope = -b.trial.M[1][axis]
            whole = b.trial.b[axis] - o.then.until[axis]
        else:
            slope = now - b.trial.b[axis]
            whole = now - (o.then.until[axis] + 4.0 * b.trial.gain[axis] + b.trial.b[axis]) / 6.0
            whole *= later
        T[r][0] += slope
        T[r][1] += whole - slope * later


def find_end(b: Bank, since: float, T: Dcm) -> None:
    """Write how far a heading that was declared has come back, by its size and its rate."""
    left = exp(-ALIGNING * since)
    T[0][0] = 1.0 - left
    T[0][1] = -b.heading_off * left * ALIGNING * since


def add_shape(
    x: State,
    b: Bank,
    kind: int,
    since: float,
    tau: float,
    reference: float,
    o: Observation,
    aid: int,
    T: Dcm,
) -> None:
    """Add D of a fault that began some seconds ago, by what it needs to know of its onset."""
    if kind == FAULT_POSITION_STEP or kind == FAULT_POSITION_RAMP or kind == FAULT_DRAG:
        if aid == AID_POSITION:
            for r in range(2):
                T[r][r] += 1.0 if kind == FAULT_POSITION_STEP else since
        elif aid == AID_VELOCITY and kind == FAULT_DRAG:
            for r in range(2):
                T[r][r] += 1.0
    elif kind == FAULT_DRAG_RAMP:
        if aid == AID_POSITION or aid == AID_VELOCITY:
            for r in range(2):
                T[r][r] += 0.5 * since * since if aid == AID_POSITION else since
    elif kind == FAULT_FALL_RAMP:
        if aid == AID_HEIGHT:
            T[0][0] += 0.5 * since * since
        elif aid == AID_VELOCITY and o.rows == 3:
            T[2][0] += since
    elif kind == FAULT_SETTLE:
        if aid == AID_POSITION:
            for r in range(2):
                T[r][r] += exp(-since / tau)
    elif kind == FAULT_SETTLE_HEIGHT:
        if aid == AID_HEIGHT:
            T[0][0] += exp(-since / tau)
    elif kind == FAULT_RECOVERY_HEADING:
        if aid == AID_HEADING and tau != 0.0 and x.azimuth < AZIMUTH_MAGNETIC:
            find_end(b, since, T)
    elif is_end(kind):
        if aid == aid_of(kind):
            first = first_axis(kind)
            left = exp(-SETTLING * since)
            for r in range(o.rows):
                if is_halt(kind):
                    T[r][0] -= b.drift[first + r] * since
                elif is_fading(kind):
                    T[r][0] -= b.held[first + r] * (1.0 - left)
                    T[r][1] -= b.held[first + r] * left * SETTLING * since
                else:
                    T[r][0] -= b.held[first + r]
    elif kind == FAULT_VELOCITY_TURN:
        if aid == AID_VELOCITY:
            T[0][0] -= x.vel_n[1]
            T[1][0] += x.vel_n[0]
    elif kind == FAULT_BARO_SCALE:
        if aid == AID_BARO:
            T[0][0] += reference - x.pos_n[2]
    elif kind == FAULT_HEIGHT_STEP or kind == FAULT_HEIGHT_RAMP:
        if aid == AID_HEIGHT:
            T[0][0] += 1.0 if kind == FAULT_HEIGHT_STEP else since
    elif kind == FAULT_VELOCITY_STEP:
        if aid == AID_VELOCITY:
            for r in range(2):
                T[r][r] += 1.0
    elif kind == FAULT_FALL:
        if aid == AID_HEIGHT:
            T[0][0] += since
        elif aid == AID_VELOCITY and o.rows == 3:
            T[2][0] += 1.0
    elif kind == FAULT_CLIMB_STEP:
        if aid == AID_VELOCITY and o.rows == 3:
            T[2][0] += 1.0
    elif kind == FAULT_VELOCITY_SCALE:
        if aid == AID_VELOCITY:
            for r in range(o.rows):
                T[r][0] += x.vel_n[r]
    elif kind == FAULT_VELOCITY_LAG:
        if aid == AID_VELOCITY:
            for r in range(o.rows):
                T[r][0] -= o.then.accel_n[r]
    elif kind == FAULT_BARO_STEP or kind == FAULT_BARO_RAMP:
        if aid == AID_BARO:
            T[0][0] += 1.0 if kind == FAULT_BARO_STEP else since
    elif kind == FAULT_BARO_SPEED:
        if aid == AID_BARO:
            speed = 0.0
            for i in range(3):
                speed += x.vel_n[i] * x.vel_n[i]
            T[0][0] += speed / FAST
    elif kind == FAULT_HEADING_STEP:
        if aid == AID_HEADING and x.azimuth < AZIMUTH_MAGNETIC:
            T[0][0] += 1.0
    elif kind == FAULT_ALIGNMENT:
        if aid == AID_HEADING:
            T[0][1] -= 1.0
    elif kind == FAULT_FIELD:
        if aid == AID_HEADING:
            for c in range(2):
                for i in range(3):
                    T[0][c] += o.H[0][E_IRON + i] * o.C_nb[c][i]
    elif kind == FAULT_BODY_FIELD:
        if aid == AID_HEADING:
            for c in range(3):
                T[0][c] += o.H[0][E_IRON + c]
    elif kind == FAULT_LEVER:
        for c in range(3):
            if aid == AID_HEIGHT:
                T[0][c] += o.C_nb[2][c]
            elif aid == AID_POSITION or aid == AID_VELOCITY:
                for r in range(o.rows):
                    T[r][c] += o.C_nb[r][c] if aid == AID_POSITION else o.turn_nb[r][c]
