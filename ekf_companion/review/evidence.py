"""The evidence on an estimate: how far it is from the truth, the autopilot's and the receiver's."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.nav.arrays import Array, median
from ekf_companion.nav.interpolation import between
from ekf_companion.nav.state import Trajectory
from ekf_companion.review import difference
from ekf_companion.review.departure import Departure
from ekf_companion.review.report import Report
from ekf_companion.review.track import Size
from ekf_companion.review.witness import departure_of

FEWEST_FIXES = 20
"""Fewest fixes by which two estimates are compared with the receiver."""
NEAR = 2.0
"""Horizontal difference from a truth, m RMS, up to which an estimate is right: a receiver alone has
1 to 2 m."""
CLEARLY = 1.5
"""Of two estimates the receiver agrees with the one that is that many times nearer to it."""
ELSEWHERE = 20.0
"""m from the fixes, in the median: a receiver is not so far from a truth for half a flight."""


class Evidence(NamedTuple):
    """What an estimate's horizontal position is judged by, as far as the log holds it."""

    sigma: Size | None = None
    """One sigma, by the estimate itself."""
    truth: Size | None = None
    """Distance from the truth."""
    autopilot: Size | None = None
    """Distance from the autopilot's own estimate."""
    to_fixes: tuple[float, float] | None = None
    """RMS distances of ours and of the autopilot's from the receiver's fixes, m."""

    truth_to_fixes: tuple[float, float] | None = None
    """Median distances of ours and of the truth from the receiver's fixes, m."""
    departure: Departure = Departure()
    """How far yaw, tilt and height are from the truth, else from the autopilot's."""

    @property
    def is_right(self) -> bool:
        """Whether the truth says that the flight is estimated right, whatever the filter doubts."""
        return self.truth is not None and self.truth.rms <= NEAR and self.departure.is_close

    @property
    def is_shared(self) -> bool:
        """Whether another estimate of the same flight, the autopilot's, says the same."""
        if self.truth is not None or self.autopilot is None:
            return False
        return self.autopilot.rms <= NEAR and self.departure.is_close

    @property
    def truth_elsewhere(self) -> str:
        """Ask for a truth that is far from the receiver's fixes, where ours is not; else empty."""
        ours, theirs = self.truth_to_fixes or (0.0, 0.0)
        if theirs < ELSEWHERE or theirs < CLEARLY * ours:
            return ""
        return (
            f"the truth is {metres(theirs)} from the receiver's fixes too (is it of this flight?)"
        )


def metres(size: float, digits: int = 0) -> str:
    """Return a distance, m, in words."""
    return f"{size:.{digits}f} m" if size < 1e5 else f"{size * 1e-3:.0f} km"


def take_truth(report: Report, truth: Trajectory | None) -> None:
    """Judge a conversion by a truth from a file beside the log; None: by the log's own.

    Raises:
        LogError: The truth has no time in common with the estimate.
    """
    if truth is None:
        return
    stretches = report.track.stretches
    stretch = stretches.found[stretches.longest]
    t_ns = truth.pos_t_ns
    if not len(t_ns) or t_ns[-1] < stretch.first_ns or t_ns[0] > stretch.last_ns:
        spans = [(stretch.first_ns, stretch.last_ns), *((t[0], t[-1]) for t in (t_ns,) if len(t))]
        here, *there = (f"{first * 1e-9:.1f} to {last * 1e-9:.1f} s" for first, last in spans)
        raise LogError(
            f"{truth.name}: has no time in common with the estimate of {report.log} "
            f"({''.join(there) or 'no position'}, and {here}); name the truth of this flight, its "
            "times on the autopilot's clock"
        )
    report.truth = truth
    ours = report.track.positions()
    if len(ours.pos_t_ns) and _apart(report, ours, truth) is None:
        seconds = difference.SETTLED_NS * 1e-9
        report.notes.append(
            f"{truth.name} has no time in common with the estimate after its first {seconds:.0f} s "
            "with a position, so the verdict is without it"
        )


def evidence_of(report: Report) -> Evidence:
    """Return how far the estimate is from other sources of the position."""
    ours = report.track.positions()
    return Evidence(
        sigma=report.track.sigma(),
        truth=_apart(report, ours, report.truth),
        autopilot=_apart(report, ours, report.own),
        to_fixes=_to_fixes(report, ours, report.own, difference.rms),
        truth_to_fixes=_to_fixes(report, ours, report.truth, _median),
        departure=departure_of(report, ours),
    )


def _apart(report: Report, ours: Trajectory, other: Trajectory | None) -> Size | None:
    """Return the horizontal distance from another, once ours has settled; None: not known."""
    if other is None or (found := difference.once_settled(ours, other)) is None:
        return None
    at_ns, errors = found
    distances = np.hypot(errors[:, 0], errors[:, 1])
    is_known = np.isfinite(distances)
    return report.track.size_of(distances[is_known], at_ns[is_known]) if is_known.any() else None


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return median(known) if len(known) else float("nan")


def _to_fixes(
    report: Report, ours: Trajectory, other: Trajectory | None, size: Callable[[Array], float]
) -> tuple[float, float] | None:
    """Return the distances of ours and of another from the same fixes, m; None: too few."""
    if other is None or len(other.pos_t_ns) < 2 or len(ours.pos_t_ns) < 2:
        return None
    fixes = report.track.fixes(report.fix_delay)
    settled = fixes.pos_t_ns > ours.pos_t_ns[0] + difference.SETTLED_NS
    at_ns = fixes.pos_t_ns[settled]
    pairs = [between(one.pos_t_ns, at_ns) for one in (ours, other)]
    both = np.intersect1d(pairs[0].wanted, pairs[1].wanted, assume_unique=True)
    if len(both) < FEWEST_FIXES:
        return None
    frame = difference.frame_of(ours)
    there = frame.to_ned(fixes.lat, fixes.lon, fixes.alt)[settled][both]
    found = []
    for one, pair in zip((ours, other), pairs, strict=True):
        here = pair.values(frame.to_ned(one.lat, one.lon, one.alt))[np.isin(pair.wanted, both)]
        found.append(size(np.hypot(*(here - there)[:, :2].T)))
    return (found[0], found[1]) if np.isfinite(found).all() else None
