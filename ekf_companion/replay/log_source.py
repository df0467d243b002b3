"""Recorded flights of every format: opened here, whatever the suffix."""

from __future__ import annotations

from pathlib import Path

from ekf_companion.errors import LogError
from ekf_companion.logs import broad, csv, dataflash, openshoe, tlog, tlog_trajectory, ulog
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.source import suffix_of
from ekf_companion.nav.state import Trajectory

READERS = {
    ".bin": dataflash.read,
    ".ulg": ulog.read,
    ".csv": csv.read,
    ".txt": openshoe.read,
    ".mat": broad.read,
}
"""Readers of the logs that hold columns, by suffix."""
FORMATS = ".tlog, .bin, .ulg, .csv, .txt (OpenShoe), .mat (BROAD); all but .mat also as .gz, .zst"

Log = tlog.Tlog | Recording
"""Frames that a session must decode, or columns of measurements."""


def open_log(path: Path) -> Log:
    """Open a log by its suffix.

    Raises:
        LogError: It cannot be read, or is of an unknown kind.
    """
    suffix = suffix_of(path)
    if suffix == ".tlog":
        return tlog.read(path)
    if suffix not in READERS:
        raise LogError(f"{path}: unknown kind of log; known are {FORMATS}")
    return READERS[suffix](path)


def reference(log: Log) -> Trajectory | None:
    """Return the autopilot's own estimate; None if the log has none."""
    return log.reference if isinstance(log, Recording) else tlog_trajectory.reference(log)


def truth(log: Log) -> Trajectory | None:
    """Return the truth of a simulator or an optical system; None if the log has none."""
    return log.truth if isinstance(log, Recording) else tlog_trajectory.truth(log)
