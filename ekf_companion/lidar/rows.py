"""Point-to-plane rows of one scan, summed to normal equations for each anchor of the map.

A row compares a point with a plane that is tied to an anchor, a pose of the past with an error of
its own: what is measured is the pose relative to that anchor. The variance of a row holds the noise
of the range by the angle of incidence, that of the beam's direction, the roughness of the plane and
its uncertainty, which all rows on the same plane share.

Normals are noisy, and noise has information in the sum of squares even along a direction in which
nothing is seen (errors in variables). The expected share of it is taken out; where what is left is
not more than chance, the direction is without hold and no row has a part in it.

Source: Fuller 1987, "Measurement Error Models", ch. 2 (correction of the normal matrix);
Zhang, Kaess, Singh 2016, "On degeneracy of optimization-based state estimation problems"
(directions that are not updated).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ekf_companion.lidar import loops
from ekf_companion.lidar.deskew import Deskewed
from ekf_companion.lidar.planes import Planes
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import POSE, VEL, State
from ekf_companion.lidar.voxel_map import LARGEST_SLOPE, LASERS, VoxelMap
from ekf_companion.nav.arrays import Array, Indices, Mask

GATE = 5.0
"""Sigmas of prior and noise from their plane beyond which rows are of something else."""
TAIL = 3.0
"""Sigmas at which a row has half its weight: a Cauchy distribution's, 98 % efficient for noise."""
SEPARATE = 3.0
"""Ratio of sigmas from which on the filter knows which directions are without hold."""
AGREEING = 0.2
"""Largest angle to those that the normals show, rad."""
LEAST_PLANES = 4.0
"""Planes that a hold must come from, by their weights, in each part of the map and in all: a corner
is three, and of four one may be of something that moves, or of an edge."""
CHANCE = 3.0
"""Standard errors by which a hold must exceed the noise of the normals."""


class Known(NamedTuple):
    """What a row depends on of the anchor of its plane."""

    apart: Array
    """Covariance of the position relative to it, m^2, shape (3, 3)."""
    time: float
    """Mean time of its scans, s since the first one of the map."""


_NOTHING = Known(np.zeros((3, 3)), 0.0)
RATE, MOUNTING = 6, 12
"""First columns of a row for velocity and gyro bias, and for the mounting."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """How a scan and the map agree."""

    used: int
    """Number of rows."""
    open_w: Array
    """Orthonormal directions without hold, shape (3, m)."""
    hold: Array
    """Share of the information along each of three directions that is more than noise."""
    directions_w: Array
    """Those directions, in columns, unit vectors, shape (3, 3)."""
    sigma: Array
    """Of the position along each by this scan alone, m."""
    rms: float
    """Of the innovations in their sigmas."""


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Normal equations of one scan at a state."""

    columns: int
    """Number of the state's columns; six of the anchor and six of the scan follow."""
    owners: Indices
    """Numbers of the anchors, shape (g,)."""
    A: Array
    """For each anchor the squares of the rows, shape (g, columns + 12, columns + 12)."""
    b: Array
    """For each anchor their products with the innovation, shape (g, columns + 12)."""
    common: Array
    """Variances of an error of the scan as a whole: shift, m^2, and rotation, rad^2, shape (6,)."""
    match: Match
    usage: dict[int, float]
    """Share of each anchor in the weights."""


def noise_of_points(points: Array, settings: Settings) -> Array:
    """Return the variance of each point along any axis, m^2, at most, shape (n,)."""
    square = np.einsum("ni,ni->n", points, points)
    return np.asarray(settings.range_noise**2 + settings.angle_noise**2 * square)


