"""What every filter gives: a table of estimates, some covariances, what it fused and refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.strapdown import Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import COLUMNS, Status, Table

Array = npt.NDArray[np.float64]

COVARIANCE_PERIOD_NS = 500_000_000
"""From one covariance that is kept to the next."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Solution:
    """A filter's answer over a recording."""

    name: str
    table: Table
    """An estimate per inertial sample, its stamp the time when it is valid."""
    covariance_ns: npt.NDArray[np.int64]
    """Stamps of the covariances, shape (m,)."""
    covariance: Array
    """Of the errors of attitude (rotation vector in n, rad), velocity and position (n), shape
    (m, 9, 9)."""
    is_still: npt.NDArray[np.bool_] | None = None
    """Where the filter took the sensor to stand still, shape (n,); None: it does not ask."""
    counts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """By aid: how many were fused, how many refused."""
    notes: tuple[str, ...] = ()
    """What the user should know, one sentence each."""

    def to_dict(self) -> dict[str, Any]:
        """Return what can be told of it for JSON."""
        return {
            "filter": self.name,
            "estimates": len(self.table),
            "fused": {aid: fused for aid, (fused, _) in self.counts.items()},
            "refused": {aid: refused for aid, (_, refused) in self.counts.items()},
            "notes": list(self.notes),
        }

    def summary(self) -> Iterator[str]:
        """Return the same as lines to read."""
        yield f"{self.name}: {len(self.table)} estimates"
        for aid, (fused, refused) in self.counts.items():
            yield f"  {aid}: {fused} fused, {refused} refused"
        yield from (f"  note: {note}" for note in self.notes)


class Recorder:
    """Collects a solution, estimate by estimate."""

    def __init__(self, name: str, frame: LocalFrame | None) -> None:
        """Begin with nothing.

        Args:
            name: Of the filter.
            frame: Of the positions; None: they have no place on the Earth.
        """
        self._name, self._frame = name, frame
        self._stamps: list[int] = []
        self._states: list[Nominal] = []
        self._sigmas: list[Array] = []
        self._turns: list[Array] = []
        self._resets: list[int] = []
        self._kept_ns: list[int] = []
        self._kept: list[Array] = []

    def __len__(self) -> int:
        """Return how many estimates it has."""
        return len(self._stamps)

    def add(self, t_ns: int, state: Nominal, P: Array, resets: int = 0) -> None:
        """Take an estimate, its covariance, ordered as :attr:`Solution.covariance`, and resets."""
        self._stamps.append(t_ns)
        self._states.append(state)
        self._sigmas.append(np.sqrt(np.maximum(np.diagonal(P), 0.0)))
        self._turns.append(P[:3, :3].copy())
        self._resets.append(resets)
        if not self._kept_ns or t_ns - self._kept_ns[-1] >= COVARIANCE_PERIOD_NS:
            self._kept_ns.append(t_ns)
            self._kept.append(P.copy())

    def solution(
        self,
        *,
        is_still: npt.NDArray[np.bool_] | None = None,
        counts: Mapping[str, tuple[int, int]] | None = None,
        notes: tuple[str, ...] = (),
    ) -> Solution:
        """Return what was collected."""
        n = len(self._stamps)
        values = np.full((n, len(COLUMNS) - 1), np.nan)
        put = {name: values[:, index] for index, name in enumerate(COLUMNS[1:])}
        if n:
            q_nb = np.array([one.q_nb for one in self._states])
            pos_n = np.array([one.pos_n for one in self._states])
            angles = so3.to_euler(q_nb)
            _fill(put, "roll pitch yaw", angles)
            _fill(put, "q_w q_x q_y q_z", so3.normalise(q_nb))
            _fill(put, "pos_n pos_e pos_d", pos_n)
            _fill(put, "vel_n vel_e vel_d", np.array([one.vel_n for one in self._states]))
            for sensor in ("gyro", "accel"):
                biases = np.array([getattr(one, f"{sensor}_bias") for one in self._states])
                _fill(put, " ".join(f"{sensor}_bias_{axis}" for axis in "xyz"), biases)
            sigmas = np.array(self._sigmas)
            _fill(put, "sd_pos_n sd_pos_e sd_pos_d", sigmas[:, 6:9])
            _fill(put, "sd_vel_n sd_vel_e sd_vel_d", sigmas[:, 3:6])
            _fill(put, "sd_roll sd_pitch sd_yaw", euler_sigmas(angles, np.array(self._turns)))
            if self._frame is not None:
                lat, lon, alt = self._frame.to_geodetic(pos_n)
                put["lat_deg"][:], put["lon_deg"][:], put["alt_m"][:] = (
                    np.rad2deg(lat),
                    np.rad2deg(lon),
                    alt,
                )
            put["status"][:] = Status.OK
            put["reset_count"][:] = self._resets
        return Solution(
            name=self._name,
            table=Table(stamp_ns=np.array(self._stamps, dtype=np.int64), values=values),
            covariance_ns=np.array(self._kept_ns, dtype=np.int64),
            covariance=np.array(self._kept).reshape(-1, 9, 9),
            is_still=is_still,
            counts=dict(counts or {}),
            notes=notes,
        )


def _fill(put: Mapping[str, Array], names: str, columns: Array) -> None:
    for index, name in enumerate(names.split()):
        put[name][:] = columns[:, index]


def euler_sigmas(angles: Array, covariance: Array) -> Array:
    """Return one sigma of roll, pitch and yaw, rad, shape (n, 3).

    Args:
        angles: Roll, pitch, yaw, rad, shape (n, 3).
        covariance: Of the rotation vector in n, rad^2, shape (n, 3, 3).
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
