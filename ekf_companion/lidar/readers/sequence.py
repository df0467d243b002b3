"""A folder of lidar.npz, imu.npz and calib.json: the layout that the simulator writes."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.source import Source, Stored, StoredInertial, StoredScan, whole
from ekf_companion.lidar.recording import Mounting


def open_sequence(path: Path) -> Source:
    """Open a folder with lidar.npz, imu.npz and, where there is one, calib.json.

    Raises:
        LogError: A file is missing or damaged, or an array has the wrong shape.
    """
    imu = load(path / "imu.npz", ("stamp", "gyro", "accel"))
    try:
        inertial = StoredInertial(
            np.asarray(imu["stamp"], np.float64).reshape(-1),
            whole(imu["gyro"], 3),
            whole(imu["accel"], 3),
        )
        if not len(inertial.stamp) == len(inertial.gyro) == len(inertial.accel):
            raise ValueError("stamp, gyro and accel have different lengths")
    except ValueError as error:
        raise LogError(f"{path / 'imu.npz'}: {error}") from None
    lidar = load(path / "lidar.npz", ("stamp", "first", "xyz"))
    first, count = lidar["first"], len(lidar["xyz"])
    if len(first) != len(lidar["stamp"]) + 1 or np.any(np.diff(first) < 0) or first[-1] > count:
        raise LogError(
            f"{path / 'lidar.npz'}: first must be {len(lidar['stamp']) + 1} rising numbers up to "
            f"{count}: scan k has the points first[k] to first[k + 1]"
        )
    for name in ("dt", "ring", "doppler"):
        if len(lidar.get(name, lidar["xyz"])) != count:
            raise LogError(
                f"{path / 'lidar.npz'}: {name} has {len(lidar[name])} numbers for {count} points"
            )
    return Source(
        name=path.name,
        scans=lambda: _scans(path),
        inertial=inertial,
        mounting=read_calib(path / "calib.json"),
        time_field="dt",
        inertial_name="imu.npz",
    )


def _scans(path: Path) -> Iterator[StoredScan]:
    arrays = load(path / "lidar.npz", ("stamp", "first", "xyz"))
    unit, tick = float(arrays.get("unit", 1.0)), float(arrays.get("tick", 1.0))
    first, dt, ring = arrays["first"], arrays.get("dt"), arrays.get("ring")
    doppler = arrays.get("doppler")
    for k, stamp in enumerate(arrays["stamp"]):
        part = slice(first[k], first[k + 1])
        yield StoredScan(
            float(stamp),
            arrays["xyz"][part] * unit,
            None if dt is None else dt[part] * tick,
            None if ring is None else ring[part],
            doppler=None if doppler is None else doppler[part],
        )


def load(path: Path, needed: tuple[str, ...]) -> dict[str, Stored]:
    """Return the arrays of an .npz file.

    Raises:
        LogError: It is missing or damaged, or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; the scans are useless without it") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise LogError(f"{path}: damaged: {error}") from None
    missing = [name for name in needed if name not in arrays]
    if missing:
        raise LogError(f"{path}: has no array {', '.join(missing)}; found: {', '.join(arrays)}")
    return arrays


def read_calib(path: Path) -> Mounting | None:
    """Return the mounting of a calib.json, or None if there is no such file.

    Raises:
        LogError: It is no JSON, or has no rotation and position.
    """
    if not path.is_file():
        return None
    try:
        found: dict[str, Any] = json.loads(path.read_text())["T_imu_lidar"]
        rotation = np.array(found["R"], np.float64).reshape(3, 3)
        position = np.array(found["p"], np.float64).reshape(3)
        sigma = np.radians(float(found.get("sigma_rot_deg", 0.5)))
        mounting = Mounting(rotation, position, float(sigma), float(found.get("sigma_pos_m", 0.01)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LogError(
            f"{path}: T_imu_lidar must hold R (3 x 3) and p (3, m): {type(error).__name__} {error}"
        ) from None
    return proper(mounting, str(path))


def proper(mounting: Mounting, where: str) -> Mounting:
    """Return a mounting whose rotation is one.

    Raises:
        LogError: It is no rotation, or not finite.
    """
    turned = mounting.rotation @ mounting.rotation.T
    if not (
        np.allclose(turned, np.eye(3), atol=1e-3)  # printed with three digits
        and np.linalg.det(mounting.rotation) > 0
        and np.isfinite(mounting.position).all()
    ):
        raise LogError(f"{where}: the rotation of the lidar is no rotation (R R' = 1, det R = +1)")
    return mounting
