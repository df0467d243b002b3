"""A reviewed flight as the data of the page that the daemon shows live, with a slider over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain, pairwise, product
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from ekf_companion.analysis import gaps
from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.engine.health import REFUSALS, Aid, Verdict
from ekf_companion.nav import reason, so3
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.state import ACCEL_BIAS, GYRO_BIAS, SIGMA, Reason, Status, Table, Trajectory
from ekf_companion.replay.watched import Look
from ekf_companion.review.report import summary

MOMENTS = 6000
"""Most moments of the slider: a tenth of a second each in a flight of ten minutes."""
APART_S = 1.0
"""Time to the next row, s, beyond which a trajectory is not known."""
BEHIND_S = 1e-3
"""Time after the last value before a gap at which a NaN is inserted, s."""
_KINDS = {"good": "good", "poor": "bad"}
"""Colours of the grades; all others are ``wait``: warnings, not failures."""
_AXES = ("north", "east", "down")
Columns = dict[str, list[float]]


def to_json(review: FlightReview) -> bytes:
    """Return the page's data of a flight; NaN becomes null, which interrupts a line."""
    stamps, rows = np.unique(review.table.stamp_ns, return_index=True)
    moments = _moments(stamps, [review.ours, *review.others])
    zero_ns = int(stamps[0])
    judgement = review.judgement
    return msgspec.json.encode(
        {
            "name": review.name,
            "family": review.report.family,
            "kind": _KINDS.get(judgement.grade, "wait"),
            "verdict": judgement.sentence,
            "summary": summary(review.report),
            "t": _round((moments - zero_ns) * 1e-9, 3),
            "jumps": np.searchsorted(moments, np.asarray(review.jumps_ns, np.int64)).tolist(),
            "ours": _trajectory(review.ours, moments),
            "estimate": _estimate(
                review.table,
                rows[np.searchsorted(stamps, moments)],
                gaps.covers(stamps, moments),
            ),
            "others": [
                {"name": one.name, "columns": _trajectory(one, moments)} for one in review.others
            ],
            "innovations": _innovations(review, zero_ns),
            "looks": _looks(review, zero_ns),
            "events": _events(review, zero_ns),
        }
    )


def _moments(stamps: Stamps, trajectories: Sequence[Trajectory]) -> Stamps:
    """Return the moments of the slider: evenly spaced, and one in each gap, to interrupt lines."""
    even = np.linspace(stamps[0], stamps[-1], min(len(stamps), MOMENTS)).astype(np.int64)
    drawn = [(one.pos_t_ns, one.vel_t_ns, one.att_t_ns) for one in trajectories]
    missing = [gaps.middles(t_ns) for t_ns in (stamps, *chain.from_iterable(drawn))]
    moments: Stamps = np.unique(np.concatenate([even, *missing]))
    return np.asarray(moments[(moments >= stamps[0]) & (moments <= stamps[-1])])


def _round(values: npt.NDArray[np.floating[Any]], digits: int) -> list[float]:
    rounded: list[float] = np.round(values.astype(float), digits).tolist()
    return rounded


def _trajectory(one: Trajectory, at_ns: Stamps) -> Columns:
    """Return a trajectory at the moments, interpolated."""
    columns: Columns = {}
    if len(one.pos_t_ns):
        lat, lon, alt = _at(one.pos_t_ns, np.stack([one.lat, one.lon, one.alt], axis=1), at_ns).T
        columns |= {
            "lat_deg": _round(np.rad2deg(lat), 8),
            "lon_deg": _round(np.rad2deg(lon), 8),
            "alt_m": _round(alt, 2),
        }
    if len(one.vel_t_ns):
        velocity = _at(one.vel_t_ns, one.vel_n, at_ns)
        columns |= {f"v_{axis}": _round(velocity[:, i], 3) for i, axis in enumerate(_AXES)}
    if len(one.att_t_ns):
        # Quaternions of one hemisphere, so that the line between two is the short way
        signs = np.cumprod(np.where(np.sum(one.q_nb[1:] * one.q_nb[:-1], axis=1) < 0.0, -1.0, 1.0))
        q_nb = one.q_nb * np.concatenate([[1.0], signs])[:, None]
        euler = np.rad2deg(so3.to_euler(so3.normalise(_at(one.att_t_ns, q_nb, at_ns))))
        columns |= {
            "roll_deg": _round(euler[:, 0], 2),
            "pitch_deg": _round(euler[:, 1], 2),
            "heading_deg": _round(euler[:, 2] % 360.0, 2),
        }
    return columns


