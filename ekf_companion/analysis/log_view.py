"""A reviewed flight as the data of the page that the daemon shows live, with a slider over time."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.engine.health import REFUSALS, Aid
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import ACCEL_BIAS, GYRO_BIAS, SIGMA, Status, Table, Trajectory
from ekf_companion.replay.report import summary

MOMENTS = 6000
"""Of the slider, at most: a tenth of a second each in a flight of ten minutes."""
APART_S = 1.0
"""Farther from the next row, s, a trajectory is not known."""
_KINDS = {"good": "good", "poor": "bad"}
"""Colours of the grades; of the others ``wait``: they are doubts, no failures."""
_AXES = ("north", "east", "down")
Columns = dict[str, list[float]]


def to_json(review: FlightReview) -> bytes:
    """Return what the page shows of a flight; NaN becomes null."""
    stamps, rows = np.unique(review.table.stamp_ns, return_index=True)
    moments = np.linspace(stamps[0], stamps[-1], min(len(stamps), MOMENTS)).astype(np.int64)
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
            "ours": _trajectory(review.ours, moments),
            "estimate": _estimate(review.table, rows[np.searchsorted(stamps, moments)]),
            "others": [
                {"name": one.name, "columns": _trajectory(one, moments)} for one in review.others
            ],
            "innovations": _innovations(review, zero_ns),
            "looks": _looks(review, zero_ns),
            "events": _events(review, zero_ns),
        }
    )


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
    """Interpolate rows, shape (n, m); NaN where no row is near."""
    after = np.clip(np.searchsorted(t_ns, at_ns), 0, len(t_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(t_ns[after] - at_ns), np.abs(at_ns - t_ns[before]))
    seconds = (t_ns - t_ns[0]) * 1e-9
    wanted = (at_ns - t_ns[0]) * 1e-9
    found = np.stack([np.interp(wanted, seconds, column) for column in values.T], axis=1)
    found[nearest > APART_S * 1e9] = np.nan
    return found


def _estimate(table: Table, rows: npt.NDArray[np.integer[Any]]) -> dict[str, list[Any]]:
    """Return status, biases and sigmas at the moments."""
    degrees = float(np.rad2deg(1.0))
    columns: dict[str, list[Any]] = {
        "status": [
            Status(int(one)).name.lower() if np.isfinite(one) else "init"
            for one in table.column("status")[rows]
        ]
    }
    for name in GYRO_BIAS:
        columns[name] = _round(table.column(name)[rows] * degrees, 4)
    for name in ACCEL_BIAS:
        columns[name] = _round(table.column(name)[rows], 4)
    for name in SIGMA[:6]:
        columns[name] = _round(table.column(name)[rows], 3)
    for name in SIGMA[6:]:
        columns[name] = _round(table.column(name)[rows] * degrees, 3)
    return columns


def _innovations(review: FlightReview, zero_ns: int) -> dict[str, Any] | None:
    """Return fixes less the estimate, with three sigmas, by what and axis."""
    found = review.innovations
    if found is None:
        return None
    some = slice(None, None, -(-len(found.t_ns) // MOMENTS))
    names = [f"{what} {axis}" for what in ("position", "velocity") for axis in _AXES]
    return {
        "t": _round((found.t_ns[some] - zero_ns) * 1e-9, 3),
        "values": {name: _round(found.values[some, i], 3) for i, name in enumerate(names)},
        "bounds": {name: _round(found.bounds[some, i], 3) for i, name in enumerate(names)},
    }


def _looks(review: FlightReview, zero_ns: int) -> dict[str, Any]:
    looks = [look for look in review.looks if look.t_ns >= zero_ns]
    return {
        "t": [(look.t_ns - zero_ns) * 1e-9 for look in looks],
        "nis": {aid.name.lower(): [float(look.nis[aid]) for look in looks] for aid in Aid},
        "refused": {
            f"{aid.name.lower()} {why.name.lower()}": counts
            for aid in Aid
            for why in REFUSALS
            if any(counts := [look.refused[aid, why] for look in looks])
        },
        "fused": {aid.name.lower(): [look.fused[aid] for look in looks] for aid in Aid},
    }


def _events(review: FlightReview, zero_ns: int) -> list[dict[str, Any]]:
    """Return resets, changes of the status and refusals that begin, in the order of time."""
    events = [
        {"t": (look.t_ns - zero_ns) * 1e-9, "level": "warning", "text": f"Reset: {look.reset}"}
        for look in review.looks
        if look.reset and look.t_ns >= zero_ns
    ]
    status, stamps = review.table.column("status"), review.table.stamp_ns
    for row in (np.flatnonzero(np.diff(status)) + 1).tolist():
        now, before = (Status(int(status[at])) for at in (row, row - 1))
        level = "warning" if now > Status.OK else "info"
        text = f"Estimate is {now.name}, was {before.name}"
        events.append({"t": float(stamps[row] - zero_ns) * 1e-9, "level": level, "text": text})
    for aid, why in product(Aid, REFUSALS):
        for before_look, look in pairwise(review.looks):
            is_new = look.refused[aid, why] and not before_look.refused[aid, why]
            if is_new and look.t_ns >= zero_ns:
                text = f"Refused: {aid.name.lower()}, {why.name.lower()}"
                t = (look.t_ns - zero_ns) * 1e-9
                events.append({"t": t, "level": "warning", "text": text})
    return sorted(events, key=lambda event: float(event["t"]))