def sum_rows(
    scan: Deskewed,
    x: State,
    P: Array,
    known: dict[int, Known],
    voxels: VoxelMap,
    settings: Settings,
    now: float,
    *,
    has_mounting: bool,
) -> Sums | None:
    """Match the points of a scan and sum up their rows; None if there are none.

    P is the covariance of the error state, by which points are gated; ``known`` is what is known
    of each anchor, and ``now`` the time of the state, s since the first scan of the map.
    """
    y, q = scan.placed(x)
    planes = voxels.match(q)
    if not len(planes.index):
        return None
    scan, y, q = scan.chosen(planes.index), y[planes.index], q[planes.index]
    rows = scan.rows(x, y, q, planes.normal, has_mounting=has_mounting)
    owners, group = np.unique(planes.owner, return_inverse=True)
    shared = Shared.of(planes, group, len(owners))
    about = [known.get(owner, _NOTHING) for owner in owners.tolist()]
    shift = np.array([one.apart for one in about]).reshape(-1, 9)
    s = settings
    made = np.empty((len(q), 3))
    loops.weigh(
        scan.points,
        scan.turn,
        scan.pose(x),
        q,
        planes.normal,
        planes.centre,
        planes.along.reshape(-1, 6),
        planes.spread,
        shared.together,
        group,
        shift,
        rows,
        np.ascontiguousarray(P[:POSE, :POSE]),
        np.array([s.range_noise, s.angle_noise, s.range_bias, GATE, TAIL]),
        made,
    )
    z, R, weight = made.T.copy()
    weight[_lean_var(planes, P[VEL, VEL]) > LARGEST_SLOPE**2] = 0.0
    kept = weight > 0.0
    if not kept.any():
        return None

    # Of each part of the map by itself: an old one that shows nothing along a tunnel holds nothing
    held = _hold(shared, weight)
    bare = np.einsum("nij,nj->ni", held.leave[group], planes.normal)
    U = np.empty((3, 0))
    if held.is_lost[-1].any():
        U = _open_directions(held.directions[:, held.is_lost[-1]], planes, weight, known)
        bare = bare - (bare @ U) @ U.T
    if (held.hold < 1.0).any():
        rows = scan.rows(x, y, q, np.ascontiguousarray(bare), has_mounting=has_mounting)
    put_in = np.array([one.time for one in about])[group]
    share = _share(planes, q, put_in, now) if known else np.ones(len(q))
    rows = _with_anchor(rows, share)
    width = rows.shape[1]
    A, b = np.zeros((len(owners) * width, width)), np.zeros((len(owners), width))
    loops.sum_rows(rows, z, weight, group, A, b)
    usage = np.bincount(group, weight) / weight.sum()
    # The biases of the few lasers that see a surface do not average out
    bias = settings.range_bias**2 / LASERS
    return Sums(
        width - 2 * POSE,
        owners,
        A.reshape(-1, width, width),
        b,
        np.repeat([bias, settings.angle_noise**2], 3),
        Match(
            int(kept.sum()),
            U,
            held.hold[-1].copy(),
            held.directions,
            held.sigma,
            float(np.sqrt(np.mean(z[kept] ** 2 / R[kept]))),
        ),
        dict(zip(owners.tolist(), usage.tolist(), strict=True)),
    )


def _with_anchor(rows: Array, share: Array) -> Array:
    """Return rows of what a plane has of its anchor's error, and of the state's the rest.

    Args:
        rows: By the state and by the scan as a whole, shape (n, w + 6).
        share: Of the anchor's, shape (n,).

    Returns:
        By the state, by the anchor and by the scan as a whole, shape (n, w + 12).
    """
    own, scan = rows[:, :-POSE].copy(), rows[:, -POSE:]
    own[:, :RATE] *= share[:, None]
    own[:, MOUNTING:] *= share[:, None]
    return np.hstack([own, share[:, None] * scan, scan])


def _lean_var(planes: Planes, P_vel: Array) -> Array:
    """Return the variance of what planes lean by the velocity they were put in by, rad^2, (n,).

    Of that velocity the filter knows something, and the points of a plane by themselves.
    """
    var = np.einsum("ni,ij,nj->n", planes.normal, P_vel, planes.normal)
    var *= planes.drift / (var + planes.drift)
    return np.asarray(var * np.einsum("ni,ni->n", planes.sweep, planes.sweep))


