"""Where a vehicle is in its map after a time of which nothing is known.

An update finds the pose of least cost near the one that was predicted, and after such a time one of
many. So the points of a second are compared with the whole map, in each heading and at each place
that the prediction leaves: by the number of cells that points and map share, a correlation, and
from the best of these poses on by the planes. A pose is found if the points fit the planes there
and nowhere else: what looks the same at two places shows neither.

Source: Olson 2009, "Real-time correlative scan matching" (all poses, from coarse to fine).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar.sampling import grouped, thin
from ekf_companion.lidar.state import exp, log
from ekf_companion.lidar.voxel_map import VoxelMap
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.direction import levelled

CELL = 1.0
"""Of the correlation, m: planes of voxels of 2 m lead to a pose from half of it away."""
POINT_CELL, MOST_POINTS = 0.4, 2000
"""One point is taken in each voxel of this size, m, and at most so many."""
NEAR = 30.0
"""Range of the points that are compared, m: farther ones are few, and need finer headings."""
LEAST_POINTS = 50
"""Of a second, of which a scan of 32 lines has thousands: eight for each direction of a pose."""
MOST_CELLS = 1 << 19
"""Of a correlation, which takes 50 ms then: the map is taken as far as that."""
LARGEST_TURN = 0.15
"""From one heading to the next, rad: half of it moves what is 7 m away by half a cell."""
PEAKS, TRIED = 64, 60
"""Best shifts that are kept of each heading, and poses of all from which planes are followed."""
WIDTHS = np.repeat([1.0, 0.5, 0.25, 0.1], (4, 4, 4, 6))
"""Distance from its plane at which a row has half its weight, m, in each step of that."""
FITTING = 0.1
"""Distance from its plane within which a point fits, m: five times the noise of a range, as the
motion over that second is not known better."""
APART, TURNED = 0.5, 0.1
"""Distance, m, or angle, rad, from which on two poses are two."""
LEAST_FITTING = 0.5
"""Share of points that must fit, of that before."""
CHANCE = 3.0
"""Standard errors by which more points must fit than at any other pose."""
SIGMAS = 3.0
"""By which the prediction may be wrong, on each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A pose in the map."""

    C: Array
    """From the axes of the points to w."""
    pos_w: Array
    """m."""
    P: Array
    """Covariance of attitude (rotation vector in the axes of the points) and position, (6, 6)."""
    owner: int
    """Number of the anchor that most of the planes are tied to."""
    is_fitting: Mask
    """Which of the points fit its planes, shape (n,)."""

    @property
    def fitting(self) -> float:
        """Return the share of the points that fit its planes."""
        return float(np.mean(self.is_fitting))

    def is_apart(self, other: Place) -> bool:
        """Return whether it is another pose."""
        turn = float(np.linalg.norm(log(self.C.T @ other.C)))
        return float(np.linalg.norm(self.pos_w - other.pos_w)) > APART or turn > TURNED


def relocate(
    points: Array,
    voxels: VoxelMap,
    down_w: Array,
    C: Array,
    pos_w: Array,
    yaw_sigma: float,
    P_pos: Array,
    share: float,
) -> Place | None:
    """Return the only pose at which points fit the planes of a map; None: there is not one.

    Args:
        points: m, shape (n, 3), from the pose that is sought.
        voxels: The map.
        down_w: Unit vector.
        C: Attitude that is expected; its tilt is right.
        pos_w: Position that is expected, m.
        yaw_sigma: Of the heading, rad.
        P_pos: Covariance of the position, m^2, shape (3, 3).
        share: Of points that lay on planes before.
    """
    points = points[np.linalg.norm(points, axis=1) < NEAR]
    points = points[thin(points, POINT_CELL, MOST_POINTS)]
    if len(points) < LEAST_POINTS:
        return None
    found: list[Place] = []
    for turn, place in _correlated(points, voxels, levelled(down_w), C, pos_w, yaw_sigma, P_pos):
        if (one := followed(points, voxels, turn, place)) is not None:
            found.append(one)
    found.sort(key=lambda one: -one.fitting)
    if not found or found[0].fitting < LEAST_FITTING * share:
        return None
    best = found[0]
    rivals = (one for one in found if best.is_apart(one))

    def against(one: Place) -> float:
        """Return the square of the sigmas by which a place is not where it is expected."""
        apart = one.pos_w - pos_w
        yaw = float(log(C.T @ one.C) @ (C.T @ down_w))
        return (yaw / yaw_sigma) ** 2 + float(apart @ np.linalg.solve(P_pos, apart))

    def is_better(one: Place) -> bool:
        """Return whether points and expectation are for the best rather than for another."""
        excess = _excess(points, best, one)
        return excess * abs(excess) + against(one) - against(best) > CHANCE**2

    return best if all(is_better(one) for one in rivals) else None


def _excess(points: Array, first: Place, second: Place) -> float:
    """Return by how many sigmas more points fit at one place than at another.

    Points of one cell are taken for one. Of those that fit at one of the places only, as many
    would fit at either by chance (McNemar 1947).
    """
    order, begin, count = grouped(np.floor(points / CELL).astype(np.int64))
    share = 1.0 / np.repeat(count, count)
    only = np.add.reduceat(
        share * (first.is_fitting[order].astype(float) - second.is_fitting[order]), begin
    )
    return float(only.sum() / np.sqrt(max(float(only @ only), 1e-9)))


def _correlated(
    points: Array,
    voxels: VoxelMap,
    level: Array,
    C: Array,
    pos_w: Array,
    yaw_sigma: float,
    P_pos: Array,
) -> list[tuple[Array, Array]]:
    """Return poses at which points and map share most cells, the best first."""
    ahead, there = points @ (level @ C).T, level @ pos_w
    reach = SIGMAS * np.sqrt(np.diag(level @ P_pos @ level.T))
    size = float(np.linalg.norm(ahead, axis=1).max())
    map_cells = np.floor(voxels.points() @ level.T / CELL).astype(np.int64)
    # As far as these points reach from where they may be, or as a correlation allows
    far = np.ceil((reach + size) / CELL)
    while np.prod(2 * (far + size / CELL)) > MOST_CELLS and far.max() > size / CELL:
        far = np.where(far == far.max(), 0.8 * far, far)
    map_cells = map_cells[(np.abs(map_cells - there / CELL) <= far).all(axis=1)]
    if not len(map_cells):
        return []
    low = map_cells.min(axis=0)
    extent = map_cells.max(axis=0) - low + 1
    wide = np.linalg.norm(ahead[:, :2], axis=1).max()
    pad = np.ceil(np.array([2.0 * wide, 2.0 * wide, np.ptp(ahead[:, 2])]) / CELL).astype(int) + 2
    shape = tuple((extent + pad).tolist())
    occupied = np.zeros(shape)
    occupied[tuple((map_cells - low).T)] = 1.0
    spectrum = np.fft.rfftn(occupied)

    spread = float(np.median(np.linalg.norm(ahead[:, :2], axis=1)))
    most = min(SIGMAS * yaw_sigma, np.pi)
    count = int(np.ceil(most / min(LARGEST_TURN, CELL / max(spread, CELL))))
    around = np.linspace(-most, most, 2 * count + 1)
    peaks: list[tuple[float, float, Array]] = []
    for yaw in around.tolist():
        turned = ahead @ exp(np.array([0.0, 0.0, yaw])).T
        cells = np.floor(turned / CELL).astype(np.int64)
        first = cells.min(axis=0)
        mine = np.zeros(shape)
        mine[tuple((cells - first).T)] = 1.0
        shared = np.fft.irfftn(spectrum * np.conj(np.fft.rfftn(mine)), shape, axes=(0, 1, 2))
        axes = []
        for k in range(3):
            near = np.arange(
                np.floor((there[k] - reach[k]) / CELL), np.ceil((there[k] + reach[k]) / CELL) + 1
            )
            at = near.astype(np.int64) + first[k] - low[k]
            axes.append(near[(at > -pad[k]) & (at < extent[k])].astype(np.int64))
        index = [(axis + first[k] - low[k]) % shape[k] for k, axis in enumerate(axes)]
        window = shared[np.ix_(*index)]
        if not window.size:
            continue
        best = np.argsort(-window, axis=None)[:PEAKS]
        for i, j, k in zip(*np.unravel_index(best, window.shape), strict=True):
            shift = CELL * np.array([axes[0][i], axes[1][j], axes[2][k]])
            peaks.append((float(window[i, j, k]), yaw, shift))
    peaks.sort(key=lambda one: -one[0])
    chosen: list[tuple[float, Array]] = []
    step = around[1] - around[0]
    for _, yaw, shift in peaks:
        if all(
            abs(yaw - other) > 1.5 * step or np.abs(shift - place).max() > 1.5 * CELL
            for other, place in chosen
        ):
            chosen.append((yaw, shift))
        if len(chosen) == TRIED:
            break
    return [
        (level.T @ exp(np.array([0.0, 0.0, yaw])) @ level @ C, level.T @ shift)
        for yaw, shift in chosen
    ]


def followed(points: Array, voxels: VoxelMap, C: Array, pos_w: Array) -> Place | None:
    """Return the pose at which points lie on the planes of a map, from one nearby."""
    for width in WIDTHS.tolist():
        lever = points @ C.T
        planes = voxels.match(lever + pos_w)
        if not len(planes.index):
            return None
        lever, normal = lever[planes.index], planes.normal
        z = np.einsum("ni,ni->n", normal, planes.centre - lever - pos_w)
        weight = 1.0 / (1.0 + (z / width) ** 2)
        H = np.hstack([np.cross(lever, normal), normal])
        A = (H.T * weight) @ H
        # One row in each direction keeps what has no hold where it is
        dx = np.linalg.solve(A + np.eye(6), (H.T * weight) @ z)
        C, pos_w = exp(dx[:3]) @ C, pos_w + dx[3:]
    turn = np.eye(6)
    turn[:3, :3] = C
    # As if a third of the rows held each direction, and all were wrong together
    P = FITTING**2 * len(z) / 3.0 * np.linalg.inv(turn.T @ (A + np.eye(6)) @ turn)
    owner = int(np.bincount(planes.owner, weight).argmax())
    lever = points @ C.T
    planes = voxels.match(lever + pos_w)
    distance = np.full(len(points), np.inf)
    distance[planes.index] = np.einsum(
        "ni,ni->n", planes.normal, planes.centre - lever[planes.index] - pos_w
    )
    return Place(C, pos_w, P, owner, np.abs(distance) < FITTING)
