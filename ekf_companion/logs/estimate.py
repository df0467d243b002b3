"""Reading of estimates and truths from CSV files into trajectories.

The positions of a simulation over the flat Earth of the seed article are read as they are, though
by their velocities they are 0.26 percent long north and 0.20 percent short east: degrees of an
ellipsoid were turned into metres of a sphere.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.logs import clock_run, series
from ekf_companion.logs.source import head_of, header_of, suffix_of
from ekf_companion.logs.table import Table
from ekf_companion.logs.ulog_writer import SYSTEM
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.earth import SIMULATED
from ekf_companion.nav.state import COLUMNS, EULER, GEODETIC, QUATERNION, VELOCITY, Trajectory
from ekf_companion.nav.state import Table as EstimateTable

_NEEDED = ("time_us", *GEODETIC, *VELOCITY, *QUATERNION)
_UNITS = {"deg": np.pi / 180.0, "rad": 1.0}
_SIMULATED = ("time_s", "north_m", "east_m", "h_msl_m", "vn_mps", "ve_mps", "vd_mps")


def to_trajectory(columns: Mapping[str, npt.NDArray[Any]], name: str = "estimate") -> Trajectory:
    """Return our estimate's columns (names of ``nav.state.COLUMNS``) as a trajectory.

    Rows before the alignment (not finite) are left out; where the clock restarted, the longest
    run counts.
    """
    t_ns = np.asarray(columns["time_us"]).astype(np.int64) * 1000
    kept = clock_run.of_stamps(t_ns)[0]
    kept[kept] = series.ascending(t_ns[kept])

    def part(names: Sequence[str]) -> tuple[Stamps, Array]:
        values = series.stack(columns, *names)
        known = kept & known_rows(values)
        return t_ns[known], values[known]

    pos_t_ns, position = part(GEODETIC)
    vel_t_ns, vel_n = part(VELOCITY)
    att_t_ns, q_nb = part(QUATERNION)
    largest = np.abs(q_nb).max(axis=1)
    turned = (largest > 0.4) & (largest < 1.1)  # all zeros: not aligned yet
    return Trajectory(
        name=name,
        pos_t_ns=pos_t_ns,
        lat=np.deg2rad(position[:, 0]),
        lon=so3.wrap(np.deg2rad(position[:, 1])),
        alt=position[:, 2],
        vel_t_ns=vel_t_ns,
        vel_n=vel_n,
        att_t_ns=att_t_ns[turned],
        q_nb=so3.normalise(q_nb[turned]),
    )


def of_table(table: EstimateTable, name: str) -> Trajectory:
    """Return a table of estimates as a trajectory, as :func:`to_trajectory` does."""
    columns: dict[str, npt.NDArray[Any]] = {"time_us": table.stamp_ns // 1000}
    return to_trajectory(columns | {column: table.column(column) for column in COLUMNS[1:]}, name)


def read_estimate(path: Path) -> Trajectory:
    """Read our estimate from a CSV file with the columns of ``nav.state.COLUMNS``.

    Raises:
        LogError: The file is missing, lacks a column, or holds what is no number.
    """
    return to_trajectory(_timed(path, Table(path).read(_NEEDED)), path.name)


def read_truth(path: Path) -> Trajectory:
    """Read a truth from a CSV file with these columns.

    ``time_us, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps`` and the attitude as ``q_w, q_x,
    q_y, q_z`` or as ``roll, pitch, yaw``, all three with ``_deg`` or ``_rad``; other columns are
    ignored. An estimate of ours is accepted as a truth too, and so is one over the
    flat Earth of a simulation.

    Raises:
        LogError: The file is missing, lacks a column, or holds what is no number.
    """
    table = Table(path)
    if (simulated := _simulated(table)) is not None:
        return to_trajectory(_timed(path, simulated), path.name)
    own = dict(zip(VELOCITY, ("vn_mps", "ve_mps", "vd_mps"), strict=True))
    names = {name: own.get(name, name) if name not in table.names else name for name in _NEEDED}
    unit = None if set(QUATERNION) <= set(table.names) else _euler_unit(table)
    if unit is None:
        columns = _timed(path, table.read(list(names.values())))
        return to_trajectory({ours: columns[name] for ours, name in names.items()}, path.name)
    euler = [f"{name}_{unit}" for name in EULER]
    names = {ours: name for ours, name in names.items() if ours not in QUATERNION}
    columns = _timed(path, table.read([*names.values(), *euler]))
    found = {ours: columns[name] for ours, name in names.items()}
    q_nb = so3.from_euler(*(columns[name] * _UNITS[unit] for name in euler))
    return to_trajectory(found | dict(zip(QUATERNION, q_nb.T, strict=True)), path.name)


def _euler_unit(table: Table) -> str | None:
    """Return the unit of a table's roll, pitch and yaw; None if it does not have all three."""
    own = set(table.names)
    return next((unit for unit in _UNITS if {f"{name}_{unit}" for name in EULER} <= own), None)


