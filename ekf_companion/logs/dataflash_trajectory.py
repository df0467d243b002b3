"""What a DataFlash log tells of the motion: ArduPilot's estimate, the simulator's truth."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_records import Column, Columns
from ekf_companion.logs.dataflash_tables import names_of, rows_of
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import Trajectory

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_EKFS = (("XKF1", "EKF3"), ("NKF1", "EKF2"), ("EKF1", "EKF1"))


_NO_STAMPS: Stamps = np.zeros(0, dtype=np.int64)
_NONE: Array = np.zeros(0)


def _attitude(table: Column) -> Array:
    """Give q_nb of a row's quaternion or, where it has none, of its angles in degrees."""
    if "Q1" in names_of(table):
        q_nb = np.stack([table[name] for name in ("Q1", "Q2", "Q3", "Q4")], axis=1).astype(float)
        if np.all(np.abs(np.linalg.norm(q_nb, axis=1) - 1.0) < 0.1):
            return so3.normalise(q_nb)
    angles = (np.deg2rad(np.asarray(table[name], dtype=float)) for name in ("Roll", "Pitch", "Yaw"))
    return so3.from_euler(*angles)


def _position(tables: Columns, name: str) -> tuple[Stamps, Array, Array, Array] | None:
    """Give stamps, latitude, longitude (rad), altitude of rows that have them; (0, 0) is none."""
    if (rows := rows_of(tables, name)) is None or "Lat" not in names_of(rows[0]):
        return None
    table, t_ns = rows
    valid = ((table["Lat"] != 0) | (table["Lng"] != 0)) & series.ascending(t_ns)
    if not valid.any():
        return None
    table = table[valid]
    lat, lon = np.deg2rad(table["Lat"]), so3.wrap(np.deg2rad(table["Lng"]))
    return t_ns[valid], lat, lon, np.asarray(table["Alt"], dtype=float)


def reference(tables: Columns, fixes: Events | None, notes: list[str]) -> Trajectory | None:
    """Give the autopilot's own estimate: the newest generation of its filter that ran.

    Args:
        tables: The messages, of the first instance each.
        fixes: GNSS events, to find an origin that the log does not tell; None: there are none.
        notes: Grows by what the user should know.
    """
    for name, words in _EKFS:
        if (rows := rows_of(tables, name)) is None:
            continue
        later = series.ascending(rows[1])
        table, t_ns = rows[0][later], rows[1][later]
        position, source = _position(tables, "POS"), "POS"
        if position is None:
            position, source = _position_about_origin(tables, table, t_ns, fixes, notes), "origin"
        return Trajectory(
            name=f"{words} ({name}, position from {source if position else 'nowhere'})",
            pos_t_ns=position[0] if position else _NO_STAMPS,
            lat=position[1] if position else _NONE,
            lon=position[2] if position else _NONE,
            alt=position[3] if position else _NONE,
            vel_t_ns=t_ns,
            vel_n=np.stack([table[axis] for axis in ("VN", "VE", "VD")], axis=1).astype(float),
            att_t_ns=t_ns,
            q_nb=_attitude(table),
        )
    if (rows := rows_of(tables, "ATT")) is None:
        return None
    later = series.ascending(rows[1])
    position = _position(tables, "POS") or _position(tables, "AHR2")
    return Trajectory(
        name="attitude and heading reference (ATT)",
        pos_t_ns=position[0] if position else _NO_STAMPS,
        lat=position[1] if position else _NONE,
        lon=position[2] if position else _NONE,
        alt=position[3] if position else _NONE,
        vel_t_ns=_NO_STAMPS,
        vel_n=np.zeros((0, 3)),
        att_t_ns=rows[1][later],
        q_nb=_attitude(rows[0][later]),
    )


def _position_about_origin(
    tables: Columns, table: Column, t_ns: Stamps, fixes: Events | None, notes: list[str]
) -> tuple[Stamps, Array, Array, Array] | None:
    """Give positions from north, east, down about the filter's origin (ORGN, or fitted)."""
    ned = np.stack([table[axis] for axis in ("PN", "PE", "PD")], axis=1).astype(float)
    origin = None
    if "ORGN" in tables:
        rows = tables["ORGN"][tables["ORGN"]["Type"] == 0]  # 0: the filter's origin, 1: home
        if len(rows) and rows[-1]["Lat"] != 0:
            lat, lon = np.deg2rad(rows[-1]["Lat"]), np.deg2rad(rows[-1]["Lng"])
            origin = LocalFrame(float(lat), float(lon), float(rows[-1]["Alt"]))
    if origin is None and (origin := _fitted_origin(fixes, ned, t_ns)) is not None:
        notes.append(
            "the origin of the autopilot's filter is not in the log: it is fitted to the GNSS "
            "fixes, so a constant offset between the two is not seen"
        )
    return (t_ns, *origin.to_geodetic(ned)) if origin else None


def _fitted_origin(fixes: Events | None, ned: Array, t_ns: Stamps) -> LocalFrame | None:
    """Give the origin that puts the filter's positions on the fixes, by the median."""
    if fixes is None or len(t_ns) < 2:
        return None
    lat, lon, alt = fixes.values[:, 0], fixes.values[:, 1], fixes.values[:, 2]
    frame = LocalFrame(float(lat[0]), float(lon[0]), float(alt[0]))
    both = (fixes.t_ns >= t_ns[0]) & (fixes.t_ns <= t_ns[-1])
    if not both.any():
        return None
    seconds = (t_ns - t_ns[0]) * 1e-9
    at = (fixes.t_ns[both] - t_ns[0]) * 1e-9
    mine = np.stack([np.interp(at, seconds, ned[:, axis]) for axis in range(3)], axis=1)
    fixed = frame.to_ned(lat[both], lon[both], alt[both])
    lat0, lon0, alt0 = frame.to_geodetic(np.median(fixed - mine, axis=0))
    return LocalFrame(float(lat0), float(lon0), float(alt0))


def truth(tables: Columns) -> Trajectory | None:
    """Give the simulator's truth: SIM (position, attitude) and SIM2 (velocity)."""
    if (position := _position(tables, "SIM")) is None or (rows := rows_of(tables, "SIM")) is None:
        return None
    later = series.ascending(rows[1])
    velocity, vel_t_ns = np.zeros((0, 3)), _NO_STAMPS
    if (fast := rows_of(tables, "SIM2")) is not None:
        keep = series.ascending(fast[1])
        vel_t_ns = fast[1][keep]
        velocity = np.stack([fast[0][axis][keep] for axis in ("VN", "VE", "VD")], axis=1)
    return Trajectory(
        name="simulator (SIM, SIM2)",
        pos_t_ns=position[0],
        lat=position[1],
        lon=position[2],
        alt=position[3],
        vel_t_ns=vel_t_ns,
        vel_n=velocity.astype(float),
        att_t_ns=rows[1][later],
        q_nb=_attitude(rows[0][later]),
    )
