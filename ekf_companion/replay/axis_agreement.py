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
shows it without that: :mod:`ekf_companion.replay.field_agreement`.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import GNSS_VELOCITY, Events

RATE = 50.0
"""Hz to which the samples are averaged: enough for turns, and few."""
SECONDS = 6
"""Length of a window, s."""
CHANGE = 1.0
"""m/s RMS by which the change of the horizontal velocity varies in a window that counts."""
FEWEST, MOST = 3, 20
"""Windows: below, nothing is said; above, some are left out."""
BETTER = 2.0
"""Factor between the statistics as declared, and along other axes."""
OFTEN = 0.8
"""Share of the windows in which the others fit better."""
DELAYS = (0.0, 0.1, 0.2, 0.3)
"""s, of receivers: the best of them counts."""
GAP = 1.1
"""s between fixes at most, within a window."""


LARGEST = 1e4
"""A number beyond is damaged: no vehicle turns, accelerates or moves so."""


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
    statistics = _statistics(gyro, accel, change)
    median = np.median(statistics, axis=1)
    best = int(np.argmin(median))
    is_often = np.mean(statistics[best] < statistics[0]) >= OFTEN
    if not is_often or median[0] < BETTER * median[best]:
        return ""
    return (
        "gyro, accel: their axes or unit do not fit the velocity of the fixes: "
        f"{_mistakes(median)}. Both must be forward, right, down, and turns positive from forward "
        "to right, from right to down, from down to forward"
    )


def _choices() -> list[tuple[Array, Array]]:
    """Return what gyro and accelerometer may have to be multiplied by; first: nothing."""
    turns = []
    for axes in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), axes] = signs
            turns.append(turn)
    exchanged = [(turn, handed) for handed in (np.eye(3), LEFT) for turn in turns]
    return exchanged + [(unit * np.eye(3), np.eye(3)) for unit in (DEGREES, 1.0 / DEGREES)]


DEGREES = float(np.rad2deg(1.0))
LEFT = np.diag([1.0, -1.0, 1.0])
CANDIDATES = _choices()
"""Matrices for gyro and for accelerometer."""
_NONE, _EXCHANGED = np.eye(3), np.eye(3)[[1, 0, 2]]
MISTAKES = (
    ("x and y of both are exchanged, or one of the two is reversed", _EXCHANGED, _EXCHANGED),
    (
        "gyro is forward, left, up and accel forward, right, down",
        np.diag([1.0, -1.0, -1.0]),
        _NONE,
    ),
    ("x and y of gyro alone are exchanged", _EXCHANGED, _NONE),
    ("x and y of accel alone are exchanged", _NONE, _EXCHANGED),
    ("z of gyro is reversed", np.diag([1.0, 1.0, -1.0]), _NONE),
    (
        "gyro looks like deg/s: say units={'gyro': 'deg/s'}, in a table gyro_x_dps",
        DEGREES * _NONE,
        _NONE,
    ),
    (
        "gyro looks like rad/s that is called deg/s: leave its unit out, in a table gyro_x_rps",
        _NONE / DEGREES,
        _NONE,
    ),
    ("gyro has the other sign", -_NONE, _NONE),
    ("x of gyro is reversed", np.diag([-1.0, 1.0, 1.0]), _NONE),
    ("y of gyro is reversed", np.diag([1.0, -1.0, 1.0]), _NONE),
)
"""What users do, the likeliest first: what it does to gyro and to accelerometer."""
ALIKE = 1.2
"""Factor within which candidates fit alike: the forces across a multicopter are next to nothing."""


def _windows(imu: Events, fixes: Events) -> tuple[Array, Array, Array] | None:
    """Cut the flight into windows in which the velocity changes.

    Returns:
        Angular rates and specific forces, shape (n, windows, 3), n samples of ``RATE``; and change
        of velocity less gravity, m/s, shape (delays, windows, SECONDS, 3). None: too few windows.
    """
    t, gyro, accel, is_full = averaged(imu)
    known = usable(fixes.values[:, GNSS_VELOCITY][:, :2])
    t_fix = np.asarray(fixes.t_ns[known] * 1e-9)
    vel_n = fixes.values[known, GNSS_VELOCITY]
    length = SECONDS * int(RATE)
    if len(t_fix) < 2 or len(t) <= length:
        return None
    # Receivers that give no vertical velocity leave a little more, of all axes
    vel_n = np.where(np.abs(vel_n) < LARGEST, vel_n, 0.0)
    starts = np.arange(0, len(t) - length, length)
    edges = t[starts, None] - 0.5 / RATE + np.arange(SECONDS + 1)
    inside = (edges[:, 0] > t_fix[0]) & (edges[:, -1] + DELAYS[-1] < t_fix[-1])
    next_fix = np.clip(np.searchsorted(t_fix, edges), 1, len(t_fix) - 1)
    inside &= (t_fix[next_fix] - t_fix[next_fix - 1] < GAP).all(axis=1)
    inside &= np.array([is_full[first : first + length].mean() > 0.9 for first in starts])
    starts, edges = starts[inside], edges[inside]
    change = np.stack([np.diff(_at(t_fix, vel_n, edges + delay), axis=1) for delay in DELAYS])
    level = change[0, ..., :2]
    spread = level - level.mean(axis=1, keepdims=True)
    moved = np.flatnonzero(np.sqrt(np.square(spread).sum(axis=2).mean(axis=1)) > CHANGE)
    if len(moved) < FEWEST:
        return None
    if len(moved) > MOST:
        moved = moved[np.linspace(0, len(moved) - 1, MOST).astype(np.int64)]
    rows = starts[moved] + np.arange(length)[:, None]
    return gyro[rows], accel[rows], change[:, moved] - [0.0, 0.0, STANDARD_GRAVITY]


