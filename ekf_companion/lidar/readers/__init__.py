"""Recordings of lidar or radar and inertial sensor, one file per form: bytes to a `Recording`.

source      what every form offers: scans and samples as they are stored, nothing decided
sequence    lidar.npz, imu.npz and calib.json in one folder
bag         ROS 1, and ROS 2 as .db3 and .mcap
folder      .pcd or .npz files with imu.csv
pcap        packets of Ouster and Velodyne
livox       packets of a Livox, whose scans are those of `run-lidar`, with nothing to be decided
survey      one pass over the scans: numbers of each
timing, inertial, motion   decisions: stamps and times; samples; whether lidar and gyro agree
doppler, doppler_fit   whether velocities by a radar's radial speeds and the samples agree
judge       all of them: a Recording, or an error that names what is wrong
"""

from __future__ import annotations

from pathlib import Path

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.bag import open_bag
from ekf_companion.lidar.readers.folder import is_folder, open_folder
from ekf_companion.lidar.readers.judge import judge
from ekf_companion.lidar.readers.livox import is_livox, read_livox
from ekf_companion.lidar.readers.pcap import open_pcap
from ekf_companion.lidar.readers.sequence import open_sequence
from ekf_companion.lidar.readers.source import Source
from ekf_companion.lidar.recording import Mounting, Recording

CAPTURES = (".pcap", ".pcapng")


def read(
    path: str | Path,
    *,
    mounting: Mounting | None = None,
    stamp: str | None = None,
    lidar: str | None = None,
    imu: str | None = None,
    by_doppler: bool | None = None,
    most_speed: float = 0.0,
) -> Recording:
    """Return a recording in any form that is known, with what was decided about it.

    Args:
        path: The file, or the folder.
        mounting: The lidar on the inertial sensor. None: as the recording says.
        stamp: `start`, `middle` or `end` of a scan, of which its stamp is. None: as it shows.
        lidar: The topic of the scans in a bag. None: the one with the most messages.
        imu: The topic of the inertial samples. None: likewise. For a .pcap of a Velodyne the table
            of its inertial samples; None: imu.csv beside it.
        by_doppler: Whether the radial speeds of the points count, as of a radar. None: where
            any is not 0.
        most_speed: Radial speed at which those of a radar wrap, m/s; 0: they do not.

    Raises:
        LogError: It cannot be read, or nothing can be estimated from it.
        MissingPackageError: The package that reads its form is not installed.
    """
    path = Path(path)
    if path.suffix in CAPTURES and path.is_file() and is_livox(path):
        return read_livox(path, mounting)
    return judge(_open(path, lidar, imu), mounting, stamp, by_doppler, most_speed)


def _open(path: Path, lidar: str | None, imu: str | None) -> Source:
    if not path.exists():
        raise LogError(f"{path}: no such file or folder")
    if (path / "lidar.npz").is_file():
        return open_sequence(path)
    if path.suffix in (".bag", ".db3", ".mcap") or (path / "metadata.yaml").is_file():
        return open_bag(path, lidar, imu)
    if path.suffix in CAPTURES:
        return open_pcap(path, imu)
    if is_folder(path):
        return open_folder(path)
    raise LogError(
        f"{path}: no recording of a lidar: neither .bag, .db3, .mcap, .pcap or a bag's folder, "
        "nor a folder with lidar.npz, or with .pcd or .npz scans and imu.csv"
    )
