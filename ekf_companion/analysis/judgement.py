"""The one judgement on a log that convert, report, view and batch print."""

from __future__ import annotations

import numpy as np

from ekf_companion.analysis import difference
from ekf_companion.nav.interpolation import between
from ekf_companion.nav.state import Trajectory
from ekf_companion.replay.report import Report
from ekf_companion.replay.track import Size
from ekf_companion.replay.verdict import Evidence, Judgement, judge

FEWEST_FIXES = 20
"""Fixes from which on the receiver is a witness."""


def judge_log(report: Report) -> Judgement:
    """Judge a conversion by the truth that its log holds, else by the other witnesses in it."""
    return judge(report, evidence_of(report))


def evidence_of(report: Report) -> Evidence:
    """Return how far the estimate is from what else knew the position."""
    ours = report.track.positions()
    return Evidence(
        sigma=report.track.sigma(),
        truth=_apart(report, ours, report.truth),
        autopilot=_apart(report, ours, report.own),
        to_fixes=_to_fixes(report, ours),
    )


def _apart(report: Report, ours: Trajectory, other: Trajectory | None) -> Size | None:
    """Return the horizontal distance from another, once ours has settled; None: not known."""
    if other is None or not len(ours.pos_t_ns) or not len(other.pos_t_ns):
        return None
    begin_ns = int(ours.pos_t_ns[0]) + difference.SETTLED_NS
    found = difference.in_position(ours, other, (begin_ns, int(ours.pos_t_ns[-1])))
    if found is None:
        return None
    at_ns, errors = found
    distances = np.hypot(errors[:, 0], errors[:, 1])
    is_known = np.isfinite(distances)
    return report.track.size_of(distances[is_known], at_ns[is_known]) if is_known.any() else None


def _to_fixes(report: Report, ours: Trajectory) -> tuple[float, float] | None:
    """Return RMS distances of both estimates from the same fixes, m; None: too few."""
    own = report.own
    if own is None or len(own.pos_t_ns) < 2 or len(ours.pos_t_ns) < 2:
        return None
    fixes = report.track.fixes(report.fix_delay)
    settled = fixes.pos_t_ns > ours.pos_t_ns[0] + difference.SETTLED_NS
    at_ns = fixes.pos_t_ns[settled]
    pairs = [between(one.pos_t_ns, at_ns) for one in (ours, own)]
    both = np.intersect1d(pairs[0].wanted, pairs[1].wanted)
    if len(both) < FEWEST_FIXES:
        return None
    frame = difference.frame_of(ours)
    there = frame.to_ned(fixes.lat, fixes.lon, fixes.alt)[settled][both]
    found = []
    for one, pair in zip((ours, own), pairs, strict=True):
        here = pair.values(frame.to_ned(one.lat, one.lon, one.alt))[np.isin(pair.wanted, both)]
        found.append(difference.rms(np.hypot(*(here - there)[:, :2].T)))
    return (found[0], found[1]) if np.isfinite(found).all() else None
