"""Two recordings of one motion: when the one began in the other, and how its axes lie.

An inertial sensor and the poses of another estimator both say how the vehicle turns and which way
is up.

Source: two clocks by the rates of both: Kelly and Sukhatme 2014, "A general framework for temporal
calibration of multiple proprioceptive and exteroceptive sensors"; axes by pairs of vectors: Wahba
1965, by singular values: Markley 1988.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_companion.logs.poses import Poses
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices, Stamps, known_rows
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.relative_pose import FLU_TO_FRD

GAP = 5.0
"""Times the usual interval of the samples beyond which some are missing."""
GRID = 0.05
"""Step in which clocks are compared at first, s: a turn lasts for a multiple of it."""
LEAST_COMMON = 10.0
"""Time that two clocks must share to be compared, s."""
BESIDE = 2.0
"""Of the best delay, s: those beside it are of the same turns."""
DECISIVE = 5.0
"""Sigmas by which the best delay must agree better than all others: of the thousands that are
tried one reaches 4 by chance."""
NEAR, FINE = 0.15, 0.01
"""Delays around the best one, s, that are compared by axes."""
CANDIDATES = 10
"""Delays that are compared by axes."""
PIECE = 0.3
"""Time over which motion is told from gravity, s: a centimetre is then 0.3 m/s^2."""
ROUNDS = 5
"""In which axes, bias of the gyro and the direction up are found by each other."""
USUAL = 1e-3
"""Weight of the usual axes, of a rad/s or a g: they decide where nothing else does."""
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


class Axes(NamedTuple):
    """How the source's axes lie."""

    C_bp: Array
    """From its body to the log's, shape (3, 3)."""
    up_w: Array
    """In its world, shape (3,)."""
    misfit: float
    """Sum of the squares of what is not explained."""
    share: float
    """Of the log's turns that are explained by these axes."""
    turns: float
    """Root mean square of the log's rates about their mean, rad/s."""
    motion: float
    """Correlation of the acceleration by its places with that of the log, in sigmas: places that
    are mirrored accelerate the other way."""


class Inertial:
    """Means of the log's rates and specific forces over any times."""

    def __init__(self, events: Events) -> None:
        """Sum up the inertial samples among some events."""
        samples = events.take((events.kind == Kind.IMU) & known_rows(events.values[:, :6]))
        order = np.argsort(samples.t_ns, kind="stable")
        self.t_ns = samples.t_ns[order]
        values = samples.values[order, :6]
        t = (self.t_ns - self.t_ns[:1]) * 1e-9
        steps = np.diff(t)[:, None] * 0.5 * (values[1:] + values[:-1])
        gaps = np.diff(t) * (np.diff(t) > GAP * np.median(np.diff(t))) if len(t) > 1 else []
        self._t = t
        self._sum = np.vstack([np.zeros(7), np.cumsum(np.column_stack([steps, gaps]), axis=0)])

    def seconds(self, t_ns: Stamps) -> Array:
        """Return times since the first sample, s."""
        return np.asarray((t_ns - self.t_ns[0]) * 1e-9)

    def means(self, first: Array, last: Array) -> Array:
        """Return rates and specific forces, shape (n, 6), between times.

        NaN beyond the samples, and where some are missing.
        """
        gained = [
            np.interp(last, self._t, one, np.nan, np.nan)
            - np.interp(first, self._t, one, np.nan, np.nan)
            for one in self._sum.T
        ]
        means = np.stack(gained[:6], axis=1) / (last - first)[:, None]
        return np.where((gained[6] > 0.0)[:, None], np.nan, means)

    @property
    def fastest(self) -> float:
        """Return the largest rate, about all axes together, rad/s."""
        rates = np.diff(self._sum[:, :3], axis=0) / np.maximum(np.diff(self._t), 1e-6)[:, None]
        return float(np.linalg.norm(rates, axis=1).max(initial=0.0))

    @property
    def length(self) -> float:
        """Return the time from the first to the last sample, s."""
        return float(self._t[-1])


def rates_of(poses: Poses, inertial: Inertial) -> tuple[Array, Array, Array]:
    """Return begin and end of each interval, s since the first pose, and its mean rate.

    What is faster than the vehicle ever turned is no turn of it: a leap, or a stamp that is wrong.
    """
    t = (poses.t_ns - poses.t_ns[0]) * 1e-9
    between = np.diff(t)
    turned = so3.log(so3.multiply(so3.conjugate(poses.q_wp[:-1]), poses.q_wp[1:]))
    rates = turned / between[:, None]
    used = between < 2.5 * np.median(between)
    used &= np.linalg.norm(rates, axis=1) < 1.5 * inertial.fastest
    return t[:-1][used], t[1:][used], rates[used]


