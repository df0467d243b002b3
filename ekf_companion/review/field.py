"""Whether gyro and magnetometer turn alike: axes, signs and unit of both.

Between two times the gyro turns the vehicle by R, and the Earth's field turns in the body the other
way: m2 = R' m1, whatever the attitude. What hard iron and a bias of the gyro add is fitted, by
least squares. The statistic is what a window leaves, in parts of the change of the field, of
windows in which the field turned; its median counts.

All 48 ways to exchange and reverse axes of the gyro, in three units, are tried. Axes of the
magnetometer that are exchanged or reversed look like some of them, and all three reversed like
nothing: so the sentence names what either sensor would have to be. Without a turn nothing is said,
nor of a turn about down alone what the axes across it are.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Mask
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
    spread,
    usable,
)

LAGS = (1.0, 3.0, 10.0)
"""Length of windows, s: short for those who swing, long for those who turn slowly."""
TURNED = 0.1
"""Change of the field, in parts of its strength, in a window that counts: 6 deg across it."""
NOISES = 6.0
"""Times the sensor's noise that the change must be, too."""
FEWEST, MOST = 6, 100
"""Windows: below, nothing is said; above, some are left out."""
FITS = 0.4
"""Statistic up to which a choice of axes explains the field."""
HARD_IRON, BIAS, NOISE = 0.3, 0.01, 0.02
"""One sigma of what is fitted, gauss and rad/s, and of the field's change, gauss."""
GAP = 0.5
"""s between samples of the magnetometer at most, at the edges of a window."""

UNITS = (1.0, DEGREES, 1.0 / DEGREES)
CANDIDATES = [(unit, turn) for unit in UNITS for turn in SIGNED]
"""What the rates may have to be multiplied by; first: nothing."""


def _of_mag(mistake: Array) -> Array:
    """Return what the gyro would have to be turned by to agree with a mistaken magnetometer."""
    return np.asarray(np.linalg.det(mistake) * mistake)


MISTAKES = (
    (IN_DEGREES, 1.0 / DEGREES, np.eye(3)),
    (IN_RADIANS, DEGREES, np.eye(3)),
    ("gyro has the other sign", 1.0, -np.eye(3)),
    ("z of gyro is reversed", 1.0, np.diag([1.0, 1.0, -1.0])),
    ("x and y of mag are exchanged, and its z is up", 1.0, _of_mag(EXCHANGED * [1.0, 1.0, -1.0])),
    ("x and y of mag are exchanged", 1.0, _of_mag(EXCHANGED)),
    ("mag is forward, left, up, or gyro is", 1.0, np.diag([1.0, -1.0, -1.0])),
    ("z of mag is reversed", 1.0, _of_mag(np.diag([1.0, 1.0, -1.0]))),
    ("y of mag is reversed", 1.0, _of_mag(np.diag([1.0, -1.0, 1.0]))),
    ("x and y of gyro are exchanged", 1.0, EXCHANGED),
    ("x of gyro is reversed", 1.0, np.diag([-1.0, 1.0, 1.0])),
    ("y of gyro is reversed", 1.0, np.diag([1.0, -1.0, 1.0])),
)
"""What users do, the likeliest first, and what makes the gyro agree."""


def field_disagreement(imu: Events, mag: Events) -> str:
    """Return a sentence if gyro and magnetometer cannot be meant so; empty: they can.

    Args:
        imu: Of ``Kind.IMU``, in the order of their stamps.
        mag: Of ``Kind.MAG``, likewise.
    """
    t, gyro, _, is_full = averaged(imu)
    known = usable(mag.values[:, :3]) & (np.diff(mag.t_ns, prepend=-1) > 0)
    t_mag, field = np.asarray(mag.t_ns[known] * 1e-9), mag.values[known, :3]
    if len(t_mag) < FEWEST or not len(t):
        return ""
    for lag in LAGS:
        starts = _windows(t, is_full, t_mag, lag)
        length = int(lag * RATE)
        ends = starts + length
        before, after = (at(t_mag, field, t[edge] - 0.5 / RATE) for edge in (starts, ends))
        change = np.linalg.norm(after - before, axis=1)
        least = max(
            TURNED * float(np.median(np.linalg.norm(field, axis=1))), NOISES * _noise(field)
        )
        turned = np.flatnonzero(change > least)
        if len(turned) < FEWEST:
            continue
        turned = spread(turned, MOST)
        rates = gyro[starts[turned] + np.arange(length)[:, None]]
        if found := _judge(rates, before[turned], after[turned], lag):
            return found
    return ""