def _at(t_ns: Stamps, values: Array, at_ns: Stamps) -> Array:
    """Interpolate rows, shape (n, m); NaN in gaps, and where no row is near."""
    after = np.clip(np.searchsorted(t_ns, at_ns), 0, len(t_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(t_ns[after] - at_ns), np.abs(at_ns - t_ns[before]))
    seconds = (t_ns - t_ns[0]) * 1e-9
    wanted = (at_ns - t_ns[0]) * 1e-9
    found = np.stack([np.interp(wanted, seconds, column) for column in values.T], axis=1)
    found[(nearest > APART_S * 1e9) | gaps.covers(t_ns, at_ns)] = np.nan
    return found


def _estimate(
    table: Table, rows: npt.NDArray[np.integer[Any]], is_missing: Mask
) -> dict[str, list[Any]]:
    """Return status, biases and sigmas at the moments, some of which lie in gaps."""
    degrees = float(np.rad2deg(1.0))
    statuses = zip(table.column("status")[rows], is_missing, strict=True)
    columns: dict[str, list[Any]] = {
        "status": [
            "no_samples" if gap else Status(int(one)).name.lower() if np.isfinite(one) else "init"
            for one, gap in statuses
        ]
    }

    def add(names: Sequence[str], digits: int, scale: float = 1.0) -> None:
        for name in names:
            values = np.where(is_missing, np.nan, table.column(name)[rows] * scale)
            columns[name] = _round(values, digits)

    add(GYRO_BIAS, 4, degrees)
    add(ACCEL_BIAS, 4)
    add(SIGMA[:6], 3)
    add(SIGMA[6:], 3, degrees)
    return columns


def _innovations(review: FlightReview, zero_ns: int) -> dict[str, Any] | None:
    """Return fixes less the estimate, with three sigmas, by quantity and axis."""
    found = review.innovations
    if found is None:
        return None
    rows, is_end = gaps.thinned(found.t_ns, MOMENTS)
    seconds = (found.t_ns[rows] - zero_ns) * 1e-9
    ends = np.flatnonzero(is_end) + 1
    values, bounds = (
        np.insert(one[rows], ends, np.nan, axis=0) for one in (found.values, found.bounds)
    )
    names = [f"{what} {axis}" for what in ("position", "velocity") for axis in _AXES]
    return {
        "t": _round(np.insert(seconds, ends, seconds[ends - 1] + BEHIND_S), 3),
        "values": {name: _round(values[:, i], 3) for i, name in enumerate(names)},
        "bounds": {name: _round(bounds[:, i], 3) for i, name in enumerate(names)},
    }


def _looks(review: FlightReview, zero_ns: int) -> dict[str, Any]:
    looks = [look for look in review.looks if look.t_ns >= zero_ns]
    seconds = [(look.t_ns - zero_ns) * 1e-9 for look in looks]
    shown: list[Look | None] = [*looks]
    # One comes in each second with a sample
    silent = np.diff(np.array([look.t_ns for look in looks], np.int64)) > gaps.GAP_NS
    for at in (np.flatnonzero(silent) + 1)[::-1].tolist():
        shown.insert(at, None)
        seconds.insert(at, seconds[at - 1] + BEHIND_S)

    def counts(of: Callable[[Look, Aid], float], aid: Aid) -> list[float | None]:
        return [None if look is None else of(look, aid) for look in shown]

    def refused(why: Verdict) -> Callable[[Look, Aid], float]:
        return lambda look, aid: look.refused[aid, why]

    return {
        "t": seconds,
        "nis": {
            aid.name.lower(): counts(lambda look, aid: float(look.nis[aid]), aid) for aid in Aid
        },
        "refused": {
            f"{aid.name.lower()} {why.name.lower()}": counts(refused(why), aid)
            for aid in Aid
            for why in REFUSALS
            if any(look.refused[aid, why] for look in looks)
        },
        "fused": {aid.name.lower(): counts(lambda look, aid: look.fused[aid], aid) for aid in Aid},
    }


def _events(review: FlightReview, zero_ns: int) -> list[dict[str, Any]]:
    """Return resets, changes of the status and beginnings of refusals, in the order of time."""
    events = [
        {"t": (look.t_ns - zero_ns) * 1e-9, "level": "warning", "text": f"Reset: {look.reset}"}
        for look in review.looks
        if look.reset and look.t_ns >= zero_ns
    ]
    status, stamps = review.table.column("status"), review.table.stamp_ns
    reasons = reason.foremost_of(review.table.column("reasons"))
    for row in (np.flatnonzero(np.diff(status)) + 1).tolist():
        now, before = (Status(int(status[at])) for at in (row, row - 1))
        level = "warning" if now > Status.OK else "info"
        text = f"Estimate is {now.name}, was {before.name}"
        if why := reasons[row]:
            text += f": {reason.WORDS[Reason(why)]}"
        events.append({"t": float(stamps[row] - zero_ns) * 1e-9, "level": level, "text": text})
    for aid, why in product(Aid, REFUSALS):
        for before_look, look in pairwise(review.looks):
            is_new = look.refused[aid, why] and not before_look.refused[aid, why]
            if is_new and look.t_ns >= zero_ns:
                text = f"Refused: {aid.name.lower()}, {why.name.lower()}"
                t = (look.t_ns - zero_ns) * 1e-9
                events.append({"t": t, "level": "warning", "text": text})
    return sorted(events, key=lambda event: float(event["t"]))
