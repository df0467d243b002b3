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

from ekf_companion.lidar.deskew import Deskewed
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import State
from ekf_companion.lidar.voxel_map import LASERS, Planes, VoxelMap
from ekf_companion.nav.arrays import Array, Indices, Mask

GATE = 5.0
"""Sigmas of prior and noise from their plane beyond which rows are of something else."""
TAIL = 3.0
"""Sigmas at which a row has half its weight: a Cauchy distribution's, 98 % efficient for noise."""
SEPARATE = 3.0
"""Ratio of sigmas from which on the filter knows which directions are without hold."""
AGREEING = 0.2
"""Largest angle to those that the normals show, rad."""
LEAST_PLANES = 9.0
"""Planes that a hold must come from, by their weights: one in nine that is of something that moves,
or of an edge, is then no more than three sigma of the others."""
PART_PLANES = 4.0
"""The same of one part of the map: a corner of it is three planes."""
CHANCE = 3.0
"""Standard errors by which a hold must exceed the noise of the normals."""


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """Normal equations of one scan at a state."""

    columns: int
    """Number of the state's columns; the six of the anchor follow."""
    by_owner: dict[int, tuple[Array, Array]]
    """For each anchor the matrix of the rows' squares and their sums with the innovation."""
    common: Array
    """Variances of an error of the scan as a whole: shift, m^2, and rotation, rad^2, shape (6,)."""
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
    usage: dict[int, float]
    """Share of each anchor in the weights."""


def noise_of_points(scan: Deskewed, settings: Settings) -> tuple[Array, Array]:
    """Return the range of each point, m, and its variance along any axis, m^2, at most."""
    ranges = np.sqrt(np.einsum("ni,ni->n", scan.points, scan.points))
    var = settings.range_noise**2 + (settings.angle_noise * ranges) ** 2
    return ranges, var


def sum_rows(
    scan: Deskewed,
    x: State,
    P: Array,
    apart: dict[int, Array],
    voxels: VoxelMap,
    settings: Settings,
    *,
    has_mounting: bool,
) -> Sums | None:
    """Match the points of a scan and sum up their rows; None if there are none.

    P is the covariance of attitude and position, shape (6, 6), by which points are gated;
    ``apart`` that of the position relative to each anchor, shape (3, 3).
    """
    q = scan.in_w(x)
    ranges, var = noise_of_points(scan, settings)
    planes = voxels.match(q, var)
    if not len(planes.index):
        return None
    scan, q, ranges = scan.chosen(planes.index), q[planes.index], ranges[planes.index]
    normal = planes.normal
    gap = planes.centre - q
    z = np.einsum("ni,ni->n", normal, gap)
    H = scan.derivatives(x, normal, has_mounting=has_mounting)
    R = _variances(scan, x, planes, gap, ranges, apart, settings)
    prior = np.einsum("ni,ij,nj->n", H[:, :6], P, H[:, :6])
    distance = z * z / (R + prior)
    kept = distance < GATE**2
    if not kept.any():
        return None
    weight = np.where(kept, 1.0 / (R * (1.0 + distance / TAIL**2)), 0.0)

    owners, group = np.unique(planes.owner, return_inverse=True)
    # Of each part of the map by itself: an old one that shows nothing along a tunnel holds nothing
    part = _hold(normal, planes, weight, group, len(owners), PART_PLANES)
    bare = np.einsum("nij,nj->ni", part.leave[group], normal)
    whole = _hold(normal, planes, weight, np.zeros_like(group), 1, LEAST_PLANES)
    U = np.empty((3, 0))
    if whole.is_lost[0].any():
        U = _open_directions(whole.directions[0][:, whole.is_lost[0]], planes, weight, apart)
        bare = bare - (bare @ U) @ U.T
    if part.is_lost.any() or (part.hold < 1.0).any():
        normal = bare
        H = scan.derivatives(x, normal, has_mounting=has_mounting)
    a = np.empty((len(z), 6))
    a[:, :3] = normal
    a[:, 3:] = np.cross(q - x.pos_w, normal)
    rows = np.hstack([H, a])
    by_owner, usage = {}, {}
    total = weight.sum()
    for number, owner in enumerate(owners.tolist()):
        mine = np.flatnonzero(group == number)
        own, w = rows[mine], weight[mine]
        weighted = own * w[:, None]
        by_owner[owner] = (weighted.T @ own, weighted.T @ z[mine])
        usage[owner] = float(w.sum() / total)
    rms = float(np.sqrt(np.mean(z[kept] ** 2 / R[kept])))
    # The biases of the few lasers that see a surface do not average out
    shift = settings.range_bias**2 / LASERS
    common = np.repeat([shift, settings.angle_noise**2], 3)
    return Sums(
        H.shape[1],
        by_owner,
        common,
        int(kept.sum()),
        U,
        whole.hold[0],
        whole.directions[0],
        whole.sigma[0],
        rms,
        usage,
    )


