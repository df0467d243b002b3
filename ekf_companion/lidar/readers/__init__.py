"""Recordings of a lidar and an inertial sensor, one file per form: bytes in, a `Recording` out.

source      what every form offers: scans and samples as they are stored, nothing decided
sequence    lidar.npz, imu.npz and calib.json in one folder
"""

from __future__ import annotations

from pathlib import Path

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.judge import judge
from ekf_companion.lidar.readers.sequence import open_sequence
from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.recording import Mounting, Recording


def read(
    path: str | Path, *, mounting: Mounting | None = None, stamp: str | None = None
) -> Recording:
    """Return a recording in any form that is known, with what was decided about it.

    Args:
        path: The file, or the folder.
        mounting: The lidar on the inertial sensor. None: as the recording says.
        stamp: `start`, `middle` or `end` of a scan, of which its stamp is. None: as it shows.

    Raises:
        LogError: It cannot be read, or nothing can be estimated from it.
    """
    return judge(_open(Path(path)), mounting, stamp)


def _open(path: Path) -> Source:
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    if (path / "lidar.npz").is_file():
        return open_sequence(path)
    raise LogError(f"{path}: no recording of a lidar in a form that is known")
