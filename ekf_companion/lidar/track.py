"""The estimates of a recording as rows of numbers: 600 bytes of each scan, not objects of 7 kB."""

from __future__ import annotations

import numpy as np

from ekf_companion.lidar.odometry import Estimate
from ekf_companion.lidar.relative import RelativePose
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.relative_pose import UPPER as UPPER_POSE

SEEN = 9
"""Error states whose covariance is kept: attitude, position, velocity."""
UPPER = np.triu_indices(SEEN)
BLOCK = 1024
"""Rows that are made room for at once: nothing is moved when more come."""
_COLUMNS = {
    "stamp": 1,
    "C_wb": 9,
    "pos_w": 3,
    "vel_w": 3,
    "P": len(UPPER[0]),
    "used": 1,
    "rms": 1,
    "hold": 3,
    "open": 1,
    "open_w": 9,
    "evaluations": 1,
}
_ENDS = np.cumsum(list(_COLUMNS.values()))
_AT = {
    name: slice(int(end) - size, int(end))
    for (name, size), end in zip(_COLUMNS.items(), _ENDS, strict=True)
}


class Track:
    """Estimates in the order of their stamps."""

    def __init__(self) -> None:
        self._blocks: list[Array] = []
        self._count = 0
        self._relatives: list[Array] = []
        self.last: Estimate | None = None
        self.clipped = 0
        """Inertial samples at the end of their range."""
        self.lost = 0.0
        """Time without inertial samples, s."""

    def __len__(self) -> int:
        """Return the number of estimates."""
        return self._count

    def add(self, one: Estimate) -> None:
        """Add the next one."""
        if self._count % BLOCK == 0:
            self._blocks.append(np.empty((BLOCK, int(_ENDS[-1]))))
        row = self._blocks[-1][self._count % BLOCK]
        self._count += 1
        x, match = one.state, one.match
        row[_AT["stamp"]], row[_AT["C_wb"]] = one.stamp, x.C_wb.ravel()
        row[_AT["pos_w"]], row[_AT["vel_w"]] = x.pos_w, x.vel_w
        row[_AT["P"]] = one.P[:SEEN, :SEEN][UPPER]
        row[_AT["evaluations"]] = one.evaluations
        axes = np.eye(3) if match is None else match.open_w
        row[_AT["open"]] = axes.shape[1]
        row[_AT["open_w"]] = (axes @ axes.T).ravel()
        row[_AT["used"]] = 0 if match is None else match.used
        row[_AT["rms"]] = np.nan if match is None else match.rms
        row[_AT["hold"]] = np.nan if match is None else match.hold
        if one.relative is not None:
            self._relatives.append(_relative_row(one.relative))
        self.clipped, self.lost = self.clipped + one.clipped, self.lost + one.lost
        self.last = one

    def _column(self, name: str) -> Array:
        """Return a column of all rows, shape (n, width)."""
        parts = [block[:, _AT[name]] for block in self._blocks]
        if not parts:
            return np.zeros((0, _COLUMNS[name]))
        return np.concatenate(parts)[: self._count]

    @property
    def stamp(self) -> Array:
        """Return the ends of the scans, s, shape (n,)."""
        return self._column("stamp")[:, 0]

    @property
    def attitude(self) -> Array:
        """Return the attitudes, shape (n, 3, 3)."""
        return self._column("C_wb").reshape(-1, 3, 3)

    @property
    def pos_w(self) -> Array:
        """Return the positions, m, shape (n, 3)."""
        return self._column("pos_w")

    @property
    def vel_w(self) -> Array:
        """Return the velocities, m/s, shape (n, 3)."""
        return self._column("vel_w")

    @property
    def covariance(self) -> Array:
        """Return the covariances of attitude, position and velocity, shape (n, 9, 9)."""
        P = np.empty((self._count, SEEN, SEEN))
        P[:, UPPER[0], UPPER[1]] = P[:, UPPER[1], UPPER[0]] = self._column("P")
        return P

    @property
    def used(self) -> Array:
        """Return the numbers of points that were compared with planes, shape (n,)."""
        return self._column("used")[:, 0]

    @property
    def rms(self) -> Array:
        """Return the innovations in their sigmas, NaN without any, shape (n,)."""
        return self._column("rms")[:, 0]

    @property
    def hold(self) -> Array:
        """Return what each scan holds along three directions, NaN without planes, (n, 3)."""
        return self._column("hold")

    @property
    def open_axes(self) -> Array:
        """Return the numbers of directions without hold, shape (n,)."""
        return self._column("open")[:, 0]

    @property
    def open_w(self) -> Array:
        """Return the projections onto the directions without hold, shape (n, 3, 3)."""
        return self._column("open_w").reshape(-1, 3, 3)

    @property
    def evaluations(self) -> Array:
        """Return the numbers of evaluations of the update, shape (n,)."""
        return self._column("evaluations")[:, 0]

    @property
    def is_matched(self) -> Mask:
        """Return which scans were compared with planes, shape (n,)."""
        return np.asarray(np.isfinite(self.rms))

    @property
    def relatives(self) -> Array:
        """Return rows of both times, relative pose, and the upper triangle of its covariance."""
        return np.array(self._relatives).reshape(-1, 30)


def _relative_row(one: RelativePose) -> Array:
    w, x, y, z = so3.from_matrix(one.C).tolist()
    return np.array([one.start, one.end, *one.pos, x, y, z, w, *one.P[UPPER_POSE]])
