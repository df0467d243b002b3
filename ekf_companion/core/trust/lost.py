"""What shows if our own state is lost: by a blow, or a gyro that turns by itself.

An attitude that is wrong by a radian is no column times a size. But all readings agree then, and
are off by the same errors of ours: these go on from one reading to the next, and any attitude adds
of gravity to them. A receiver that is erratic does not agree with the barometer.
"""

from __future__ import annotations

from cython.cimports.ekf_companion.core.filter.observation import row_variance
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import UNKNOWN_ANGLE
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AID_HEADING,
    AID_HEIGHT,
    AID_POSITION,
    AID_REST,
    AID_VELOCITY,
    E_ATT,
    E_POS,
    E_VEL,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import shape
from cython.cimports.libc.math import log


def begin(k: Parameters, b: Bank) -> None:
    """Begin with what is known of the receiver's rows: as its larger faults."""
    for aid in range(AID_VELOCITY + 1):
        tail = k.fault[shape.offset_of(aid, 0)].tail
        for r in range(3):
            b.last[aid][r] = 0.0
            b.last_var[aid][r] = tail * tail


def keep(b: Bank, o: Observation, aid: int) -> None:
    """Keep what a reading shows for those after it."""
    for r in range(o.rows):
        b.last[aid][r] = o.z[r]
        b.last_var[aid][r] = row_variance(o, r)


def find_nis(x: State, k: Parameters, b: Bank, o: Observation, aid: int, group: int) -> float:
    """Return twice how unlikely the level (0) or vertical (1) rows of a reading are then.

    Of the variance the logarithm, as well, beside that of the filter's own.
    """
    total = 0.0
    for r in range(o.rows):
        if group == (1 if b.group[r] != 0.0 else 0):
            own = row_variance(o, r)
            expect(x, k, b, aid, r if group == 0 else 2)
            off = o.z[r] - b.trial.b[0]
            var = own + b.trial.M[0][0]
            total += off * off / var + log(var / own)
    return total


def expect(x: State, k: Parameters, b: Bank, aid: int, axis: int) -> None:
    """Write what a row on an axis shows then, ``b.trial.b[0]``, and its variance, ``b.trial.M``.

    A rest is a velocity, a barometer a height, upwards. Gravity that is turned by any attitude is
    off by two thirds of its square on each axis.
    """
    of = aid
    if aid == AID_REST:
        of = AID_VELOCITY
    elif aid == AID_BARO:
        of = AID_HEIGHT
    r = axis if of == AID_VELOCITY or of == AID_POSITION else 0
    since = b.read_dt if of == aid else (x.t - b.read_t[of]) * 1e-9
    fallen2 = k.gravity * k.gravity * since * since / 1.5
    off = b.last[of][r]
    var = b.last_var[of][r] + fallen2
    if aid == AID_HEADING:
        off = 0.0
        var = UNKNOWN_ANGLE
    elif of != AID_VELOCITY:
        led2 = b.last_var[AID_VELOCITY][axis] + 0.25 * fallen2
        off += b.last[AID_VELOCITY][axis] * since
        var = b.last_var[of][r] + led2 * since * since
    b.trial.b[0] = -off if aid == AID_BARO else off
    b.trial.M[0][0] = var


def widen(b: Bank, p: float) -> None:
    """Add to the mixture that it is so: the attitude is any, the rest as far off as it was last."""
    for i in range(3):
        pos = b.last[AID_POSITION][i] if i < 2 else b.last[AID_HEIGHT][0]
        vel = b.last[AID_VELOCITY][i]
        b.spread[E_ATT + i][E_ATT + i] += p * UNKNOWN_ANGLE
        b.spread[E_VEL + i][E_VEL + i] += p * vel * vel
        b.spread[E_POS + i][E_POS + i] += p * pos * pos
