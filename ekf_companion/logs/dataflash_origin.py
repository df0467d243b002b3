"""The origin that an ArduPilot filter's positions north, east, down count from."""

from __future__ import annotations

import numpy as np

from ekf_companion.logs.dataflash_records import OFFSET
from ekf_companion.logs.dataflash_tables import Columns
from ekf_companion.logs.recording import counted
from ekf_companion.logs.stored_rows import Column
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.event_columns import EventColumns
from ekf_companion.nav.interpolation import resample

AT_ORIGIN = 1.0
"""m. Where EKF1 takes a new origin it is there itself: of the first row after, the largest distance
seen is 0.1 m."""
LEAP = 1.0
"""Jump from one row to the next beyond the velocity, m: corrections move by decimetres."""
SILENCE = 2.0
"""Longest time between two rows, s, over which a velocity is integrated: longer, the log was
paused."""
FEWEST_FIXES = 10
"""Fewest fixes to which one of several origins is fitted: two seconds of a receiver at 5 Hz."""
_FITTED = ", so a constant offset between the two is not seen"


def geodetic(
    tables: Columns,
    table: Column,
    t_ns: Stamps,
    ned: Array,
    vel_n: Array,
    fixes: EventColumns | None,
    notes: list[str],
) -> tuple[Array, Array, Array] | None:
    """Return latitude, longitude (rad) and height (m) of positions about the filter's origin.

    Those are NaN of which no origin is known. None: no origin is.

    Args:
        tables: The log's, for the origins that it holds (ORGN).
        table: The filter's rows.
        t_ns: Their stamps.
        ned: Their positions north, east, down of the origin, m, shape (n, 3).
        vel_n: Their velocities, m/s, shape (n, 3).
        fixes: The receiver's, to which an origin that the log does not hold is fitted.
        notes: Receives a sentence where origins were fitted.
    """
    frames: list[LocalFrame | None] = [*_logged(tables)]
    if frames:
        places = tables["ORGN"][OFFSET][_is_origin(tables)]
        of_row = np.maximum(np.searchsorted(places, table[OFFSET], side="right") - 1, 0)
    else:
        begins = new_origins(t_ns, ned, vel_n)
        of_row = np.searchsorted(begins, np.arange(len(t_ns)), side="right")
        rows = [of_row == one for one in range(len(begins) + 1)]
        fewest = FEWEST_FIXES if len(rows) > 1 else 1
        frames = [_fitted(fixes, ned[one], t_ns[one], fewest) for one in rows]
        if not any(frames):
            return None
        if len(rows) == 1:
            words = "the origin of the autopilot's filter is not in the log: it is fitted"
        else:
            words = (
                f"the autopilot's filter took {counted(len(rows) - 1, 'new origin')}, as at each "
                "arming, not in the log: each part is fitted"
            )
        notes.append(f"{words} to the GNSS fixes{_FITTED}")
    found = np.full((3, len(t_ns)), np.nan)
    for number, frame in enumerate(frames):
        if frame is not None:
            found[:, of_row == number] = frame.to_geodetic(ned[of_row == number])
    lat, lon, alt = found
    return lat, lon, alt


def new_origins(t_ns: Stamps, ned: Array, vel_n: Array) -> Indices:
    """Return the rows at which positions begin to count from another origin.

    EKF1 takes one when the vehicle is armed. Its positions jump to it, or come back to it after a
    time that was not logged. A jump to elsewhere is a reset of the estimate about the same origin.
    """
    seconds = np.diff(t_ns) * 1e-9
    way = 0.5 * (vel_n[1:, :2] + vel_n[:-1, :2]) * seconds[:, None]
    leap = np.hypot(*(np.diff(ned[:, :2], axis=0) - way).T)
    is_there = np.hypot(*ned[1:, :2].T) < AT_ORIGIN
    return np.flatnonzero(is_there & ((seconds > SILENCE) | (leap > LEAP))) + 1


def _is_origin(tables: Columns) -> Mask:
    rows = tables["ORGN"]
    found: Mask = (rows["Type"] == 0) & (rows["Lat"] != 0)  # 0: the filter's origin, 1: home
    return found


def _logged(tables: Columns) -> list[LocalFrame]:
    """Return the filter's origins in the log, in their order."""
    if "ORGN" not in tables:
        return []
    return [
        LocalFrame(float(np.deg2rad(row["Lat"])), float(np.deg2rad(row["Lng"])), float(row["Alt"]))
        for row in tables["ORGN"][_is_origin(tables)]
    ]


def _fitted(fixes: EventColumns | None, ned: Array, t_ns: Stamps, fewest: int) -> LocalFrame | None:
    """Return the origin that places the filter's positions on the fixes, by the median."""
    if fixes is None or len(t_ns) < 2:
        return None
    lat, lon, alt = fixes.columns[:3]
    frame = LocalFrame(float(lat[0]), float(lon[0]), float(alt[0]))
    both = (fixes.t_ns >= t_ns[0]) & (fixes.t_ns <= t_ns[-1])
    if np.count_nonzero(both) < fewest:
        return None
    mine = resample(fixes.t_ns[both], t_ns, ned)
    fixed = frame.to_ned(lat[both], lon[both], alt[both])
    lat0, lon0, alt0 = frame.to_geodetic(np.median(fixed - mine, axis=0))
    return LocalFrame(float(lat0), float(lon0), float(alt0))