def _windows(t: Array, is_full: Mask, t_mag: Array, lag: float) -> Indices:
    """Return the first samples of windows within which both sensors were measured."""
    length = int(lag * RATE)
    starts = np.arange(0, len(t) - length, int(max(1.0, lag / 2.0) * RATE))
    inside = (t[starts] - 0.5 / RATE > t_mag[0]) & (t[starts + length] < t_mag[-1])
    share = np.concatenate([[0.0], np.cumsum(is_full)])
    inside &= share[starts + length] - share[starts] > 0.9 * length
    for edge in (starts, starts + length):
        after = np.clip(np.searchsorted(t_mag, t[edge] - 0.5 / RATE), 1, len(t_mag) - 1)
        inside &= t_mag[after] - t_mag[after - 1] < GAP
    return np.asarray(starts[inside])


def _noise(field: Array) -> float:
    """Return the noise of a difference of two samples, gauss, from samples next to each other."""
    step = np.linalg.norm(np.diff(field, n=2, axis=0), axis=1)
    return float(np.median(step) / np.sqrt(3.0))


def _judge(rates: Array, before: Array, after: Array, lag: float) -> str:
    """Return a sentence if another choice explains the field, and the declared one does not."""
    left = np.stack([_left(rotation, before, after, lag) for rotation in _rotations(rates)])
    median = fits_better(left)
    if median is None or median.min() > FITS:
        return ""
    mistakes = ((words, float(median[_candidate(unit, turn)])) for words, unit, turn in MISTAKES)
    likely = named(mistakes, float(median.min()))
    return (
        "gyro, mag: the field does not turn in the vehicle as the gyro does: "
        f"{likely or 'axes of one are exchanged or reversed'}. Both must be forward, right, down"
    )


def _candidate(unit: float, turn: Array) -> int:
    return next(
        k for k, (size, one) in enumerate(CANDIDATES) if size == unit and np.array_equal(one, turn)
    )


def _rotations(rates: Array) -> list[Array]:
    """Return the rotation of each window for each candidate, shape (windows, 3, 3).

    A rotation about exchanged axes is the rotation, exchanged: only units and signs are integrated.
    """
    scales = [(unit, sign) for unit in UNITS for sign in (1.0, -1.0)]
    every = np.concatenate([rates * (unit * sign) for unit, sign in scales], axis=1)
    of = dict(zip(scales, np.split(_integrated(every), len(scales)), strict=True))
    return [
        turn @ of[unit, float(np.round(np.linalg.det(turn)))] @ turn.T for unit, turn in CANDIDATES
    ]


def _integrated(rates: Array) -> Array:
    """Return the rotation from the end of each window to its start, of rates (n, windows, 3)."""
    q = np.tile([1.0, 0.0, 0.0, 0.0], (rates.shape[1], 1))
    for one in rates:
        q = so3.multiply(q, so3.exp(one / RATE))
    return np.asarray(so3.to_matrix(q))


def _left(rotation: Array, before: Array, after: Array, lag: float) -> Array:
    """Return what each window leaves, in parts of the field's change."""
    back = np.swapaxes(rotation, 1, 2)
    turned = np.einsum("wij,wj->wi", back, before)
    rest = after - turned
    # What hard iron adds, and a bias of the gyro
    iron = np.eye(3) - back
    bias = lag * np.cross(turned[:, None], np.eye(3))
    design = np.concatenate([iron * HARD_IRON, bias * BIAS], axis=2)
    rows = design.reshape(-1, 6)
    normal = rows.T @ rows + NOISE**2 * np.eye(6)
    found = np.linalg.solve(normal, rows.T @ rest.reshape(-1))
    rest = rest - np.einsum("wij,j->wi", design, found)
    return np.asarray(np.linalg.norm(rest, axis=1) / np.linalg.norm(after - before, axis=1))
