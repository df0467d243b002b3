"""Errors of an attitude against a truth: total, heading and inclination.

Source: Laidig, Caruso, Cereatti, Seel 2021, "BROAD: a benchmark for robust inertial orientation
estimation", Data 6(7), section 4: no alignment of any kind before the errors are computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.logs.recording import Counted
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.interpolation import between
from ekf_companion.nav.state import QUATERNION, Status, Table, Trajectory
from ekf_companion.review.difference import rms

LONGEST_GAP_NS = 100_000_000
"""Longest step between two estimates that is interpolated over."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AttitudeErrors:
    """Errors at the times at which the truth is known and an estimate is near."""

    t_ns: Stamps
    """Stamps of the truth, shape (n,)."""
    total: Array
    """Angle of the rotation from truth to estimate, rad, >= 0, shape (n,)."""
    heading: Array
    """Angle of its part about the vertical, rad, clockwise positive, shape (n,)."""
    inclination: Array
    """Angle of the remaining part, rad, >= 0, shape (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeScore:
    """Root mean squares of the errors, rad."""

    total: float
    heading: float
    inclination: float
    samples: int
    """Number of samples of the truth that were compared."""


def errors(table: Table, truth: Trajectory) -> AttitudeErrors:
    """Compare estimates with a truth at its own stamps.

    Estimates before alignment are left out.
    """
    valid = np.isfinite(table.column("q_w")) & (table.column("status") >= Status.ATTITUDE)
    stamps = table.stamp_ns[valid]
    q_nb = table.columns(QUATERNION)[valid]
    rows = known_rows(truth.q_nb)
    t_ns, true = truth.att_t_ns[rows], truth.q_nb[rows]
    if len(stamps) < 2:
        t_ns, true, estimate = t_ns[:0], true[:0], q_nb[:0]
    else:
        found = between(stamps, t_ns, LONGEST_GAP_NS)
        t_ns, true, estimate = t_ns[found.wanted], true[found.wanted], found.rotations(q_nb)
    error = so3.normalise(so3.multiply(estimate, so3.conjugate(true)))
    w, z = error[:, 0], error[:, 3]
    across = np.hypot(error[:, 1], error[:, 2])
    return AttitudeErrors(
        t_ns=t_ns,
        total=2.0 * np.arctan2(np.hypot(across, z), w),
        heading=2.0 * np.arctan2(z, w),
        inclination=2.0 * np.arctan2(across, np.hypot(w, z)),
    )


def score(table: Table, truth: Trajectory, counted: Counted | None = None) -> AttitudeScore:
    """Return the root mean square errors over the times that count; NaN if none does."""
    found = errors(table, truth)
    chosen = np.ones(len(found.t_ns), dtype=bool) if counted is None else counted.at(found.t_ns)
    return AttitudeScore(
        total=rms(found.total[chosen]),
        heading=rms(found.heading[chosen]),
        inclination=rms(found.inclination[chosen]),
        samples=int(chosen.sum()),
    )
