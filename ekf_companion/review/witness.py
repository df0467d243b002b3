"""Yaw, tilt and height of an estimate against a reference: the log's truth or the autopilot's."""

from __future__ import annotations

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps, in_pieces, median, runs
from ekf_companion.nav.state import Trajectory
from ekf_companion.review import difference
from ekf_companion.review.departure import (
    LONG_S,
    SIGMAS,
    TILT,
    YAW,
    Angle,
    Departure,
    Excess,
    Height,
)
from ekf_companion.review.report import Report

STEEP = np.deg2rad(60.0)
"""Pitch, rad, beyond which yaw is nearly a rotation about the axis of roll."""
FAST_NS = 250_000_000
"""Longest step, in the median, at which the next rotation can be predicted, and a jump found."""
UNKNOWN = 1.0
"""One sigma of yaw, rad, from which on there is no heading to compare: uniform over the circle it
is 1.8."""
STEP_NS = 500_000_000
"""Longest step between two stamps that counts as time beyond a sigma."""


def departure_of(report: Report, ours: Trajectory) -> Departure:
    """Return how far yaw, tilt and height are from a truth's, else from the autopilot's.

    Without positions the attitudes alone are compared.
    """
    if not len(ours.pos_t_ns):
        ours = report.track.attitudes()
    for other in (report.truth, report.own):
        if other is not None and len(ours.att_t_ns) and len(other.att_t_ns):
            is_truth = other is report.truth
            angles = _angles(report, ours, other, is_truth)
            if angles:
                return Departure(is_truth, angles, _height(report, ours, other))
    return Departure()


def _angles(
    report: Report, ours: Trajectory, other: Trajectory, is_truth: bool
) -> tuple[Angle, ...]:
    found = difference.in_attitude(ours, other)
    if found is None:
        return ()
    at_ns, mine, theirs = found
    sigmas = report.track.sigmas_at(at_ns)
    first_ns = ours.pos_t_ns[0] if len(ours.pos_t_ns) else ours.att_t_ns[0]
    settled = at_ns > first_ns + difference.SETTLED_NS
    is_fast = len(at_ns) > 1 and median(np.diff(at_ns)) <= FAST_NS
    turns = (_turns(mine), _turns(theirs)) if is_fast and not is_truth else ()
    yaw_errors = in_pieces(_yaw_errors, mine, theirs)
    yaw_errors[~(sigmas[:, 1] < UNKNOWN)] = np.nan
    angles = []
    for name, limit, errors, sigma in (
        ("yaw", YAW, yaw_errors, sigmas[:, 1]),
        ("tilt", TILT, in_pieces(difference.tilt_errors, mine, theirs), sigmas[:, 0]),
    ):
        beyond = np.nan_to_num(errors) > np.maximum(SIGMAS * sigma, limit)
        beyond = _lasting(at_ns, beyond)
        is_theirs = _jumps(beyond, *turns)
        ours_beyond, jumped = (
            _excess(report, at_ns, errors, sigma, of) for of in (beyond & ~is_theirs, is_theirs)
        )
        rms = difference.rms(errors[settled & ~is_theirs])
        angles.append(Angle(name, limit, rms, float(_steps(at_ns).sum()), ours_beyond, jumped))
    return tuple(angles)


def _yaw_errors(mine: Array, theirs: Array) -> Array:
    """Return the difference of two yaws, rad; NaN where either attitude is steep."""
    eulers = np.stack([so3.to_euler(q) for q in (mine, theirs)])
    errors = np.abs(so3.wrap(eulers[0, :, 2] - eulers[1, :, 2]))
    errors[(np.abs(eulers[..., 1]) > STEEP).any(axis=0)] = np.nan
    return errors


def _steps(at_ns: Stamps) -> Array:
    """Return the time that each stamp stands for, s."""
    return np.asarray(np.minimum(np.diff(at_ns, append=at_ns[-1]), STEP_NS) * 1e-9)


def _turns(q_nb: Array) -> Array:
    """Return the rotation from each attitude to the next, b, rad, shape (n - 1, 3)."""

    def turn(before: Array, after: Array) -> Array:
        return so3.log(so3.multiply(so3.conjugate(before), after))

    return in_pieces(turn, q_nb[:-1], q_nb[1:])


def _lasting(at_ns: Stamps, beyond: Mask) -> Mask:
    """Keep errors that last: in a fast turn, clocks that differ a little look like an error."""
    steps, found = _steps(at_ns), np.zeros(len(beyond), dtype=np.bool_)
    for begin, end in runs(beyond):
        found[begin:end] = steps[begin:end].sum() >= LONG_S
    return found


def _jumps(beyond: Mask, *turns: Array) -> Mask:
    """Return where an error is beyond its sigma since a jump of the reference; a truth has none."""
    is_theirs = np.zeros(len(beyond), dtype=np.bool_)
    for begin, end in runs(beyond) if turns else ():
        is_theirs[begin:end] = _jumped(begin, *turns)
    return is_theirs


def _jumped(row: int, mine: Array, theirs: Array) -> bool:
    """Return whether the reference's attitude jumped just before a row, and ours did not.

    A vehicle turns in one step much as in the step before; an estimate that is reset does not.
    """
    first, last = max(row - 2, 0), min(row + 1, len(mine))
    around = np.r_[max(first - 3, 0) : first, last : min(last + 3, len(mine))]
    if row == 0 or not len(around):
        return False
    usual = np.median(np.concatenate([mine[around], theirs[around]]), axis=0)
    ours, its = (np.linalg.norm((one[first:last] - usual).sum(axis=0)) for one in (mine, theirs))
    apart = np.linalg.norm((mine[first:last] - theirs[first:last]).sum(axis=0))
    return bool(its > 2.0 * ours and apart > 0.5 * YAW)


def _excess(
    report: Report, at_ns: Stamps, errors: Array, sigma: Array, is_beyond: Mask
) -> Excess | None:
    if not is_beyond.any():
        return None
    seconds = float(_steps(at_ns)[is_beyond].sum())
    worst = int(np.argmax(np.where(is_beyond, errors, -1.0)))
    at_s = report.track.seconds_of(int(at_ns[worst]))
    return Excess(seconds, float(errors[worst]), float(errors[worst] / sigma[worst]), at_s)


def _height(report: Report, ours: Trajectory, other: Trajectory) -> Height | None:
    if (found := difference.once_settled(ours, other)) is None:
        return None
    at_ns, errors = found
    is_known = np.isfinite(errors[:, 2])
    if not is_known.any():
        return None
    above = -errors[is_known, 2]
    mean = float(np.mean(above))
    sigma = difference.rms(report.track.sigmas_at(at_ns[is_known])[:, 2])
    return Height(mean, difference.rms(above - mean), sigma)
