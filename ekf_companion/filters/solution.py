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
        """Give what can be told of it for JSON."""
        return {
            "filter": self.name,
            "estimates": len(self.table),
            "fused": {aid: fused for aid, (fused, _) in self.counts.items()},
            "refused": {aid: refused for aid, (_, refused) in self.counts.items()},
            "notes": list(self.notes),
        }

    def summary(self) -> Iterator[str]:
        """Give the same as lines to read."""
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
        self._kept_ns: list[int] = []
        self._kept: list[Array] = []

    def __len__(self) -> int:
        """Give how many estimates it has."""
        return len(self._stamps)

    def add(self, t_ns: int, state: Nominal, P: Array) -> None:
        """Take an estimate and its covariance, ordered as :attr:`Solution.covariance`."""
        self._stamps.append(t_ns)
        self._states.append(state)
        self._sigmas.append(np.sqrt(np.maximum(np.diagonal(P), 0.0)))
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
        """Give what was collected."""
        n = len(self._stamps)
        values = np.full((n, len(COLUMNS) - 1), np.nan)
        put = {name: values[:, index] for index, name in enumerate(COLUMNS[1:])}
        if n:
            q_nb = np.array([one.q_nb for one in self._states])
            pos_n = np.array([one.pos_n for one in self._states])
            _fill(put, "roll pitch yaw", so3.to_euler(q_nb))
            _fill(put, "q_w q_x q_y q_z", so3.normalise(q_nb))
            _fill(put, "pos_n pos_e pos_d", pos_n)
            _fill(put, "vel_n vel_e vel_d", np.array([one.vel_n for one in self._states]))
            for sensor in ("gyro", "accel"):
                biases = np.array([getattr(one, f"{sensor}_bias") for one in self._states])
                _fill(put, " ".join(f"{sensor}_bias_{axis}" for axis in "xyz"), biases)
            sigmas = np.array(self._sigmas)
            _fill(put, "sd_pos_n sd_pos_e sd_pos_d", sigmas[:, 6:9])
            _fill(put, "sd_vel_n sd_vel_e sd_vel_d", sigmas[:, 3:6])
            _fill(put, "sd_roll sd_pitch sd_yaw", _euler_sigmas(q_nb, sigmas[:, :3]))
            if self._frame is not None:
                lat, lon, alt = self._frame.to_geodetic(pos_n)
                put["lat_deg"][:], put["lon_deg"][:], put["alt_m"][:] = (
                    np.rad2deg(lat),
                    np.rad2deg(lon),
                    alt,
                )
            put["status"][:] = Status.OK
            put["reset_count"][:] = 0.0
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


def _euler_sigmas(q_nb: Array, sigmas: Array) -> Array:
    """Give one sigma of roll, pitch, yaw from those about north, east, down, taken as independent.

    A turn by theta (in n) changes yaw by theta_d + tan(pitch) (cos(yaw) theta_n + sin(yaw)
    theta_e), pitch by cos(yaw) theta_e - sin(yaw) theta_n, and roll by the rest over cos(pitch).
    """
    angles = so3.to_euler(q_nb)
    pitch, yaw = angles[:, 1], angles[:, 2]
    north, east, down = np.square(sigmas).T
    c2, s2 = np.square(np.cos(yaw)), np.square(np.sin(yaw))
    across = c2 * north + s2 * east
    level = np.maximum(np.square(np.cos(pitch)), 1e-6)
    roll2 = across / level
    pitch2 = s2 * north + c2 * east
    yaw2 = down + np.square(np.tan(pitch)) * across
    return np.asarray(np.sqrt(np.stack([roll2, pitch2, yaw2], axis=1)))
