"""Use of the bank's heading: to start with, or to reset a main filter that is wrong.

The main filter may have begun by a compass that lies by 180 degrees, or have been led astray by one
in flight. Then it foretells velocities that the receiver contradicts, and the bank knows better. It
must not be disturbed for less: a reset is worse than a poor minute.

Source: the conditions are those asked for in PX4 pull request 27533 and ArduPilot issue 15813.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.filter.rotation import rotate, wrap
from cython.cimports.ekf_companion.core.filter.slow_error import reset_variance
from cython.cimports.ekf_companion.core.filter.update import apply_yaw_update, innovate
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import AID_HEADING, E_ATT
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import atan2, fabs, sqrt

ENOUGH = cython.declare(cython.double, 5.0)
"""Consecutive fixes with a narrow heading after which it is used."""
FAILING_NIS = cython.declare(cython.double, 4.0)
"""Mean normalised innovation squared, per degree, of velocities that contradict the filter."""
LARGEST_NIS = cython.declare(cython.double, 20.0)
"""Largest contribution of one fix to that mean."""
FAIL_TIME = cython.declare(cython.double, 1e9)
"""Least duration of the contradiction, and time constant of the mean, ns."""
FAIR_STD = cython.declare(cython.double, 0.5)
"""Largest stated sigma of velocities that may contradict it, m/s."""
LEAST_ERROR = cython.declare(cython.double, 0.2617993877991494)
"""Smallest error of the main yaw that is corrected, rad: 15 degrees."""
UNKNOWN_STD = cython.declare(cython.double, 1.8137993642342178)
"""One sigma of an unknown angle: pi / sqrt(3), rad."""
MOST_REPAIRS = cython.declare(cython.double, 3.0)
BETWEEN_REPAIRS = cython.declare(cython.double, 5e9)
"""Least time between two of them, ns."""


ANY_YAW = cython.declare(cython.double, 100.0)
"""Variance of an unknown yaw, rad^2."""


def is_ready(x: State) -> bool:
    """Return whether the bank's heading can be used."""
    return x.yaw_bank.good >= ENOUGH


def yaw_error(x: State) -> float:
    """Return the turn about the vertical that would bring the filter's attitude to the bank's, rad.

    Of the turn between the two attitudes it is the part about down, so that it has a meaning in
    any attitude, a dive included.
    """
    b = address(x.yaw_bank)
    w = (
        b.q_sb[0] * x.q_nb[0]
        + b.q_sb[1] * x.q_nb[1]
        + b.q_sb[2] * x.q_nb[2]
        + b.q_sb[3] * x.q_nb[3]
    )
    z = (
        b.q_sb[3] * x.q_nb[0]
        - b.q_sb[0] * x.q_nb[3]
        + b.q_sb[2] * x.q_nb[1]
        - b.q_sb[1] * x.q_nb[2]
    )
    return wrap(b.yaw + 2.0 * atan2(z, w))


def agrees(x: State) -> bool:
    """Return whether the bank has a heading that agrees with the filter's."""
    return is_ready(x) and fabs(yaw_error(x)) <= 3.0 * x.yaw_bank.yaw_std


def take_angle(x: State, b: Bank) -> None:
    """Take the angle that our yaw is off by for the bank's, where that is not sure of its own yet.

    As far as they agree. How far it is from a turn shows how wrong its model is, too.
    """
    i = columns.alignment(b)
    bank = address(x.yaw_bank)
    if i < 0 or is_ready(x) or bank.is_running == 0.0:
        return
    h = address(b.instance[i])
    c = 1.0 + h.b[0]
    s = h.b[1]
    square = c * c + s * s
    var = (s * s * h.M[0][0] - 2.0 * s * c * h.M[0][1] + c * c * h.M[1][1]) / (square * square)
    var += (1.0 - sqrt(square)) * (1.0 - sqrt(square))
    off = wrap(atan2(s, c) - yaw_error(x))
    if off * off < THREE_SIGMA2 * (var + bank.yaw_std * bank.yaw_std):
        bank.yaw = wrap(bank.yaw + off)
        bank.yaw_std = sqrt(var)
        bank.good = ENOUGH


def is_needed(x: State, nis: float, dt: float, std: float) -> bool:
    """Return whether the main filter's heading is wrong beyond doubt, at a velocity just judged.

    Args:
        x: The state.
        nis: Normalised innovation squared of the velocity, per degree of freedom; NaN: whatever
            it is, other evidence denies the velocity, which counts as the largest.
        dt: Since the fix before, s.
        std: What the receiver states for its velocity, m/s.
    """
    b = address(x.yaw_bank)
    gain = dt / (dt + FAIL_TIME * 1e-9)
    nis = nis if nis < LARGEST_NIS else LARGEST_NIS
    b.nis += gain * (nis - b.nis)
    if b.nis < FAILING_NIS:
        b.failing_t = x.t
        return False
    if x.t - b.failing_t < FAIL_TIME or std > FAIR_STD or not is_ready(x):
        return False
    if b.repairs >= MOST_REPAIRS:
        return False
    if b.repairs > 0.0 and x.t - b.repair_t < BETWEEN_REPAIRS:
        return False
    off = fabs(yaw_error(x))
    return off > LEAST_ERROR and off > 3.0 * b.yaw_std


def take_attitude(x: State) -> None:
    """Set the filter's attitude and gyro bias to the bank's."""
    for i in range(4):
        x.q_nb[i] = x.yaw_bank.q_sb[i]
    rotate(x.q_nb, 0.0, 0.0, x.yaw_bank.yaw)
    for i in range(3):
        x.gyro_bias[i] = x.yaw_bank.gyro_bias[i]


def note_repair(x: State) -> None:
    """Count a yaw reset by the bank."""
    b = address(x.yaw_bank)
    b.nis = 0.0
    b.failing_t = x.t
    b.repairs += 1.0
    b.repair_t = x.t


def slow_error(x: State, stated: float) -> float:
    """Return one sigma of a compass's slow error, rad; of a wrong one its error."""
    error = fabs(wrap(x.heading_offset))
    x.heading_offset = wrap(x.heading_offset)
    if error < LEAST_ERROR or error < stated:
        return stated
    return error if error < UNKNOWN_STD else UNKNOWN_STD


def reset_yaw(x: State, o: Observation) -> None:
    """Set the yaw by an observed azimuth; it shares the slow errors from then on."""
    rotate(x.q_nb, 0.0, 0.0, o.z[0])
    x.moved.yaw += o.z[0]
    o.z[0] = 0.0
    reset_variance(x, E_ATT + 2, 1, ANY_YAW)
    innovate(x, o)
    apply_yaw_update(x, o)
    x.has_yaw = 1.0
    x.used_t[AID_HEADING] = x.t
