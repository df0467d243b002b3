"""Compare an estimate with the truth: errors, their ratio to sigma, and lies.

A lie is a time at which the status is "ok" while a quantity is off by more than 5 of its own sigmas
and by more than its floor. The sigma of a vector is the root of the sum of its axes' variances.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.truth import earth
from benchmarks.truth.earth import Array

FLOORS = {"pos_h": 2.0, "pos_d": 2.0, "vel": 0.5, "tilt": np.radians(2.0), "yaw": np.radians(5.0)}
"""Errors that are no lie, however small their sigma: m, m, m/s, rad, rad."""
SIGMAS = 5.0
SETTLED = 30.0
"""RMS and the share of "ok" count from here on, s."""
NEAR_US = 5000.0
"""An estimate counts for a truth within this time."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true state at given stamps."""

    stamp_us: Array
    lat: Array
    lon: Array
    alt: Array
    vel_n: Array
    C_nb: Array


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The estimates nearest to the stamps of a truth; NaN where there is none."""

    columns: Mapping[str, Array]
    status: npt.NDArray[np.str_]

    def stack(self, *names: str) -> Array:
        """Return columns side by side."""
        return np.stack([self.columns[name] for name in names], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The score of one estimate."""

    rms: dict[str, float]
    """From 30 s on, per quantity; NaN if there is no estimate."""
    worst: dict[str, float]
    """Largest error over sigma while "ok", per quantity."""
    nees_pos: float
    """Per degree of freedom, over "ok" rows, by the diagonal sigmas; 1 is consistent."""
    nees_vel: float
    lies: dict[str, float]
    """Seconds, per quantity."""
    lie: float
    """Seconds with any lie."""
    ok: float
    """Share of the time from 30 s on."""
    resets: int
    end: str
    """The last status."""


WORDS = ("status", "reasons")
"""Columns of an estimate that hold words."""


def read_estimate(path: Path, stamp_us: Array) -> Estimate:
    """Read the rows of a converted log that are nearest to given stamps.

    A clock that is set back comes by a stamp a second time: the later row counts, as in the truth.
    """
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    times = np.array([float(row[0]) for row in rows])
    order = np.argsort(times, kind="stable")
    after = np.clip(np.searchsorted(times[order], stamp_us, side="right"), 1, len(rows) - 1)
    left, right = order[after - 1], order[after]
    nearest = np.where(stamp_us - times[left] < times[right] - stamp_us, left, right)
    is_near = np.abs(times[nearest] - stamp_us) <= NEAR_US
    status_at = header.index("status")
    status = np.where(is_near, [rows[i][status_at] for i in nearest], "")
    columns = {}
    for column, name in enumerate(header):
        if name not in WORDS:
            cells = [rows[i][column] for i in nearest]
            column_values = np.array([float(cell) if cell else np.nan for cell in cells])
            columns[name] = np.where(is_near, column_values, np.nan)
    return Estimate(columns, status)


def judge(estimate: Estimate, truth: Truth) -> Verdict:
    """Score an estimate."""
    t = (truth.stamp_us - truth.stamp_us[0]) * 1e-6
    step = float(np.median(np.diff(t)))
    pos_n = position_error(estimate, truth)
    vel_n = estimate.stack("vel_n", "vel_e", "vel_d") - truth.vel_n
    tilt, yaw = attitude_error(estimate, truth)
    sd_pos = estimate.stack("sd_pos_n", "sd_pos_e", "sd_pos_d")
    sd_vel = estimate.stack("sd_vel_n", "sd_vel_e", "sd_vel_d")
    errors = {
        "pos_h": (_norm(pos_n[:, :2]), _norm(sd_pos[:, :2])),
        "pos_d": (np.abs(pos_n[:, 2]), sd_pos[:, 2]),
        "vel": (_norm(vel_n), _norm(sd_vel)),
        "tilt": (tilt, _norm(estimate.stack("sd_roll", "sd_pitch"))),
        "yaw": (yaw, estimate.columns["sd_yaw"]),
    }
    is_ok, is_late = estimate.status == "ok", t >= SETTLED
    rms, worst, lies, lied = {}, {}, {}, np.zeros(len(t), dtype=np.bool_)
    for name, (error, sigma) in errors.items():
        ratio = np.full(len(t), np.inf)  # "ok" without a number or a sigma is a lie too
        np.divide(error, sigma, out=ratio, where=np.isfinite(error) & (sigma > 0.0))
        is_lie = is_ok & (ratio > SIGMAS) & ~(error <= FLOORS[name])
        known = error[is_late & np.isfinite(error)]
        rms[name] = float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
        worst[name] = float(ratio[is_ok].max()) if is_ok.any() else np.nan
        lies[name] = float(is_lie.sum() * step)
        lied |= is_lie
    resets = estimate.columns["reset_count"]
    return Verdict(
        rms=rms,
        worst=worst,
        nees_pos=_nees(pos_n[is_ok], sd_pos[is_ok]),
        nees_vel=_nees(vel_n[is_ok], sd_vel[is_ok]),
        lies=lies,
        lie=float(lied.sum() * step),
        ok=float(np.mean(is_ok[is_late])) if is_late.any() else np.nan,
        resets=int(np.nanmax(resets)) if np.isfinite(resets).any() else 0,
        end=str(estimate.status[-1]),
    )


def position_error(estimate: Estimate, truth: Truth) -> Array:
    """Return estimated minus true positions, north, east, down, m."""
    lat, lon = np.radians(estimate.columns["lat_deg"]), np.radians(estimate.columns["lon_deg"])
    apart_e = earth.to_ecef(lat, lon, estimate.columns["alt_m"]) - earth.to_ecef(
        truth.lat, truth.lon, truth.alt
    )
    return np.asarray(np.einsum("nji,nj->ni", earth.to_dcm(truth.lat, truth.lon), apart_e))


def attitude_error(estimate: Estimate, truth: Truth) -> tuple[Array, Array]:
    """Return the angle between the verticals, and the vertical part of the rotation between, rad.

    Without a yaw there is no quaternion: roll and pitch still give the vertical.
    """
    down_b = truth.C_nb[:, 2, :]
    roll, pitch = estimate.columns["roll"], estimate.columns["pitch"]
    found_b = np.stack(
        [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=1
    )
    yaw = np.full(len(roll), np.nan)
    wxyz = estimate.stack("q_w", "q_x", "q_y", "q_z")
    is_known = np.isfinite(wxyz).all(axis=1)
    if is_known.any():
        C_nb = Rotation.from_quat(wxyz[is_known][:, [1, 2, 3, 0]]).as_matrix()
        between = C_nb @ np.swapaxes(truth.C_nb[is_known], 1, 2)
        yaw[is_known] = np.abs(Rotation.from_matrix(between).as_rotvec()[:, 2])
        found_b[is_known] = C_nb[:, 2, :]
    cross = np.linalg.norm(np.cross(found_b, down_b), axis=1)
    return np.arctan2(cross, np.sum(found_b * down_b, axis=1)), yaw


def _norm(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=1))


def _nees(error: Array, sigma: Array) -> float:
    return float(np.mean((error / sigma) ** 2)) if len(error) else np.nan