def _agreement(
    inertial: Inertial, first: Array, last: Array, rates: Array, shift: float
) -> tuple[float, float]:
    """Return the share of the log's turns that the poses explain, by the best rotation.

    They are shifted by so many seconds. Second: the time that was compared, s.
    """
    seen = inertial.means(first + shift, last + shift)[:, :3]
    known = np.isfinite(seen).all(axis=1)
    seen, said = seen[known], rates[known]
    if len(seen) < 4:
        return 0.0, 0.0
    seen, said = seen - seen.mean(axis=0), said - said.mean(axis=0)
    turns = float(np.mean(seen**2))
    left = float(np.mean((seen - said @ rotation(seen, said).T) ** 2))
    return 1.0 - left / max(turns, 1e-12), float((last - first)[known].sum())


def find_offset(poses: Poses, inertial: Inertial) -> float | None:
    """Return when its first pose was, s since the first inertial sample; None: not decisive.

    The rates' sizes do not depend on the axes: by their correlation at every delay some are chosen,
    and of these the one at which a rotation explains the rates best. It counts if it does so better
    than any other by :data:`DECISIVE` sigmas (Fisher's transform of the correlation, with one
    independent value a second).
    """
    first, last, rates = rates_of(poses, inertial)
    if not len(rates):
        return None
    span = float(np.median(last - first))
    at = np.arange(0.5 * span, inertial.length - 0.5 * span, GRID)
    theirs = np.arange(0.5 * (first[0] + last[0]), last[-1], GRID)
    if min(len(at), len(theirs)) * GRID < LEAST_COMMON:
        return None
    ours = np.linalg.norm(inertial.means(at - 0.5 * span, at + 0.5 * span)[:, :3], axis=1)
    said = np.interp(theirs, 0.5 * (first + last), np.linalg.norm(rates, axis=1))
    least = max(LEAST_COMMON, 0.5 * GRID * min(len(ours), len(said)))
    ours = np.where(np.isfinite(ours), ours, np.nanmean(ours))
    lags, agreement = correlations(ours, said, round(least / GRID))
    chosen: list[tuple[float, float, float]] = []
    while len(chosen) < CANDIDATES and np.isfinite(agreement).any():
        best = float(lags[np.nanargmax(agreement)])
        agreement[np.abs(lags - best) * GRID <= BESIDE] = np.nan
        chosen.append(
            _refined(inertial, first, last, rates, float(at[0] - theirs[0]) + best * GRID)
        )
    chosen.sort(reverse=True)
    if not chosen or chosen[0][0] == 0.0:
        return None
    _, seconds, shift = chosen[0]
    z = [np.arctanh(np.sqrt(min(max(one[0], 0.0), 0.9999))) for one in chosen]
    other = z[1] if len(z) > 1 else 0.0
    return shift if z[0] - other > DECISIVE * np.sqrt(2.0 / (seconds - 3.0)) else None


def _refined(
    inertial: Inertial, first: Array, last: Array, rates: Array, coarse: float
) -> tuple[float, float, float]:
    """Return the share that is explained at the best delay near a coarse one, its time, and it."""
    tried = coarse + np.arange(-NEAR, NEAR + 0.5 * FINE, FINE)
    found = [_agreement(inertial, first, last, rates, shift) for shift in tried.tolist()]
    shares = [share for share, _ in found]
    j = int(np.clip(np.argmax(shares), 1, len(tried) - 2))
    before, middle, after = shares[j - 1 : j + 2]
    bend = before - 2.0 * middle + after
    shift = float(tried[j] + (0.5 * FINE * (before - after) / bend if bend < 0.0 else 0.0))
    seconds = found[j][1]
    return (middle, seconds, shift) if seconds >= LEAST_COMMON else (0.0, LEAST_COMMON, shift)


def correlations(a: Array, b: Array, least: int) -> tuple[Indices, Array]:
    """Return lags, by which b is shifted on a, and the correlation at each.

    Lags at which fewer than ``least`` values are common are left out.
    """
    size = len(a) + len(b)
    a, b = a - a.mean(), b - b.mean()

    def sums(x: Array, y: Array) -> Array:
        """Return the sums over i of x[i + lag] y[i], for lags from 1 - len(b) on."""
        found = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)
        return np.roll(found, len(b) - 1)[: size - 1]

    one_a, one_b = np.ones(len(a)), np.ones(len(b))
    n = np.rint(sums(one_a, one_b))
    ma, mb = sums(a, one_b), sums(one_a, b)
    kept = n >= least
    n, ma, mb = n[kept], ma[kept], mb[kept]
    var_a = sums(a * a, one_b)[kept] - ma * ma / n
    var_b = sums(one_a, b * b)[kept] - mb * mb / n
    both = sums(a, b)[kept] - ma * mb / n
    floor = 1e-9 * max(float(a @ a), float(b @ b), 1e-12)
    size_of_both = np.sqrt(np.maximum(var_a, floor) * np.maximum(var_b, floor))
    return np.arange(1 - len(b), len(a))[kept], both / size_of_both