def averaged(imu: Events) -> tuple[Array, Array, Array, Mask]:
    """Return times, s, and means of the samples in each interval of ``RATE``, and if it has any."""
    known = usable(imu.values[:, :6])
    t, values = np.asarray(imu.t_ns[known] * 1e-9), imu.values[known, :6]
    # Hours of time without a sample would be many empty intervals
    if len(t) < 2 or t[-1] - t[0] > 3600.0 + len(t):
        return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_)
    place: Indices = np.floor((t - t[0]) * RATE).astype(np.int64)
    size = int(place[-1]) + 1
    count = np.bincount(place, minlength=size)
    sums = np.stack([np.bincount(place, column, size) for column in values.T], axis=1)
    means: Array = sums / np.maximum(count, 1)[:, None]
    return t[0] + (np.arange(size) + 0.5) / RATE, means[:, :3], means[:, 3:], np.asarray(count > 0)


def usable(values: Array) -> Mask:
    """Return which rows hold numbers that a sensor can measure."""
    return np.asarray((np.abs(values) < LARGEST).all(axis=1))


def _at(t: Array, values: Array, times: Array) -> Array:
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def _statistics(gyro: Array, accel: Array, change: Array) -> Array:
    """Return what each candidate leaves in each window, m/s, shape (candidates, windows)."""
    of_gyro, of_accel = (np.array(part) for part in zip(*CANDIDATES, strict=True))
    count = gyro.shape[1]
    shape = (len(CANDIDATES), count)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (shape[0] * count, 1))
    force = np.zeros((*shape, SECONDS, 3))
    for k, (rates, forces) in enumerate(zip(gyro, accel, strict=True)):
        half = so3.exp(np.einsum("cij,wj->cwi", of_gyro, rates).reshape(-1, 3) * (0.5 / RATE))
        q = so3.multiply(q, half)
        turned = so3.rotate(q, np.einsum("cij,wj->cwi", of_accel, forces).reshape(-1, 3))
        force[:, :, k // int(RATE)] += turned.reshape(*shape, 3) / RATE
        q = so3.multiply(q, half)
    left = np.stack([_left(force, one) for one in change])
    # The receiver's delay is one for the whole flight
    delay = np.argmin(np.median(left, axis=2), axis=0)
    return np.asarray(left[delay, np.arange(shape[0])])


def _left(force: Array, change: Array) -> Array:
    """Return what the best rotation leaves between forces and changes of velocity, m/s RMS."""
    B = np.einsum("wsi,cwsj->cwij", change, force)
    U, _, Vt = np.linalg.svd(B)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    rest = change - np.einsum("cwij,cwsj->cwsi", U @ Vt, force)
    return np.asarray(np.sqrt(np.square(rest).sum(axis=3).mean(axis=2)))


def _mistakes(median: Array) -> str:
    """Return the usual mistakes that explain the statistics, or else what fits best."""
    best = float(np.min(median))
    likely = []
    for words, of_gyro, of_accel in MISTAKES:
        if median[_candidate(np.asarray(np.linalg.inv(of_gyro)), of_accel.T)] < ALIKE * best:
            likely.append(words)
    if likely:
        return ", or ".join(likely[:3])
    of_gyro, of_accel = CANDIDATES[int(np.argmin(median))]
    return f"gyro should be {_order(of_gyro)} of what is given, and accel {_order(of_accel)}"


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


def _order(turn: Array) -> str:
    """Return ``(y, x, z)`` for x and y exchanged."""
    spelled = []
    for row in turn:
        axis = int(np.argmax(np.abs(row)))
        spelled.append(f"{'-' if row[axis] < 0.0 else ''}{'xyz'[axis]}")
    return f"({', '.join(spelled)})"
