"""Consistency of a filter: its errors, normalised by its own covariance.

The normalised estimation error squared (NEES) is e' P^-1 e. With a true covariance its mean is the
number of components of e; divided by that number, 1 is right, more means a filter that is too sure
of itself, less one that is too cautious.

Source: Bar-Shalom, Li, Kirubarajan 2001, "Estimation with applications to tracking and navigation",
section 5.4.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import Between, between
from ekf_companion.nav.state import GEODETIC, QUATERNION, VELOCITY, Table, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class Nees:
    """Mean NEES over the number of components; NaN: estimate or truth lacks the quantity."""

    position: float
    """A constant between the two datums of altitude counts as an error."""
    velocity: float
    attitude: float
    count: int
    """Number of errors. Those of one flight depend on each other, so the chi-square bounds of so
    many independent ones are too narrow."""


def nees(solution: Solution, truth: Trajectory, begin_ns: int, end_ns: int) -> Nees:
    """Normalise a filter's errors between two stamps by its covariances.

    The truth is interpolated at the covariances' stamps, never over a gap. Components that the
    truth lacks (the altitude, the vertical velocity) are left out, and so are covariances that are
    not positive definite.
    """
    wanted = (solution.covariance_ns >= begin_ns) & (solution.covariance_ns <= end_ns)
    wanted &= np.isin(solution.covariance_ns, solution.table.stamp_ns)
    at_ns, P = solution.covariance_ns[wanted], solution.covariance[wanted]
    rows = np.searchsorted(solution.table.stamp_ns, at_ns)
    means, counts = [], []
    for errors_of, first, t_ns, known in (
        (_position, 6, truth.pos_t_ns, known_rows(np.stack([truth.lat, truth.lon], axis=1))),
        (_velocity, 3, truth.vel_t_ns, known_rows(truth.vel_n[:, :2])),
        (_attitude, 0, truth.att_t_ns, known_rows(truth.q_nb)),
    ):
        mean, count = np.nan, 0
        if known.sum() > 1:
            found, block = between(t_ns[known], at_ns), slice(first, first + 3)
            errors = errors_of(solution.table, truth, known, rows, found)
            mean, count = _mean(errors, P[found.wanted, block, block])
        means.append(mean)
        counts.append(count)
    return Nees(position=means[0], velocity=means[1], attitude=means[2], count=max(counts))


def _position(table: Table, truth: Trajectory, known: Mask, rows: Stamps, found: Between) -> Array:
    """Return the errors north, east, down, m, shape (k, 3)."""
    lat, lon, alt = truth.lat[known], truth.lon[known], truth.alt[known]
    place = table.columns(GEODETIC)[rows[found.wanted]].T
    heights = np.concatenate([alt, place[2], [0.0]])
    frame = LocalFrame(float(lat[0]), float(lon[0]), float(heights[np.isfinite(heights)][0]))
    mine = frame.to_ned(np.deg2rad(place[0]), np.deg2rad(place[1]), place[2])
    return found.values(frame.to_ned(lat, lon, alt)) - mine


def _velocity(table: Table, truth: Trajectory, known: Mask, rows: Stamps, found: Between) -> Array:
    """Return the errors north, east, down, m/s, shape (k, 3)."""
    return found.values(truth.vel_n[known]) - table.columns(VELOCITY)[rows[found.wanted]]


def _attitude(table: Table, truth: Trajectory, known: Mask, rows: Stamps, found: Between) -> Array:
    """Return the rotation vectors in n from the estimate to the truth, rad, shape (k, 3)."""
    mine = table.columns(QUATERNION)[rows[found.wanted]]
    turn = so3.multiply(found.rotations(truth.q_nb[known]), so3.conjugate(mine))
    return np.asarray(so3.log(turn))


def _mean(errors: Array, P: Array) -> tuple[float, int]:
    """Return the mean NEES over the number of known components, and the number of errors."""
    axes = np.flatnonzero(np.isfinite(errors).any(axis=0))
    errors, P = errors[:, axes], P[:, axes[:, None], axes]
    is_good = known_rows(errors) & np.isfinite(P).all(axis=(1, 2))
    errors, P = errors[is_good], P[is_good]
    is_positive = (np.linalg.eigvalsh(P) > 0.0).all(axis=1)
    errors, P = errors[is_positive], P[is_positive]
    if errors.size == 0:
        return np.nan, 0
    whitened = np.linalg.solve(P, errors[:, :, None])[:, :, 0]
    return float((errors * whitened).sum(axis=1).mean()) / len(axes), len(errors)