def rotation(a: Array, b: Array, prior: Array | None = None) -> Array:
    """Return the rotation C for which C b is nearest to a, row by row, shape (3, 3)."""
    B = a.T @ b + (0.0 if prior is None else prior)
    U, _, Vt = np.linalg.svd(B)
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def find_axes(poses: Poses, inertial: Inertial) -> Axes:
    """Return how its axes lie: by its turns, and by where the specific force points up.

    Where the vehicle hardly turns, its body is taken for forward, left, up or forward, right, down,
    whichever fits its world.
    """
    level = _axes_from(poses, inertial, FLU_TO_FRD, UP)
    other = _axes_from(poses, inertial, np.eye(3), DOWN)
    return other if other.misfit < 0.5 * level.misfit else level


def _axes_from(poses: Poses, inertial: Inertial, usual: Array, up: Array) -> Axes:
    """Return axes from a usual body on, in a world whose z is up, down, or anywhere."""
    start = inertial.seconds(poses.t_ns[:1])[0]
    first, last, rates = rates_of(poses, inertial)
    ours = inertial.means(start + first, start + last)[:, :3]
    known = np.isfinite(ours).all(axis=1)
    ours, rates = ours[known], rates[known]
    force, accel, C_wp = _forces(poses, inertial)
    C, bias = usual, np.zeros(3)
    for _ in range(ROUNDS):
        if not poses.is_level and len(force):
            up = (np.einsum("nij,nj->ni", C_wp, force @ C) - accel).sum(axis=0)
            up = up / np.linalg.norm(up)
        should = np.einsum("nji,nj->ni", C_wp, accel + STANDARD_GRAVITY * up)
        a = np.vstack([ours - bias, force / STANDARD_GRAVITY])
        b = np.vstack([rates, should / STANDARD_GRAVITY])
        C = rotation(a, b, USUAL * len(b) * usual)
        bias = (ours - rates @ C.T).mean(axis=0) if len(ours) else bias
    turned, left = (_square_about(one) for one in (ours, ours - rates @ C.T))
    felt = np.einsum("nij,nj->ni", C_wp, force @ C) - STANDARD_GRAVITY * up
    return Axes(
        C_bp=C,
        up_w=up,
        misfit=float(((a - b @ C.T) ** 2).sum()),
        share=1.0 - left / max(turned, 1e-12),
        turns=float(np.sqrt(turned / max(len(ours), 1))),
        motion=_correlated(felt, accel),
    )


def _square_about(rows: Array) -> float:
    """Return the sum of the squares about the mean."""
    return float(((rows - rows.mean(axis=0)) ** 2).sum()) if len(rows) else 0.0


def _correlated(a: Array, b: Array) -> float:
    """Return the correlation of vectors about their means, in sigmas of none."""
    if len(a) < 4:
        return 0.0
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    share = float((a * b).sum()) / max(size, 1e-12)
    return float(np.arctanh(np.clip(share, -0.9999, 0.9999)) * np.sqrt(len(a) - 3.0))


def _forces(poses: Poses, inertial: Inertial) -> tuple[Array, Array, Array]:
    """Return the log's specific force, the acceleration and attitude by the poses, for pieces."""
    t = inertial.seconds(poses.t_ns)
    chosen = [0]
    for index, at in enumerate(t.tolist()):
        if at - t[chosen[-1]] >= PIECE:
            chosen.append(index)
    k = np.array(chosen)
    if len(k) < 3:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    span = np.diff(t[k])
    vel = np.diff(poses.pos_w[k], axis=0) / span[:, None]
    middle = t[k][:-1] + 0.5 * span
    accel = np.diff(vel, axis=0) / np.diff(middle)[:, None]
    force = inertial.means(middle[:-1], middle[1:])[:, 3:]
    good = np.isfinite(force).all(axis=1)
    good &= np.diff(middle) < 4.0 * np.median(span)
    return force[good], accel[good], so3.to_matrix(poses.q_wp[k[1:-1]])[good]
