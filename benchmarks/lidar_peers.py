"""The table's rows for other programs' wheels, where they are installed: se3-lio and rko_lio.

Both run at their defaults, with the ranges and the mounting of ours, one thread, from rest, as both
take it. They are no dependency of this project: se3-lio is under the
GPL. ``pip install se3-lio pydantic rko_lio`` brings them.
"""

from __future__ import annotations

import importlib
import os
import time
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import Recording, Scan
from ekf_companion.lidar.sampling import within_range
from ekf_companion.lidar.settings import Settings
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

UPPER = np.triu_indices(6)
NS = 1_000_000_000

Step = Callable[[Scan, Array, Array, Array], tuple[Array, Array | None]]
"""Takes a scan, its points and times, and inertial samples; returns a pose and its covariance."""


def _mounting(recording: Recording) -> Array:
    """Return lidar to body, shape (4, 4)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = recording.mounting.rotation, recording.mounting.position
    return T


def _se3(recording: Recording, _: Settings) -> Step:
    """Return a step of se3-lio."""
    module = importlib.import_module("se3_lio")
    odometry = module.SE3LIO(module.SE3LIOConfig(), _mounting(recording))

    def step(scan: Scan, points: Array, times: Array, imu: Array) -> tuple[Array, Array | None]:
        state, _ = odometry.register_frame(points, times, imu, scan.stamp)
        P = np.asarray(state.covariance)[:6, :6]
        return np.asarray(state.pose), P

    return step


def _rko(recording: Recording, settings: Settings) -> Step:
    """Return a step of rko_lio."""
    module = importlib.import_module("rko_lio.lio")
    config = importlib.import_module("rko_lio.config").LIOConfig(
        initialization_phase=True, min_range=settings.least_range, max_range=settings.most_range
    )
    odometry, T = module.LIO(config), _mounting(recording)

    def step(scan: Scan, points: Array, times: Array, imu: Array) -> tuple[Array, Array | None]:
        for t, *force, x, y, z in imu.tolist():
            rate, body = np.array([x, y, z]), np.eye(4)
            odometry.add_imu_measurement(np.array(force), rate, round(t * NS), body)
        stamps = np.round((scan.stamp + times) * NS).astype(np.int64)
        odometry.register_scan(points, stamps, T)
        return odometry.pose(), None

    return step


PEERS: dict[str, Callable[[Recording, Settings], Step]] = {"se3-lio": _se3, "rko_lio": _rko}


def run(name: str, recording: Recording, settings: Settings) -> tuple[Array, Array | None, Array]:
    """Return rows of poses and of covariances as the scorer takes them, and ms of each scan.

    Raises:
        ImportError: It is not installed.
    """
    step = PEERS[name](recording, settings)
    inertial = recording.inertial
    samples = np.column_stack([inertial.stamp, inertial.accel, inertial.gyro])
    poses, covariances, spent, first = [], [], [], 0
    for scan in recording.scans:
        kept = within_range(scan.points, settings)
        points, times = scan.points[kept], scan.times[kept]
        order = np.argsort(times, kind="stable")
        points, times = points[order], times[order]
        end = scan.stamp + float(times[-1])
        last = int(np.searchsorted(inertial.stamp, end, side="right")) + 1
        begin = time.process_time()
        pose, P = step(scan, points, times, samples[first:last])
        spent.append(1e3 * (time.process_time() - begin))
        first = min(last, len(samples))
        w, x, y, z = so3.from_matrix(pose[:3, :3]).tolist()
        poses.append([end, *pose[:3, 3], x, y, z, w])
        if P is not None:
            covariances.append([end, *P[UPPER]])
    return np.array(poses), np.array(covariances) if covariances else None, np.array(spent)


def missing() -> Iterator[str]:
    """Yield a sentence for each that is not installed, and leave it out."""
    for name, module in (("se3-lio", "se3_lio"), ("rko_lio", "rko_lio.lio")):
        try:
            importlib.import_module(module)
        except ImportError as error:
            yield f"{name} is left out: {error}"
            del PEERS[name]


def run_apart(name: str, path: Path, settings: Settings) -> tuple[Array, Array | None, Array]:
    """Do :func:`run` on a recording in a process of its own, whose output is left out."""
    with get_context("spawn").Pool(1, _be_silent) as pool:
        return pool.apply(_run_path, (name, path, settings))


def _be_silent() -> None:
    """Leave out what compiled code prints."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _run_path(name: str, path: Path, settings: Settings) -> tuple[Array, Array | None, Array]:
    return run(name, read(path), settings)
