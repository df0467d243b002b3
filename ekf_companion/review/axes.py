"""Whether gyro, accelerometer and the velocity of the fixes are along the same axes.

In a window of 6 s the gyro turns the specific force of each second into the axes of its start. The
velocity of the fixes shows the same forces in north, east, down: change of velocity, less gravity.
One rotation must take the one to the other, whatever the attitude and the heading (Wahba's problem,
solved by a singular value decomposition: Markley 1988, J. Astronautical Sci. 36). What it leaves,
m/s RMS, is the statistic, its median over the windows in which the velocity changed.

Axes that are exchanged or reversed leave more: they are left-handed, or those of gyro and
accelerometer differ. All 96 ways to do so, but for rotations of both sensors together, which this
cannot see, are tried on the samples, and two other units of the gyro. Of samples that are declared
right none leaves less than 0.93 of what they leave as they are, in 20 recordings and 24 simulated
flights; so where one leaves less than half, axes or unit are wrong. A hover or a straight flight
has no such window, and is not judged.

The force of a multicopter stays along its z, and small tilts that are reversed are those of another
heading: a gyro of the other sign shows only where the vehicle also turns about down. A magnetometer
shows it without that: :mod:`ekf_companion.review.field`.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events
from ekf_companion.review.turns import (
    DEGREES,
    EXCHANGED,
    IN_DEGREES,
    IN_RADIANS,
    RATE,
    SIGNED,
    at,
    averaged,
    fits_better,
    named,
    spelled,
    spread,
    variation,
    velocities,
)

SECONDS = 6
"""Length of a window, s."""
CHANGE = 1.0
"""m/s RMS by which the change of the horizontal velocity varies in a window that counts."""
FEWEST, MOST = 3, 20
"""Windows: below, nothing is said; above, some are left out."""
DELAYS = (0.0, 0.1, 0.2, 0.3)
"""s, of receivers: the best of them counts."""
GAP = 1.1
"""s between fixes at most, within a window."""


def axis_disagreement(imu: Events, fixes: Events) -> str:
    """Return a sentence if the inertial axes cannot be meant; empty: they can.

    Args:
        imu: Of ``Kind.IMU``, in the order of their stamps.
        fixes: Of ``Kind.GNSS``, likewise.
    """
    windows = _windows(imu, fixes)
    if windows is None:
        return ""
    gyro, accel, change = windows
    median = fits_better(_statistics(gyro, accel, change))
    if median is None:
        return ""
    return (
        "gyro, accel: their axes or unit do not fit the velocity of the fixes: "
        f"{_mistakes(median)}. Both must be forward, right, down, and turns positive from forward "
        "to right, from right to down, from down to forward"
    )


LEFT = np.diag([1.0, -1.0, 1.0])
_NONE = np.eye(3)
CANDIDATES = [(turn, handed) for handed in (_NONE, LEFT) for turn in SIGNED]
CANDIDATES += [(unit * _NONE, _NONE) for unit in (DEGREES, 1.0 / DEGREES)]
"""Matrices by which gyro and accelerometer may have to be multiplied; first: nothing."""
MISTAKES = (
    ("x and y of both are exchanged, or one of the two is reversed", EXCHANGED, EXCHANGED),
    (
        "gyro is forward, left, up and accel forward, right, down",
        np.diag([1.0, -1.0, -1.0]),
        _NONE,
    ),
    ("x and y of gyro alone are exchanged", EXCHANGED, _NONE),
    ("x and y of accel alone are exchanged", _NONE, EXCHANGED),
    ("z of gyro is reversed", np.diag([1.0, 1.0, -1.0]), _NONE),
    (IN_DEGREES, DEGREES * _NONE, _NONE),
    (IN_RADIANS, _NONE / DEGREES, _NONE),
    ("gyro has the other sign", -_NONE, _NONE),
    ("x of gyro is reversed", np.diag([-1.0, 1.0, 1.0]), _NONE),
    ("y of gyro is reversed", np.diag([1.0, -1.0, 1.0]), _NONE),
)
"""What users do, the likeliest first: what it does to gyro and to accelerometer."""


def _windows(imu: Events, fixes: Events) -> tuple[Array, Array, Array] | None:
    """Cut the flight into windows in which the velocity changes.

    Returns:
        Angular rates and specific forces, shape (n, windows, 3), n samples of ``RATE``; and change
        of velocity less gravity, m/s, shape (delays, windows, SECONDS, 3). None: too few windows.
    """
    t, gyro, accel, is_full = averaged(imu)
    t_fix, vel_n = velocities(fixes)
    length = SECONDS * int(RATE)
    if len(t_fix) < 2 or len(t) <= length:
        return None
    starts = np.arange(0, len(t) - length, length)
    edges = t[starts, None] - 0.5 / RATE + np.arange(SECONDS + 1)
    inside = (edges[:, 0] > t_fix[0]) & (edges[:, -1] + DELAYS[-1] < t_fix[-1])
    next_fix = np.clip(np.searchsorted(t_fix, edges), 1, len(t_fix) - 1)
    inside &= (t_fix[next_fix] - t_fix[next_fix - 1] < GAP).all(axis=1)
    inside &= np.array([is_full[first : first + length].mean() > 0.9 for first in starts])
    starts, edges = starts[inside], edges[inside]
    change = np.stack([np.diff(at(t_fix, vel_n, edges + delay), axis=1) for delay in DELAYS])
    moved = np.flatnonzero(variation(change[0, ..., :2]) > CHANGE)
    if len(moved) < FEWEST:
        return None
    moved = spread(moved, MOST)
    rows = starts[moved] + np.arange(length)[:, None]
    return gyro[rows], accel[rows], change[:, moved] - [0.0, 0.0, STANDARD_GRAVITY]


def _statistics(gyro: Array, accel: Array, change: Array) -> Array:
    """Return what each candidate leaves in each window, m/s, shape (candidates, windows)."""
    force = _forces(gyro, accel)
    left = np.stack([rest_of_rotation(force, one) for one in change])
    # The receiver's delay is one for the whole flight
    delay = np.argmin(np.median(left, axis=2), axis=0)
    return np.asarray(left[delay, np.arange(len(CANDIDATES))])


def _forces(gyro: Array, accel: Array) -> Array:
    """Return what :func:`integrated_force` does of each candidate, but for rounding.

    A rotation about exchanged axes is the rotation, exchanged: only units and signs of the rates
    are integrated, and the turned forces are summed before it is said which axis is which.
    """
    sizes = [float(np.abs(of_gyro).max()) for of_gyro, _ in CANDIDATES]
    signs = [float(np.sign(np.linalg.det(of_gyro))) for of_gyro, _ in CANDIDATES]
    scales = [size * sign for size, sign in zip(sizes, signs, strict=True)]
    each = list(dict.fromkeys(scales))
    turned = _turned(np.concatenate([gyro * scale for scale in each], axis=1), accel, len(each))
    force = []
    for (of_gyro, of_accel), scale in zip(CANDIDATES, scales, strict=True):
        turn = of_gyro / scale
        sums = turned[each.index(scale)]
        force.append(np.einsum("ia,wsabc,bc->wsi", turn, sums, turn.T @ of_accel, optimize=True))
    return np.stack(force)


def _turned(rates: Array, accel: Array, count: int) -> Array:
    """Return the sum over each second of the rotation times the force, m/s.

    Args:
        rates: Angular rates of ``count`` choices, shape (samples, count * windows, 3).
        accel: Specific forces, shape (samples, windows, 3).
        count: Choices.

    Returns:
        Shape (count, windows, SECONDS, 3, 3, 3); the force's axis is last.
    """
    windows = accel.shape[1]
    q = np.tile([1.0, 0.0, 0.0, 0.0], (count * windows, 1))
    sums = np.zeros((count, windows, SECONDS, 3, 3, 3))
    for k, (rate, forces) in enumerate(zip(rates, accel, strict=True)):
        half = so3.exp(rate * (0.5 / RATE))
        q = so3.multiply(q, half)
        turn = so3.to_matrix(q).reshape(count, windows, 3, 3, 1)
        sums[:, :, k // int(RATE)] += turn * (forces / RATE)[:, None, None, :]
        q = so3.multiply(q, half)
    return sums


def integrated_force(
    gyro: Array, accel: Array, of_gyro: Array, of_accel: Array, rate: float = RATE
) -> Array:
    """Return the specific force over each second, along the axes at the start of its window, m/s.

    Args:
        gyro: Angular rates, rad/s, shape (samples, windows, 3).
        accel: Specific forces, m/s^2, likewise.
        of_gyro: By what the rates are multiplied, shape (choices, 3, 3).
        of_accel: By what the forces are.
        rate: Samples per second, Hz.

    Returns:
        Shape (choices, windows, SECONDS, 3).
    """
    count = gyro.shape[1]
    shape = (len(of_gyro), count)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (shape[0] * count, 1))
    force = np.zeros((*shape, SECONDS, 3))
    for k, (rates, forces) in enumerate(zip(gyro, accel, strict=True)):
        half = so3.exp(np.einsum("cij,wj->cwi", of_gyro, rates).reshape(-1, 3) * (0.5 / rate))
        q = so3.multiply(q, half)
        turned = so3.rotate(q, np.einsum("cij,wj->cwi", of_accel, forces).reshape(-1, 3))
        force[:, :, k // int(rate)] += turned.reshape(*shape, 3) / rate
        q = so3.multiply(q, half)
    return force


def rest_of_rotation(force: Array, change: Array) -> Array:
    """Return what the best rotation leaves between forces and changes of velocity, m/s RMS.

    Shapes (choices, windows, SECONDS, 3) and (windows, SECONDS, 3) give (choices, windows).
    """
    B = np.einsum("wsi,cwsj->cwij", change, force)
    U, _, Vt = np.linalg.svd(B)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    rest = change - np.einsum("cwij,cwsj->cwsi", U @ Vt, force)
    return np.asarray(np.sqrt(np.square(rest).sum(axis=3).mean(axis=2)))


def _mistakes(median: Array) -> str:
    """Return the usual mistakes that explain the statistics, or else what fits best."""
    mistakes = (
        (words, float(median[_candidate(np.asarray(np.linalg.inv(of_gyro)), of_accel.T)]))
        for words, of_gyro, of_accel in MISTAKES
    )
    if likely := named(mistakes, float(np.min(median))):
        return likely
    of_gyro, of_accel = CANDIDATES[int(np.argmin(median))]
    return f"gyro should be {spelled(of_gyro)} of what is given, and accel {spelled(of_accel)}"


def _candidate(of_gyro: Array, of_accel: Array) -> int:
    """Return the index of the candidate that equals a pair but for a rotation of both."""
    handed = LEFT if np.linalg.det(of_accel) < 0.0 else np.eye(3)
    turn = handed @ of_accel.T
    pairs = enumerate(CANDIDATES)
    return next(
        k
        for k, (gyro, accel) in pairs
        if np.allclose(gyro, turn @ of_gyro) and np.array_equal(accel, handed)
    )
