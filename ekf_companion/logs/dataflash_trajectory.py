"""Trajectories in a DataFlash log: ArduPilot's estimate, the simulator's truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.dataflash_columns import names_of
from ekf_companion.logs.dataflash_flown import filters, setting_of_dcm
from ekf_companion.logs.dataflash_origin import geodetic
from ekf_companion.logs.dataflash_tables import Columns, rows_of
from ekf_companion.logs.stored_rows import Column
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.event_columns import EventColumns
from ekf_companion.nav.state import Trajectory

Position = dict[str, npt.NDArray[Any]]
"""The position fields of a trajectory, or those of the velocity too."""


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
    """Return the autopilot's own estimate: the one that it flew on, as far as it is logged.

    An origin that the log does not hold is fitted to the fixes.
    """
    found = next((one for one in filters(tables) if rows_of(tables, one[0]) is not None), None)
    setting, att = setting_of_dcm(tables), rows_of(tables, "ATT")
    if att is not None and (setting or found is None):
        return _of_dcm(tables, att, found, fixes, notes)
    if found is None or (rows := rows_of(tables, found[0])) is None:
        return None
    parts, source = _motion(tables, rows, fixes, notes)
    later = series.ascending(rows[1])
    return Trajectory(
        name=f"{found[1]} ({found[0]}, position from {source})",
        **parts,
        att_t_ns=rows[1][later],
        q_nb=_attitude(rows[0][later]),
    )


def _of_dcm(
    tables: Columns,
    att: tuple[Column, Stamps],
    looks_on: tuple[str, str] | None,
    fixes: EventColumns | None,
    notes: list[str],
) -> Trajectory:
    """Return the attitude of ATT, with the position that belongs to it."""
    name, setting = "attitude and heading reference (ATT)", setting_of_dcm(tables)
    parts = _position(tables, "POS")
    if setting and looks_on is not None and (rows := rows_of(tables, looks_on[0])) is not None:
        name = f"DCM (ATT), for {setting}"
        if not parts:
            parts, source = _motion(tables, rows, fixes, notes, _position(tables, "AHR2"))
            name += f"; position and velocity are of {looks_on[1]}, which only looks on ({source})"
        notes.append(
            f"{setting}: the autopilot flew on DCM, whose attitude (ATT) the estimate is compared "
            f"with; {looks_on[1]} only looked on"
        )
    later = series.ascending(att[1])
    return Trajectory(
        name=name,
        **(parts or _position(tables, "AHR2")),
        att_t_ns=att[1][later],
        q_nb=_attitude(att[0][later]),
    )


def _motion(
    tables: Columns,
    rows: tuple[Column, Stamps],
    fixes: EventColumns | None,
    notes: list[str],
    other: Position | None = None,
) -> tuple[Position, str]:
    """Return position and velocity of a filter's rows, and the message of the position.

    ``other`` is the position of AHR2, where that is the filter's.
    """
    later = series.ascending(rows[1])
    table, t_ns = rows[0][later], rows[1][later]
    vel_n = series.stack(table, "VN", "VE", "VD")
    position, source = (other, "AHR2") if other else (_position(tables, "POS"), "POS")
    if not position:
        ned = series.stack(table, "PN", "PE", "PD")
        found = geodetic(tables, table, t_ns, ned, vel_n, fixes, notes)
        source = "nowhere" if found is None else "origin"
        if found is not None:
            is_known = np.isfinite(found[0])
            lat, lon, alt = (one[is_known] for one in found)
            position = {"pos_t_ns": t_ns[is_known], "lat": lat, "lon": lon, "alt": alt}
    return {**position, "vel_t_ns": t_ns, "vel_n": vel_n}, source


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
