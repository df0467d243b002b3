"""Trajectories in a DataFlash log: ArduPilot's estimate, the simulator's truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_columns import names_of
from ekf_companion.logs.dataflash_tables import Columns, rows_of
from ekf_companion.logs.stored_rows import Column
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.event_columns import EventColumns
from ekf_companion.nav.interpolation import resample
from ekf_companion.nav.state import Trajectory

_EKFS = (("XKF1", "EKF3"), ("NKF1", "EKF2"), ("EKF1", "EKF1"))
Position = dict[str, npt.NDArray[Any]]
"""The position fields of a trajectory."""


def _attitude(table: Column) -> Array:
    """Return q_nb of the rows' quaternions or, where absent, of their angles in degrees."""
    if "Q1" in names_of(table):
        q_nb = series.stack(table, "Q1", "Q2", "Q3", "Q4")
        if np.all(np.abs(np.linalg.norm(q_nb, axis=1) - 1.0) < 0.1):
            return so3.normalise(q_nb)
    angles = (np.deg2rad(np.asarray(table[name], dtype=float)) for name in ("Roll", "Pitch", "Yaw"))
    return so3.from_euler(*angles)


def _position(tables: Columns, name: str) -> Position:
    """Return the positions in a message's rows; none of latitude 0 and longitude 0."""
    if (rows := rows_of(tables, name)) is None or "Lat" not in names_of(rows[0]):
        return {}
    table, t_ns = rows
    valid = ((table["Lat"] != 0) | (table["Lng"] != 0)) & series.ascending(t_ns)
    if not valid.any():
        return {}
    table = table[valid]
    lat, lon = np.deg2rad(table["Lat"]), so3.wrap(np.deg2rad(table["Lng"]))
    alt = np.asarray(table["Alt"], dtype=float)
    return {"pos_t_ns": t_ns[valid], "lat": lat, "lon": lon, "alt": alt}


def reference(tables: Columns, fixes: EventColumns | None, notes: list[str]) -> Trajectory | None:
    """Return the autopilot's own estimate: the newest generation of its filter that ran.

    An origin that the log does not hold is fitted to the fixes.
    """
    for name, words in _EKFS:
        if (rows := rows_of(tables, name)) is None:
            continue
        later = series.ascending(rows[1])
        table, t_ns = rows[0][later], rows[1][later]
        position, source = _position(tables, "POS"), "POS"
        if not position:
            position, source = _position_about_origin(tables, table, t_ns, fixes, notes), "origin"
        return Trajectory(
            name=f"{words} ({name}, position from {source if position else 'nowhere'})",
            **position,
            vel_t_ns=t_ns,
            vel_n=series.stack(table, "VN", "VE", "VD"),
            att_t_ns=t_ns,
            q_nb=_attitude(table),
        )
    if (rows := rows_of(tables, "ATT")) is None:
        return None
    later = series.ascending(rows[1])
    return Trajectory(
        name="attitude and heading reference (ATT)",
        **(_position(tables, "POS") or _position(tables, "AHR2")),
        att_t_ns=rows[1][later],
        q_nb=_attitude(rows[0][later]),
    )


def _position_about_origin(
    tables: Columns, table: Column, t_ns: Stamps, fixes: EventColumns | None, notes: list[str]
) -> Position:
    """Return positions from north, east, down of the filter's origin (ORGN, or fitted)."""
    ned = series.stack(table, "PN", "PE", "PD")
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
    if origin is None:
        return {}
    lat, lon, alt = origin.to_geodetic(ned)
    return {"pos_t_ns": t_ns, "lat": lat, "lon": lon, "alt": alt}


def _fitted_origin(fixes: EventColumns | None, ned: Array, t_ns: Stamps) -> LocalFrame | None:
    """Return the origin that places the filter's positions on the fixes, by the median."""
    if fixes is None or len(t_ns) < 2:
        return None
    lat, lon, alt = fixes.columns[:3]
    frame = LocalFrame(float(lat[0]), float(lon[0]), float(alt[0]))
    both = (fixes.t_ns >= t_ns[0]) & (fixes.t_ns <= t_ns[-1])
    if not both.any():
        return None
    mine = resample(fixes.t_ns[both], t_ns, ned)
    fixed = frame.to_ned(lat[both], lon[both], alt[both])
    lat0, lon0, alt0 = frame.to_geodetic(np.median(fixed - mine, axis=0))
    return LocalFrame(float(lat0), float(lon0), float(alt0))


def truth(tables: Columns) -> Trajectory | None:
    """Return the simulator's truth: SIM (position, attitude) and SIM2 (velocity)."""
    parts = _position(tables, "SIM")
    if not parts or (rows := rows_of(tables, "SIM")) is None:
        return None
    later = series.ascending(rows[1])
    if (fast := rows_of(tables, "SIM2")) is not None:
        keep = series.ascending(fast[1])
        parts |= {"vel_t_ns": fast[1][keep], "vel_n": series.stack(fast[0][keep], "VN", "VE", "VD")}
    return Trajectory(
        name="simulator (SIM, SIM2)",
        **parts,
        att_t_ns=rows[1][later],
        q_nb=_attitude(rows[0][later]),
    )