def _simulated(table: Table) -> dict[str, npt.NDArray[Any]] | None:
    """Return a truth or an estimate over the flat Earth of a simulation, with our column names.

    Its columns are ``time_s, north_m, east_m, h_msl_m, vn_mps, ve_mps, vd_mps`` and
    ``roll, pitch, yaw``, all three with ``_deg`` or with ``_rad``; None if they are not there.
    """
    unit = _euler_unit(table)
    if unit is None or not set(_SIMULATED) <= set(table.names):
        return None
    euler = [f"{name}_{unit}" for name in EULER]
    read = table.read([*_SIMULATED, *euler])
    pos_n = np.stack([read["north_m"], read["east_m"], -read["h_msl_m"]], axis=1)
    lat, lon, alt = SIMULATED.to_geodetic(pos_n)
    q_nb = so3.from_euler(*(read[name] * _UNITS[unit] for name in euler))
    return {
        "time_us": np.rint(read["time_s"] * 1e6),
        "lat_deg": np.degrees(lat),
        "lon_deg": np.degrees(lon),
        "alt_m": alt,
        **{f"vel_{axis}": read[f"v{axis}_mps"] for axis in "ned"},
        **dict(zip(QUATERNION, q_nb.T, strict=True)),
    }


def _timed(path: Path, columns: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Return the rows that have a time."""
    time_us = columns["time_us"]
    timed = np.abs(time_us) < 2**62 / 1000
    if not timed.any():
        raise LogError(f"{path}: no row with a time; the file ends after its header")
    return {name: column[timed] for name, column in columns.items()}


OWN = "an estimate that convert wrote"
"""Note on a file that :func:`is_estimate` or :func:`is_written` recognises."""
_HEAD = 1 << 23
"""Bytes of a .tlog that are looked at: minutes of a flight."""
_FEW = 5
"""Seconds of an estimate without a heartbeat; a daemon sends one each second."""


def is_estimate(path: Path) -> bool:
    """Return whether a file is an estimate of ours, by its header."""
    if suffix_of(path) != ".csv":
        return False
    return header_of(path) in (COLUMNS, COLUMNS[:-1])  # the last came later


def is_written(path: Path) -> bool:
    """Return whether ``convert`` wrote a file, by its beginning.

    A .tlog may hold the log that it was made from too: then only its estimate has no heartbeat.
    """
    suffix = suffix_of(path)
    if suffix == ".ulg":
        return SYSTEM in head_of(path, 1 << 12)
    return is_estimate(path) if suffix != ".tlog" else _has_silent_estimate(head_of(path, _HEAD))


def _has_silent_estimate(head: bytes) -> bool:
    """Return whether a sender of a .tlog sends the state of an estimate and never a heartbeat."""
    states = Counter(_senders("ESTIMATOR_STATUS", head))
    sent = {sender for sender, count in states.items() if count >= _FEW}
    return bool(sent.difference(_senders("HEARTBEAT", head)))


def _senders(name: str, head: bytes) -> list[bytes]:
    """Return system and component of each frame of MAVLink 2 with a message."""
    from ekf_companion.mavlink.messages import IDS  # a log of columns needs no MAVLink

    message = re.escape(IDS[name].to_bytes(3, "little"))
    return re.findall(rb"(?s)\xfd....(..)" + message, head)