def _share(planes: Planes, q: Array, made: Array, now: float) -> Array:
    """Return which share planes have of their anchor's error at some points, shape (n,).

    A plane has the error of the pose at the time when it was put in there: at the mean time of its
    part that is the anchor's, now the state's, and in between it goes from one to the other.

    Args:
        planes: One for each point.
        q: Points in w, m, shape (n, 3).
        made: Mean time of the part of each plane, s since the first scan of the map, shape (n,).
        now: Of the state, s since then.
    """
    time = planes.time + np.einsum("ni,ni->n", planes.sweep, q - planes.centre)
    return np.asarray(np.clip((now - time) / np.maximum(now - made, 1e-6), 0.0, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """The planes of rows, and which rows are on the same."""

    planes: Planes
    group: Indices
    """Of each row, shape (n,)."""
    count: int
    """Of the groups."""
    one: Indices
    """A row on each of p planes, shape (p,)."""
    back: Indices
    """Which of these planes each row is on, shape (n,)."""
    together: Indices
    """Rows on the same plane as each, shape (n,)."""

    @classmethod
    def of(cls, planes: Planes, group: Indices, count: int) -> Shared:
        """Find out which rows are on the same plane."""
        _, one, back, size = np.unique(
            planes.voxel, return_index=True, return_inverse=True, return_counts=True
        )
        return cls(planes, group, count, one, back, size[back])


class _Hold(NamedTuple):
    """What the normals of each of g groups of rows, and of all, hold beyond their own noise."""

    leave: Array
    """What leaves of a normal only that, shape (g + 1, 3, 3)."""
    hold: Array
    """Share of the information that is held along each direction, shape (g + 1, 3)."""
    is_lost: Mask
    """No share, or by too few planes, shape (g + 1, 3)."""
    directions: Array
    """Of all, in columns, unit vectors, shape (3, 3)."""
    sigma: Array
    """Of the position along each by these rows alone, m, shape (3,)."""


def _hold(shared: Shared, weight: Array) -> _Hold:
    """Find in which directions the normals of each group, and at last those of all, hold."""
    g, planes = shared.count, shared.planes
    squares, noise = np.zeros((g + 1, 9)), np.zeros((g + 1, 9))
    along = planes.along.reshape(-1, 6)
    loops.sum_normals(planes.normal, along, weight, shared.group, squares, noise)
    squares[g], noise[g] = squares.sum(axis=0), noise.sum(axis=0)
    A, B = squares.reshape(-1, 3, 3), noise.reshape(-1, 3, 3)
    trace = np.trace(A, axis1=1, axis2=2)[:, None, None]
    A = A + (1e-9 * trace + 1e-30) * np.eye(3)
    values, axes = np.linalg.eigh(A)
    root = (axes * np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)
    inverse = (axes / np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)
    share, V = np.linalg.eigh(np.eye(3) - inverse @ B @ inverse)
    white = np.ascontiguousarray(inverse @ V)
    # Each plane adds the square of its normal's noise, which is one draw for all its rows
    one, sums = shared.one, np.zeros((g + 1, 9))
    each = np.asarray(np.bincount(shared.back, weight), dtype=np.float64)
    part = shared.group[one]
    for group in (part, np.full_like(part, g)):
        loops.sum_planes(planes.normal[one], along[one], each, group, white.reshape(-1, 9), sums)
    chance = np.sqrt(2.0 * sums[:, 6:])
    count = sums[:, :3] ** 2 / np.maximum(sums[:, 3:6], 1e-30)
    hold = np.clip(share - CHANCE * chance, 0.0, 1.0)
    hold[hold > 0.98] = 1.0
    hold[count < LEAST_PLANES] = 0.0
    size = np.linalg.norm(white[g], axis=0)
    return _Hold(
        root @ (V * hold[:, None]) @ V.transpose(0, 2, 1) @ inverse,
        hold,
        hold == 0.0,
        white[g] / size,
        size / np.maximum(hold[g], 1e-6),
    )


def _open_directions(found: Array, planes: Planes, weight: Array, known: dict[int, Known]) -> Array:
    """Return an orthonormal basis of the directions without hold, shape (3, m).

    The normals show them but for their own noise. Rows that kept a little of the true ones would
    hold them after many scans: those that the filter knows least are taken, where they agree.
    """
    U = np.linalg.qr(found)[0]
    m = U.shape[1]
    P = np.zeros((3, 3))
    for owner, one in known.items():
        P += one.apart * float(weight[planes.owner == owner].sum())
    size, axes = np.linalg.eigh(P)
    if m == 3 or size[3 - m] < SEPARATE**2 * size[2 - m]:
        return U
    least_known = axes[:, 3 - m :]
    cosines = np.linalg.svd(U.T @ least_known, compute_uv=False)
    return least_known if cosines.min() > np.cos(AGREEING) else U
