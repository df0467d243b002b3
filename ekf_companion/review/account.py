"""What became of a trajectory from arrays, in sentences: no position, lost aids, resets, axes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.logs.recording import counted
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import GNSS_VELOCITY, Events, Kind
from ekf_companion.nav.reason import seconds_by_reason, to_words
from ekf_companion.nav.state import Reason, Status, Table

SLOWEST = 3.0
"""m/s above which a course is one."""
ALL_ROUND, STEADY = 0.7, 0.97
"""Mean resultant lengths: below, courses differ; above, the vehicle keeps an angle to its course.
Only what rolls, sails or has wings keeps one: a multicopter does while it flies straight."""
ASKEW = float(np.deg2rad(70.0))
"""Angle between heading and course that no crab in the wind has, rad."""
FEW, MOST = 0.05, 0.5
"""Shares of an aid's measurements that were refused: above the first it is a reason of what else
is said, above the second it is said in any case."""
LATE_NS = 3_000_000_000
"""Time without a position from the first fix on that a start at rest with a heading does not take,
ns."""
_LOOK = {
    "position": ("fixes", "look at lat_deg, lon_deg and std_h of gnss"),
    "height": ("heights", "look at alt and std_v of gnss"),
    "velocity": ("velocities", "look at vel_n and std_vel of gnss"),
    "heading": (
        "headings",
        "look at heading (rad from true north, clockwise) or mag (a field that is the Earth's)",
    ),
    **{
        one.name: ("measurements", one.advice[0].lower() + one.advice[1:].rstrip("."))
        for one in DECLARED
    },
}
_AFTER = {
    Status.DEAD_RECKONING: "no fix was used for more than a second, and the error grows",
    Status.INVALID: "its error is beyond the limit: do not use it",
}


def sentences(
    table: Table,
    events: Events,
    counts: Mapping[str, tuple[int, int]],
    *,
    has_position: bool = True,
) -> list[str]:
    """Return what one should know of estimates, by themselves and by what they were made of.

    ``counts`` are the numbers of fused and of refused measurements by aid. Without
    ``has_position`` they are of a filter that estimates no position from fixes.
    """
    status = table.column("status")
    found = []
    if has_position and not (status >= Status.OK).any():
        found.append(why_no_position(events))
    seconds = seconds_by_reason(table)
    for bad in (Status.DEGRADED, *_AFTER):
        if (rows := np.flatnonzero(status == bad)).size:
            first = table.stamp_ns[rows[0]] * 1e-9
            words = _AFTER.get(bad) or _why_degraded(seconds.get(bad, {}), counts)
            share = len(rows) / len(status)
            found.append(f"{share:.1%} of the time, first at {first:.1f} s, {bad.words}: {words}")
    said = " ".join(found)
    found += [one for one in refusals(counts, MOST) if one not in said]
    return [*found, *_resets(table), *_course(table)]


def refusals(counts: Mapping[str, tuple[int, int]], share: float) -> list[str]:
    """Return a clause for each aid of which more than a share of the measurements was refused."""
    found = []
    for aid, (fused, refused) in counts.items():
        if refused > share * (fused + refused):
            what, advice = _LOOK.get(aid, ("measurements", "look at its innovation and covariance"))
            found.append(f"{aid}: {refused} of {fused + refused} {what} refused ({advice})")
    return found


def _why_degraded(by_reason: Mapping[Reason, float], counts: Mapping[str, tuple[int, int]]) -> str:
    """Return why estimates are degraded: by their reasons, and by what was refused often."""
    return "; ".join(one for one in (to_words(by_reason), *refusals(counts, FEW)) if one)


def late_begin(table: Table, events: Events) -> list[str]:
    """Return a note on smoothed estimates that begin with a position long after the fixes do."""
    fixes, known = events.t_ns[events.kind == Kind.GNSS], table.column("status") >= Status.OK
    if not len(fixes) or not known.any():
        return []
    begin_ns = table.stamp_ns[np.argmax(known)]
    since = (begin_ns - table.stamp_ns[0]) * 1e-9
    if begin_ns - max(fixes[0], table.stamp_ns[0]) < LATE_NS:
        return []
    return [
        f"the first {since:.1f} s have no position: before {begin_ns * 1e-9:.1f} s no heading was "
        "known, and smoothing does not reach back to before it was; with mag or heading it is "
        "known sooner"
    ]


def why_no_position(events: Events) -> str:
    """Return why there is no position, and what would bring one."""
    fixes = events.take(events.kind == Kind.GNSS)
    if not len(fixes):
        return "no position: no fix was given; attitude is estimated, and height with a barometer"
    if len(fixes) == 1:
        return "no position: there is a single fix, and two are needed to begin; give more of them"
    if at_zero := int(np.count_nonzero(~fixes.values[:, :2].any(axis=1))):
        return (
            f"no position: {at_zero} of {len(fixes)} fixes are at latitude and longitude 0, which "
            "is written where there is no fix; look at lat_deg and lon_deg"
        )
    span = (fixes.t_ns[-1] - fixes.t_ns[0]) * 1e-9
    what = f"no position, from {len(fixes)} fixes in {span:.1f} s: "
    if np.isin(events.kind, (Kind.HEADING, Kind.MAG)).any():
        return what + (
            "no heading was accepted, as a field that is not the Earth's, or the vehicle was never "
            "at rest; look at mag and heading, or give vel_n and a flight with manoeuvres"
        )
    if np.isfinite(fixes.values[:, GNSS_VELOCITY][:, 0]).any():
        return what + (
            "north is not known, for no heading was given and no manoeuvre changed the velocity "
            "by more than 1 m/s; give mag or heading, or more of the flight"
        )
    return what + "north is not known; give mag or heading, or the velocity of the fixes (vel_n)"


def resets_of(table: Table) -> int:
    """Return how often an estimate was reset: two resets at one measurement are two."""
    return int(np.maximum(np.diff(table.column("reset_count")), 0.0).sum())


def _resets(table: Table) -> list[str]:
    rows = np.flatnonzero(np.diff(table.column("reset_count")) > 0.0) + 1
    if not len(rows):
        return []
    times = ", ".join(f"{one:.1f}" for one in table.stamp_ns[rows[:5]] * 1e-9)
    more = f" and {len(rows) - 5} more" if len(rows) > 5 else ""
    return [
        f"{counted(resets_of(table), 'reset')}, at {times} s{more}: the estimate jumped there, for "
        "samples were missing or the measurements contradicted it; look at the arrays around these "
        "times"
    ]


def _course(table: Table) -> list[str]:
    """Return a sentence if the vehicle goes sideways or backwards all along its turns."""
    north, east, yaw = (table.column(name) for name in ("vel_n", "vel_e", "yaw"))
    fast = (table.column("status") >= Status.OK) & (np.hypot(north, east) > SLOWEST)
    if np.count_nonzero(fast) < 500:
        return []
    course = np.arctan2(east[fast], north[fast])
    spread, _ = _resultant(course)
    length, angle = _resultant(course - yaw[fast])
    if spread > ALL_ROUND or length < STEADY or abs(angle) < ASKEW:
        return []
    return [
        f"the vehicle goes {np.rad2deg(angle):+.0f} deg from its x axis through all turns: if it "
        "has wings or wheels, x of gyro, accel and mag is not forward; turn them about z"
    ]


def _resultant(angles: Array) -> tuple[float, float]:
    """Return length and direction of the mean of unit vectors."""
    mean = complex(np.mean(np.exp(1j * angles)))
    return abs(mean), float(so3.wrap(np.angle(mean)))
