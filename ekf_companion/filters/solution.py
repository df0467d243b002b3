"""The result of a filter: a table of estimates, covariances, and counts of fused and refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ekf_companion.filters.inertial import turn
from ekf_companion.filters.marg import MargSamples
from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import (
    ACCEL_BIAS,
    COLUMNS,
    EULER,
    GEODETIC,
    GYRO_BIAS,
    POSITION,
    QUATERNION,
    SIGMA,
    VELOCITY,
    Status,
    Table,
)

COVARIANCE_PERIOD_NS = 500_000_000
"""From one covariance that is kept to the next."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution:
    """The result of a filter over a recording."""

    name: str
    table: Table
    """An estimate per inertial sample; its stamp is the time at which it is valid."""
    covariance_ns: Stamps
    """Stamps of the covariances, shape (m,)."""
    covariance: Array
    """Of the errors of attitude (rotation vector in n, rad), velocity and position (n), shape
    (m, 9, 9)."""
    is_still: Mask | None = None
    """Where the filter found the sensor at rest, shape (n,); None: it does not look for rest."""
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """By aid: number of fused and of refused measurements."""
    notes: tuple[str, ...] = ()
    """What the user should know, one sentence each."""

    def to_dict(self) -> dict[str, Any]:
        """Return a summary for JSON."""
        return {
            "filter": self.name,
            "estimates": len(self.table),
            "fused": {aid: fused for aid, (fused, _) in self.counts.items()},
            "refused": {aid: refused for aid, (_, refused) in self.counts.items()},
            "notes": list(self.notes),
        }

    def summary(self) -> Iterator[str]:
        """Yield the same as lines of text."""
        yield f"{self.name}: {len(self.table)} estimates"
        for aid, (fused, refused) in self.counts.items():
            yield f"  {aid}: {fused} fused, {refused} refused"
        yield from (f"  note: {note}" for note in self.notes)


class Recorder:
    """Collects a solution, estimate by estimate."""

    def __init__(self, name: str, frame: LocalFrame | None) -> None:
        """Start empty; without a frame the place of the positions on the Earth is not known."""
        self._name, self._frame = name, frame
        self._stamps: list[int] = []
        self._states: list[Nominal] = []
        self._sigmas: list[Array] = []
        self._attitude_covariances: list[Array] = []
        self._resets: list[int] = []
        self._kept_ns: list[int] = []
        self._kept: list[Array] = []

    def __len__(self) -> int:
        return len(self._stamps)

    def add(self, t_ns: int, state: Nominal, P: Array, resets: int = 0) -> None:
        """Add an estimate, its covariance as :attr:`Solution.covariance`, the resets so far."""
        self._stamps.append(t_ns)
        self._states.append(state)
        self._sigmas.append(np.sqrt(np.maximum(np.diagonal(P), 0.0)))
        self._attitude_covariances.append(P[:3, :3].copy())
        self._resets.append(resets)
        if not self._kept_ns or t_ns - self._kept_ns[-1] >= COVARIANCE_PERIOD_NS:
            self._kept_ns.append(t_ns)
            self._kept.append(P.copy())

    def solution(
        self,
        *,
        is_still: Mask | None = None,
        counts: Mapping[str, tuple[int, int]] | None = None,
        notes: tuple[str, ...] = (),
    ) -> Solution:
        """Return what was collected."""
        return Solution(
            name=self._name,
            table=_table(np.array(self._stamps, dtype=np.int64), self._columns()),
            covariance_ns=np.array(self._kept_ns, dtype=np.int64),
            covariance=np.array(self._kept).reshape(-1, 9, 9),
            is_still=is_still,
            counts=dict(counts or {}),
            notes=notes,
        )

    def _columns(self) -> dict[tuple[str, ...], Array]:
        if not self._states:
            return {}
        q_nb = np.array([one.q_nb for one in self._states])
        pos_n = np.array([one.pos_n for one in self._states])
        angles = so3.to_euler(q_nb)
        sigmas = np.array(self._sigmas)
        of_angles = euler_sigmas(angles, np.array(self._attitude_covariances))
        status = np.full(len(q_nb), float(Status.OK))
        columns = {
            EULER: angles,
            QUATERNION: so3.normalise(q_nb),
            POSITION: pos_n,
            VELOCITY: np.array([one.vel_n for one in self._states]),
            GYRO_BIAS: np.array([one.gyro_bias for one in self._states]),
            ACCEL_BIAS: np.array([one.accel_bias for one in self._states]),
            SIGMA: np.hstack([sigmas[:, 6:9], sigmas[:, 3:6], of_angles]),
            ("status", "reset_count"): np.stack([status, self._resets], axis=1),
            ("reasons",): np.zeros((len(q_nb), 1)),
        }
        if self._frame is not None:
            lat, lon, alt = self._frame.to_geodetic(pos_n)
            columns[GEODETIC] = np.stack([np.rad2deg(lat), np.rad2deg(lon), alt], axis=1)
        return columns


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AttitudeEstimates:
    """What a filter of attitude alone estimates at each of its samples."""

    q_nb: Array
    """From magnetic north, shape (n, 4)."""
    bias: Array | None = None
    """Of the gyro, rad/s, b, shape (n, 3); None: not estimated."""
    covariance: Array | None = None
    """Of the rotation vector in n, rad^2, shape (n, 3, 3), or of that and more; None: not
    estimated."""
    is_still: Mask | None = None
    """Where it found the sensor at rest, shape (n,); None: it does not look for rest."""
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """By aid: number of fused and of refused measurements."""
    notes: tuple[str, ...] = ()
    """What the user should know, one sentence each."""


