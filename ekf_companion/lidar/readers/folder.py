"""A folder of scans, one .pcd or .npz each and named by their stamps, with imu.csv beside them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.pcd import read_pcd
from ekf_companion.lidar.readers.point_cloud import Cloud, from_columns
from ekf_companion.lidar.readers.sequence import load, read_calib
from ekf_companion.lidar.readers.source import Source, StoredInertial, StoredScan
from ekf_companion.nav.arrays import Array

STAMPS = "stamps.csv"
_COLUMNS = (
    ("stamp", "timestamp", "time", "t"),
    *((f"gyro_{axis}", f"w{axis}", f"angular_velocity_{axis}") for axis in "xyz"),
    *((f"accel_{axis}", f"a{axis}", f"linear_acceleration_{axis}") for axis in "xyz"),
)
"""Names of the columns of imu.csv, each with what it is called elsewhere."""


def is_folder(path: Path) -> bool:
    """Return whether a folder has scans as files."""
    return path.is_dir() and next(_files(path), None) is not None


def open_folder(path: Path) -> Source:
    """Open a folder of scans.

    A scan is named by its stamp (`1700000000.123.pcd`, or nanoseconds), or stamps.csv has a line
    `name,stamp` for each. An .npz has xyz (n, 3) and, where known, time and ring (n,).

    Raises:
        LogError: imu.csv is missing or damaged, or a scan has no stamp.
    """
    inertial = read_inertial(path / "imu.csv")
    files, stamps = _stamped(path)
    first = _cloud(files[0])
    return Source(
        name=path.name,
        scans=lambda: _scans(files, stamps),
        inertial=inertial,
        mounting=read_calib(path / "calib.json"),
        time_field=first.time_field,
        inertial_name="imu.csv",
    )


def _files(path: Path) -> Iterator[Path]:
    places = [path, path / "scans", path / "lidar", path / "pcd"]
    for place in places:
        if place.is_dir():
            yield from (
                file
                for file in sorted(place.iterdir())
                if file.suffix.lower() in (".pcd", ".npz") and file.stem != "imu"
            )


def _stamped(path: Path) -> tuple[list[Path], list[float]]:
    """Return the files and their stamps, in the order of their names or of stamps.csv."""
    files = list(_files(path))
    table = path / STAMPS
    if not table.is_file():
        try:
            return files, [float(file.stem) for file in files]
        except ValueError:
            raise LogError(
                f"{path}: the scans are not named by their stamps ({files[0].name}), and there is "
                f"no {STAMPS} with a line `name,stamp` for each"
            ) from None
    known = {file.name: file for file in files}
    found, stamps = list[Path](), list[float]()
    for number, line in enumerate(table.read_text().splitlines(), 1):
        name, _, stamp = line.partition(",")
        if name.strip() in known:
            try:
                stamps.append(float(stamp))
            except ValueError:
                raise LogError(f"{table}: line {number}: {stamp!r} is no stamp") from None
            found.append(known[name.strip()])
    if not found:
        raise LogError(f"{table}: names none of the {len(files)} scans")
    return found, stamps


def _scans(files: list[Path], stamps: list[float]) -> Iterator[StoredScan]:
    for file, stamp in zip(files, stamps, strict=True):
        cloud = _cloud(file)
        yield StoredScan(stamp, cloud.points, cloud.times, cloud.ring, doppler=cloud.doppler)


def _cloud(file: Path) -> Cloud:
    if file.suffix.lower() == ".pcd":
        return read_pcd(file)
    arrays = load(file, ())
    xyz = arrays.pop("xyz", arrays.pop("points", None))
    try:
        if xyz is not None:
            arrays |= {name: np.asarray(xyz)[:, axis] for axis, name in enumerate("xyz")}
        columns = {name: value for name, value in arrays.items() if value.ndim == 1}
        if len({len(value) for value in columns.values()}) > 1:
            raise ValueError("its arrays have different lengths")
        return from_columns(columns)
    except (ValueError, IndexError) as error:
        raise LogError(f"{file}: no scan: {error}") from None


def read_inertial(path: Path) -> StoredInertial:
    """Return the samples of a table with a line of names: stamp, gyro_x .. accel_z.

    Raises:
        LogError: It is missing, or a column is, or a line holds no numbers.
    """
    try:
        lines = path.read_text().splitlines()
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; scans without inertial samples do not do") from None
    except (OSError, UnicodeDecodeError) as error:
        raise LogError(f"{path}: {error}") from None
    names = [name.strip().lstrip("#").strip().lower() for name in (lines or [""])[0].split(",")]
    places = []
    for known in _COLUMNS:
        place = next((names.index(name) for name in known if name in names), None)
        if place is None:
            raise LogError(f"{path}: no column {known[0]}; found: {', '.join(names)}")
        places.append(place)
    rows: Array = np.empty((len(lines) - 1, len(places)))
    for number, line in enumerate(lines[1:]):
        words = line.split(",")
        try:
            rows[number] = [float(words[place]) for place in places]
        except (ValueError, IndexError):
            rows[number] = np.nan  # counted as not finite
    return StoredInertial(rows[:, 0], rows[:, 1:4], rows[:, 4:7])
