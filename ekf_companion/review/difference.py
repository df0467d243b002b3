"""Differences of an estimate from a reference, at the stamps that both cover.

The denser of the two is interpolated at the other's stamps, never over a gap. Each function returns
None if the two have no time in common.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import pair
from ekf_companion.nav.state import Trajectory

Span = tuple[int, int]
"""First and last stamp that count, ns."""
SETTLED_NS = 20_000_000_000
"""After the first position, the errors of the start no longer count."""
ALWAYS: Span = (int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max))


def frame_of(reference: Trajectory) -> LocalFrame:
    """Return the frame whose origin is the reference's first position."""
    alt = float(reference.alt[0])
    lat, lon = float(reference.lat[0]), float(reference.lon[0])
    return LocalFrame(lat, lon, alt if np.isfinite(alt) else 0.0)


def in_position(
    estimate: Trajectory,
    reference: Trajectory,
    span: Span = ALWAYS,
    frame: LocalFrame | None = None,
) -> tuple[Stamps, Array] | None:
    """Return stamps and errors north, east, down, m, shapes (n,) and (n, 3).

    The frame is by default that of the reference.
    """
    if (found := pair(estimate.pos_t_ns, reference.pos_t_ns, *span)) is None:
        return None
    frame = frame or frame_of(reference)
    mine, theirs = (frame.to_ned(one.lat, one.lon, one.alt) for one in (estimate, reference))
    return found.at_ns, found.difference(mine, theirs)


def once_settled(estimate: Trajectory, reference: Trajectory) -> tuple[Stamps, Array] | None:
    """Return :func:`in_position` of the time after the start, ``SETTLED_NS``."""
    if not len(estimate.pos_t_ns):
        return None
    begin_ns = int(estimate.pos_t_ns[0]) + SETTLED_NS
    return in_position(estimate, reference, (begin_ns, int(estimate.pos_t_ns[-1])))


def in_velocity(
    estimate: Trajectory, reference: Trajectory, span: Span = ALWAYS
) -> tuple[Stamps, Array] | None:
    """Return stamps and errors north, east, down, m/s, shapes (n,) and (n, 3)."""
    if (found := pair(estimate.vel_t_ns, reference.vel_t_ns, *span)) is None:
        return None
    return found.at_ns, found.difference(estimate.vel_n, reference.vel_n)


def in_attitude(
    estimate: Trajectory, reference: Trajectory, span: Span = ALWAYS
) -> tuple[Stamps, Array, Array] | None:
    """Return stamps, and q_nb of both, shapes (n,) and (n, 4)."""
    if (found := pair(estimate.att_t_ns, reference.att_t_ns, *span)) is None:
        return None
    return found.at_ns, *found.rotations(estimate.q_nb, reference.q_nb)


def euler_errors(mine: Array, theirs: Array) -> Array:
    """Return the errors of roll, pitch and yaw of quaternions, rad, shape (n, 3)."""
    return so3.wrap(so3.to_euler(mine) - so3.to_euler(theirs))


def tilt_errors(mine: Array, theirs: Array) -> Array:
    """Return the angles between the two directions of down, rad, shape (n,)."""
    down = [so3.to_matrix(q)[:, 2, :] for q in (mine, theirs)]
    return np.asarray(np.arccos(np.clip(np.sum(down[0] * down[1], axis=1), -1.0, 1.0)))


def rms(values: Array) -> float:
    """Return the root mean square of the finite values; NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else float("nan")