def attitude_solution(name: str, samples: MargSamples, found: AttitudeEstimates) -> Solution:
    """Return the solution of a filter of attitude alone; what is not known is NaN.

    The samples add the declination and their notes.
    """
    q_nb = so3.normalise(turn(found.q_nb, samples.declination))
    n = len(q_nb)
    kept = np.unique((samples.t_ns - samples.t_ns[0]) // COVARIANCE_PERIOD_NS, return_index=True)[1]
    blocks = np.full((len(kept), 9, 9), np.nan)
    status = np.full(n, float(Status.ATTITUDE))
    seen = np.flatnonzero(samples.has_mag)
    status[: seen[0] if len(seen) else 0] = Status.ALIGNING
    angles = so3.to_euler(q_nb)
    columns = {
        EULER: angles,
        QUATERNION: q_nb,
        ("status", "reset_count", "reasons"): np.stack([status, *np.zeros((2, n))], axis=1),
    }
    if found.bias is not None:
        columns[GYRO_BIAS] = found.bias
    if found.covariance is not None:
        C = so3.to_matrix(so3.from_euler(0.0, 0.0, samples.declination))
        covariance = np.einsum("ij,njk,lk->nil", C, found.covariance[:, :3, :3], C)
        columns[SIGMA[-3:]] = euler_sigmas(angles, covariance)
        blocks[:, :3, :3] = covariance[kept]
    return Solution(
        name=name,
        table=_table(samples.t_ns, columns),
        covariance_ns=samples.t_ns[kept],
        covariance=blocks,
        is_still=found.is_still,
        counts=found.counts,
        notes=samples.notes + found.notes,
    )


def _table(stamp_ns: Stamps, columns: Mapping[tuple[str, ...], Array]) -> Table:
    """Return a table of columns by their names, NaN in the others."""
    values = np.full((len(stamp_ns), len(COLUMNS) - 1), np.nan)
    for names, numbers in columns.items():
        values[:, [COLUMNS.index(name) - 1 for name in names]] = numbers
    return Table(stamp_ns=stamp_ns, values=values)


def euler_sigmas(angles: Array, covariance: Array) -> Array:
    """Return one sigma of roll, pitch and yaw, rad, shape (n, 3).

    The covariance, shape (n, 3, 3), is of the rotation vector in n at the angles, rad.
    """
    pitch, yaw = angles[:, 1], angles[:, 2]
    sine, cosine, zero = np.sin(yaw), np.cos(yaw), np.zeros(len(yaw))
    level = np.maximum(np.cos(pitch), 1e-3)
    along = np.stack([cosine, sine, zero], axis=1)
    rows = (
        along / level[:, None],
        np.stack([-sine, cosine, zero], axis=1),
        along * (np.sin(pitch) / level)[:, None] + np.array([0.0, 0.0, 1.0]),
    )
    squares = [np.einsum("ni,nij,nj->n", row, covariance, row) for row in rows]
    return np.asarray(np.sqrt(np.maximum(np.stack(squares, axis=1), 0.0)))
