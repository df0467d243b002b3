"""Why some numbers are what they are: magnetometers, and a yaw that was reset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pyulog import ULog

from benchmarks.cases import AUTOPILOT, HOVER, TRUTH, estimate
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.errors import LogError
from ekf_companion.nav import so3
from ekf_companion.nav.magnetic import magnetic_field
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Table, Trajectory
from ekf_companion.replay import log_source

Array = npt.NDArray[np.float64]

YEAR = 2026.0
"""For the World Magnetic Model, as the configuration's default."""
EITHER_SIDE = 0.15
"""s; a reset is looked at from so long before to so long after it."""


def magnetometers(data: Path) -> Iterator[str]:
    """Give each log's field beside the World Magnetic Model's, and how much of it was believed."""
    yield "| log | strength, G | model, G | dip, deg | model, deg | headings taken |"
    yield "|---|---|---|---|---|---|"
    for log in dict.fromkeys(case.log for case in (*AUTOPILOT, *TRUTH)):
        path = data / log
        if path.is_file() and path.suffix != ".tlog":
            yield _field(path)


def _field(path: Path) -> str:
    events = log_source.READERS[path.suffix](path).events
    table = estimate(path)[0]
    fixes, samples = (events.take(events.kind == kind) for kind in (Kind.GNSS, Kind.MAG))
    lat, lon = np.median(fixes.values[:, :2], axis=0)
    _, dip, strength = magnetic_field(float(lat), float(lon), YEAR)
    mag_n = so3.rotate(_attitude(table, samples.t_ns), samples.values[:, :3])
    known = np.isfinite(mag_n).all(axis=1)
    dips = np.degrees(np.arctan2(mag_n[:, 2], np.hypot(mag_n[:, 0], mag_n[:, 1])))[known]
    strengths = np.linalg.norm(samples.values[:, :3], axis=1)
    return (
        f"| {path.parent.name} | {np.median(strengths):.2f} ({strengths.min():.2f} to"
        f" {strengths.max():.2f}) | {strength:.2f} | {np.median(dips):.0f} ({dips.min():.0f} to"
        f" {dips.max():.0f}) | {np.degrees(dip):.0f} | {_taken(path)} of {len(samples)} |"
    )


def _taken(path: Path) -> int:
    """Give how many magnetometer headings are used where no other may be."""
    try:
        health = estimate(path, "magnetometer")[1].health
    except LogError:  # not one of them, so there was no start
        return 0
    return health.verdicts[Aid.HEADING][Verdict.FUSED] if health else 0


def _attitude(table: Table, t_ns: npt.NDArray[np.int64]) -> Array:
    """Give the estimated attitude at or before each stamp, shape (n, 4)."""
    q_nb = np.column_stack([table.column(f"q_{axis}") for axis in "wxyz"])
    return np.asarray(q_nb[np.maximum(np.searchsorted(table.stamp_ns, t_ns, "right") - 1, 0)])


def yaw_resets(data: Path) -> Iterator[str]:
    """Give what the reference's yaw, its gyro and our yaw did over each of its resets."""
    path = data / HOVER
    if not path.is_file():
        return
    log = ULog(str(path))
    topics = {one.name: one.data for one in log.data_list if one.multi_id == 0}
    position = topics["vehicle_local_position"]
    counter = position["heading_reset_counter"].astype(int)
    table, _, reference, _ = estimate(path)
    assert reference is not None, "the log holds its own estimate"
    begin = int(topics["sensor_combined"]["timestamp"][0])
    t = (reference.att_t_ns * 1e-3 - begin) * 1e-6
    yaw = np.unwrap(so3.to_euler(reference.q_nb)[:, 2])
    ours_t, ours = (table.stamp_ns * 1e-3 - begin) * 1e-6, table.column("yaw")
    known = np.isfinite(ours)
    gyro_t, turned = _gyro_yaw(topics["sensor_combined"], reference, begin)

    series = ((t, yaw), (gyro_t, turned), (ours_t[known], np.unwrap(ours[known])))
    resets = [
        (float(position["timestamp"][i] - begin) * 1e-6, float(position["delta_heading"][i]))
        for i in np.flatnonzero(np.diff(counter)) + 1
    ]
    yield "| from, s | to, s | reset that PX4 logged, deg | EKF2 yaw, deg | gyro, deg | ours, deg |"
    yield "|---|---|---|---|---|---|"
    spans = [(_jump(t, yaw, at) - EITHER_SIDE, delta) for at, delta in resets]
    rows = [(at, at + 2.0 * EITHER_SIDE, delta) for at, delta in spans]
    if len(rows) > 1:
        rows += [(rows[-2][1], rows[-1][0], 0.0), (rows[-2][0], rows[-1][1], 0.0)]
    for start, end, delta in rows:
        turns = [np.interp(end, *one) - np.interp(start, *one) for one in series]
        cells = " | ".join(f"{np.degrees(turn):+.1f}" for turn in turns)
        logged = f"{np.degrees(delta):+.1f}" if delta else "-"
        yield f"| {start:.2f} | {end:.2f} | {logged} | {cells} |"


def _jump(t: npt.NDArray[Any], yaw: npt.NDArray[Any], near: float) -> float:
    """Give the middle of the largest step of the yaw within half a second of a time."""
    rows = np.flatnonzero(np.abs(t - near) < 0.5)
    largest = rows[np.argmax(np.abs(np.diff(yaw[rows])))]
    return float(t[largest] + t[largest + 1]) / 2.0


def _gyro_yaw(sensor: dict[str, Array], reference: Trajectory, begin: int) -> tuple[Array, Array]:
    """Integrate the gyro's rate about down, less its mean over the first eight seconds at rest."""
    t = (sensor["timestamp"].astype(float) - begin) * 1e-6
    roll, pitch = (
        np.interp(t, (reference.att_t_ns * 1e-3 - begin) * 1e-6, angle)
        for angle in so3.to_euler(reference.q_nb)[:, :2].T
    )
    right, down = sensor["gyro_rad[1]"].astype(float), sensor["gyro_rad[2]"].astype(float)
    rate = (right * np.sin(roll) + down * np.cos(roll)) / np.cos(pitch)
    rate -= rate[t < 8.0].mean()
    return t, np.concatenate(([0.0], np.cumsum(rate[1:] * np.diff(t))))