def _variances(
    scan: Deskewed,
    x: State,
    planes: Planes,
    gap: Array,
    ranges: Array,
    apart: dict[int, Array],
    settings: Settings,
) -> Array:
    """Return the variance of each row, m^2."""
    beam = np.einsum("nij,nj->ni", scan.turn, scan.points @ x.C_bl.T) @ x.C_wb.T
    cosine = np.abs(np.einsum("ni,ni->n", beam, planes.normal)) / np.maximum(ranges, 1e-3)
    cosine2 = np.minimum(cosine * cosine, 1.0)
    point = settings.range_noise**2 * cosine2
    point += (settings.angle_noise * ranges) ** 2 * (1.0 - cosine2)
    slope = np.einsum("nki,ni->nk", planes.along, gap)
    shared = planes.offset + (slope * slope).sum(axis=1) + settings.range_bias**2 * cosine2
    # What an unknown shift along a plane becomes by its slope (a term of second order)
    for owner, shift in apart.items():
        mine = np.flatnonzero(planes.owner == owner)
        along = planes.along[mine]
        shared[mine] += np.einsum("nki,ij,nkj->n", along, shift, along)
    # Together the rows on a plane know no more than the plane
    _, back, count = np.unique(planes.voxel, return_inverse=True, return_counts=True)
    return np.asarray(np.maximum(point, planes.scatter) + count[back] * shared)


class _Hold(NamedTuple):
    """What the normals of each of g groups of rows hold beyond their own noise."""

    leave: Array
    """What leaves of a normal only that, shape (g, 3, 3)."""
    hold: Array
    """Share of the information that is held along each direction, shape (g, 3)."""
    is_lost: Mask
    """No share, or by too few planes, shape (g, 3)."""
    directions: Array
    """In columns, unit vectors, shape (g, 3, 3)."""
    sigma: Array
    """Of the position along each by these rows alone, m, shape (g, 3)."""


def _hold(
    normal: Array, planes: Planes, weight: Array, group: Indices, g: int, least: float
) -> _Hold:
    """Find in which directions the normals of each group hold the position."""
    A = _sum_outer(normal, normal, weight, group, g)
    along = planes.along
    B = _sum_outer(along[:, 0], along[:, 0], weight, group, g)
    B += _sum_outer(along[:, 1], along[:, 1], weight, group, g)
    trace = np.trace(A, axis1=1, axis2=2)[:, None, None]
    A = A + (1e-9 * trace + 1e-30) * np.eye(3)
    values, axes = np.linalg.eigh(A)
    root = (axes * np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)
    inverse = (axes / np.sqrt(values)[:, None]) @ axes.transpose(0, 2, 1)
    share, V = np.linalg.eigh(np.eye(3) - inverse @ B @ inverse)
    white = inverse @ V
    # Each plane adds the square of its normal's noise, which is one draw for all its rows
    _, one, back = np.unique(planes.voxel, return_index=True, return_inverse=True)
    each = np.bincount(back, weight)[:, None]
    there = group[one]
    seen = np.einsum("pki,pij->pkj", along[one], white[there])
    squares = each * (seen * seen).sum(axis=1)
    held = each * np.einsum("pi,pij->pj", normal[one], white[there]) ** 2
    chance = np.empty((g, 3))
    count = np.empty((g, 3))
    for j in range(3):
        chance[:, j] = np.sqrt(2.0 * np.bincount(there, squares[:, j] ** 2, g))
        total = np.bincount(there, held[:, j], g)
        count[:, j] = total**2 / np.maximum(np.bincount(there, held[:, j] ** 2, g), 1e-30)
    hold = np.clip(share - CHANCE * chance, 0.0, 1.0)
    hold[hold > 0.98] = 1.0
    hold[count < least] = 0.0
    size = np.linalg.norm(white, axis=1)
    return _Hold(
        root @ (V * hold[:, None]) @ V.transpose(0, 2, 1) @ inverse,
        hold,
        hold == 0.0,
        white / size[:, None],
        size / np.maximum(hold, 1e-6),
    )


def _sum_outer(a: Array, b: Array, weight: Array, group: Indices, g: int) -> Array:
    """Return the sums of weight a b' over the rows of each group, shape (g, 3, 3)."""
    made = np.empty((g, 3, 3))
    for i in range(3):
        scaled = weight * a[:, i]
        for j in range(i, 3):
            made[:, i, j] = made[:, j, i] = np.bincount(group, scaled * b[:, j], g)
    return made


def _open_directions(found: Array, planes: Planes, weight: Array, apart: dict[int, Array]) -> Array:
    """Return an orthonormal basis of the directions without hold, shape (3, m).

    The normals show them but for their own noise. Rows that kept a little of the true ones would
    hold them after many scans: those that the filter knows least are taken, where they agree.
    """
    U = np.linalg.qr(found)[0]
    m = U.shape[1]
    P = np.zeros((3, 3))
    for owner, shift in apart.items():
        P += shift * float(weight[planes.owner == owner].sum())
    size, axes = np.linalg.eigh(P)
    if m == 3 or size[3 - m] < SEPARATE**2 * size[2 - m]:
        return U
    least_known = axes[:, 3 - m :]
    cosines = np.linalg.svd(U.T @ least_known, compute_uv=False)
    return least_known if cosines.min() > np.cos(AGREEING) else U
