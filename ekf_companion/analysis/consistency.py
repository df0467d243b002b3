"""Whether a filter is as good as it says: its errors, measured by its own covariance.

The normalised estimation error squared (NEES) is e' P^-1 e. Of a filter whose covariance is true
its mean is the number of components of e; it is given over that number, so 1 is right, more is a
filter that believes itself too much, less one that believes itself too little.

Source: Bar-Shalom, Li, Kirubarajan 2001, "Estimation with applications to tracking and navigation",
section 5.4.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import between
from ekf_companion.nav.state import Trajectory

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Nees:
    """Mean NEES over the components; 1 is right. None: estimate or truth lacks the quantity."""

    position: float | None
    """A constant between the two datums of altitude counts in it as an error."""
    velocity: float | None
    attitude: float | None
    count: int
    """Covariances that an error was measured by. Errors of one flight depend on each other, so the
    chi-square bounds of so many independent ones are too narrow."""


def nees(solution: Solution, truth: Trajectory, begin_ns: int, end_ns: int) -> Nees:
    """Measure a filter's errors by its covariances.

    The truth is interpolated at the covariances' stamps, never over a gap. Components that the
    truth lacks (the altitude, the vertical velocity) are left out, and so are covariances that are
    not positive definite: they say nothing.

    Args:
        solution: Of a filter.
        truth: Its series may have stamps of their own.
        begin_ns: Nothing earlier counts.
        end_ns: Nothing later.
    """
    wanted = (solution.covariance_ns >= begin_ns) & (solution.covariance_ns <= end_ns)
    wanted &= np.isin(solution.covariance_ns, solution.table.stamp_ns)
    at_ns, P = solution.covariance_ns[wanted], solution.covariance[wanted]
    rows = np.searchsorted(solution.table.stamp_ns, at_ns)
    values = [
        _mean(errors, P[asked, i : i + 3, i : i + 3])
        for i, (asked, errors) in zip(
            (6, 3, 0),
            (
                _position(solution, truth, rows, at_ns),
                _velocity(solution, truth, rows, at_ns),
                _attitude(solution, truth, rows, at_ns),
            ),
            strict=True,
        )
    ]
    return Nees(
        position=values[0][0],
        velocity=values[1][0],
        attitude=values[2][0],
        count=max(count for _, count in values),
    )


def _columns(solution: Solution, names: str, rows: Stamps) -> Array:
    return np.stack([solution.table.column(name)[rows] for name in names.split()], axis=-1)


_Errors = tuple[Stamps, Array]
"""Which of the stamps could be asked, and truth less estimate there, shape (k, 3)."""
_NOTHING: _Errors = (np.zeros(0, dtype=np.int64), np.zeros((0, 3)))


def _position(solution: Solution, truth: Trajectory, rows: Stamps, at_ns: Stamps) -> _Errors:
    """Give the errors north, east, down, m."""
    known = np.flatnonzero(np.isfinite(truth.lat) & np.isfinite(truth.lon))
    if len(known) < 2:
        return _NOTHING
    lat, lon, alt = truth.lat[known], truth.lon[known], truth.alt[known]
    found = between(truth.pos_t_ns[known], at_ns)
    place = _columns(solution, "lat_deg lon_deg alt_m", rows[found.wanted]).T
    heights = np.concatenate([alt, place[2], [0.0]])
    frame = LocalFrame(float(lat[0]), float(lon[0]), float(heights[np.isfinite(heights)][0]))
    mine = frame.to_ned(np.deg2rad(place[0]), np.deg2rad(place[1]), place[2])
    return found.wanted, found.values(frame.to_ned(lat, lon, alt)) - mine


def _velocity(solution: Solution, truth: Trajectory, rows: Stamps, at_ns: Stamps) -> _Errors:
    """Give the errors north, east, down, m/s."""
    known = np.flatnonzero(np.isfinite(truth.vel_n[:, :2]).all(axis=1))
    if len(known) < 2:
        return _NOTHING
    found = between(truth.vel_t_ns[known], at_ns)
    mine = _columns(solution, "vel_n vel_e vel_d", rows[found.wanted])
    return found.wanted, found.values(truth.vel_n[known]) - mine


def _attitude(solution: Solution, truth: Trajectory, rows: Stamps, at_ns: Stamps) -> _Errors:
    """Give the rotation vectors in n that turn the estimate into the truth, rad."""
    known = np.flatnonzero(np.isfinite(truth.q_nb).all(axis=1))
    if len(known) < 2:
        return _NOTHING
    found = between(truth.att_t_ns[known], at_ns)
    mine = _columns(solution, "q_w q_x q_y q_z", rows[found.wanted])
    turn = so3.multiply(found.rotations(truth.q_nb[known]), so3.conjugate(mine))
    return found.wanted, so3.log(turn)


def _mean(errors: Array, P: Array) -> tuple[float | None, int]:
    """Give the mean NEES over the components that are known, and of how many errors."""
    axes = np.flatnonzero(np.isfinite(errors).any(axis=0))
    if len(axes) == 0:
        return None, 0
    errors, P = errors[:, axes], P[:, axes[:, None], axes]
    is_good = np.isfinite(errors).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
    errors, P = errors[is_good], P[is_good]
    is_good = (np.linalg.eigvalsh(P) > 0.0).all(axis=1)
    errors, P = errors[is_good], P[is_good]
    if len(errors) == 0:
        return None, 0
    whitened = np.linalg.solve(P, errors[:, :, None])[:, :, 0]
    return float((errors * whitened).sum(axis=1).mean()) / len(axes), len(errors)
