"""An estimate, or a truth, that was written as CSV, as a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.logs import series
from ekf_companion.logs.csv_simulated import read_simulated
from ekf_companion.logs.table import Table
from ekf_companion.nav import so3
from ekf_companion.nav.state import COLUMNS, Trajectory
from ekf_companion.nav.state import Table as EstimateTable

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

_NEEDED = [name for name in COLUMNS[: COLUMNS.index("roll")] if not name.startswith("pos_")]
"""Time, position, velocity and attitude."""


def to_trajectory(columns: Mapping[str, npt.NDArray[Any]], name: str = "estimate") -> Trajectory:
    """Give our estimate's columns (names of ``nav.state.COLUMNS``) as a trajectory.

    Rows before the alignment (not finite) are left out; where time begins anew, the longest
    stretch is given.
    """
    t_ns = np.asarray(columns["time_us"]).astype(np.int64) * 1000
    kept = series.course(t_ns)[0]
    kept[kept] = series.ascending(t_ns[kept])

    def part(names: str) -> tuple[Stamps, Array]:
        values = np.stack([np.asarray(columns[one], dtype=float) for one in names.split()], axis=1)
        known = kept & np.isfinite(values).all(axis=1)
        return t_ns[known], values[known]

    pos_t_ns, position = part("lat_deg lon_deg alt_m")
    vel_t_ns, vel_n = part("vel_n vel_e vel_d")
    att_t_ns, q_nb = part("q_w q_x q_y q_z")
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
    """Give a table of estimates as a trajectory, as :func:`to_trajectory` does."""
    columns: dict[str, npt.NDArray[Any]] = {"time_us": table.stamp_ns // 1000}
    return to_trajectory(columns | {column: table.column(column) for column in COLUMNS[1:]}, name)


def read_estimate(path: Path) -> Trajectory:
    """Read our estimate from a CSV file with the columns of ``nav.state.COLUMNS``.

    Raises:
        LogError: The file is missing, lacks a column, or holds what is no number.
    """
    table = Table(path)
    return to_trajectory(_read(path, table, _NEEDED), path.name)


def read_truth(path: Path) -> Trajectory:
    """Read a truth from a CSV file: position, velocity and attitude by these names.

    ``time_us, lat_deg, lon_deg, alt_m, vn_mps, ve_mps, vd_mps`` and ``q_w, q_x, q_y, q_z``, other
    columns as may be. An estimate of ours is read too, as someone's truth, and a truth over the
    flat Earth of a simulation (:func:`ekf_companion.logs.csv_simulated.read_simulated`).

    Raises:
        LogError: The file is missing, lacks a column, or holds what is no number.
    """
    table = Table(path)
    if (simulated := read_simulated(table)) is not None:
        return to_trajectory(_timed(path, simulated), path.name)
    own = {"vel_n": "vn_mps", "vel_e": "ve_mps", "vel_d": "vd_mps"}
    names = {name: own.get(name, name) if name not in table.names else name for name in _NEEDED}
    columns = _read(path, table, list(names.values()))
    return to_trajectory({ours: columns[name] for ours, name in names.items()}, path.name)


def _read(path: Path, table: Table, names: list[str]) -> dict[str, npt.NDArray[Any]]:
    return _timed(path, dict(table.read(names)))


def _timed(path: Path, columns: dict[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Give the rows that have a time."""
    time_us = columns["time_us"]
    timed = np.abs(time_us) < 2**62 / 1000
    if not timed.any():
        raise LogError(f"{path}: no row with a time; the file ends after its header")
    return {name: column[timed] for name, column in columns.items()}


def is_estimate(path: Path) -> bool:
    """Whether a file is an estimate that we wrote, by its header."""
    if path.suffix.lower() != ".csv":
        return False
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline().strip().split(",") == COLUMNS
    except OSError:
        return False
