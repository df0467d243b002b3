"""Recorded flights of every format: opened here, whatever the suffix."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, cast

from ekf_companion.errors import LogError
from ekf_companion.logs.content import check_suffix
from ekf_companion.logs.estimate import OWN, is_written
from ekf_companion.logs.onboard import Onboard
from ekf_companion.logs.recording import CLOCK_SET_S, LATEST_S, Recording
from ekf_companion.logs.source import suffix_of
from ekf_companion.nav.state import Trajectory

if TYPE_CHECKING:
    from ekf_companion.logs.tlog import Autopilot, Tlog

READERS = {
    ".bin": "dataflash",
    ".ulg": "ulog",
    ".csv": "csv",
    ".txt": "openshoe",
    ".mat": "broad",
}
"""Readers of the logs that hold columns, by suffix; each is imported when it is needed."""
FORMATS = ".tlog, .bin, .ulg, .csv, .txt (OpenShoe), .mat (BROAD); all but .mat also as .gz, .zst"

Log: TypeAlias = "Tlog | Recording"
"""Frames that a session must decode, or columns of measurements."""


def open_log(path: Path) -> Log:
    """Open a log by its suffix.

    Raises:
        LogError: It cannot be read, or is of an unknown kind.
    """
    if any(letter in path.name for letter in "*?[") and not path.exists():
        raise LogError(
            f"{path}: a pattern, and no file of that name; leave the quotes out, so that the shell "
            f"puts in the name, or of several logs: ekf-companion batch '{path}' -o table.csv"
        )
    if path.is_dir():
        raise LogError(
            f"{path}: a folder; name one log in it, or all: ekf-companion batch {path} -o table.csv"
        )
    suffix = suffix_of(path)
    # A .tlog holds the log that it was made from too
    if path.is_file() and suffix != ".tlog" and is_written(path):
        compared = f", or: ekf-companion compare {path} --reference TRUTH.csv"
        raise LogError(
            f"{path}: {OWN}, and no log; name the log that it was made from"
            f"{compared if suffix == '.csv' else ''}"
        )
    check_suffix(path, suffix)
    if suffix == ".tlog":
        from ekf_companion.logs import tlog

        return tlog.read(path)
    if suffix not in READERS:
        raise LogError(f"{path}: unknown kind of log; known are {FORMATS}")
    return cast("Recording", import_module(f"ekf_companion.logs.{READERS[suffix]}").read(path))


def reference(log: Log, of: Autopilot | None = None) -> Trajectory | None:
    """Return the autopilot's own estimate; None if the log has none.

    ``of`` is the autopilot of a .tlog that is listened to.
    """
    if isinstance(log, Recording):
        return log.reference
    from ekf_companion.logs import tlog_trajectory

    return None if (of := _heard(log, of)) is None else tlog_trajectory.reference(log, of)


def truth(log: Log, of: Autopilot | None = None) -> Trajectory | None:
    """Return the truth of a simulator or an optical system; None if the log has none.

    ``of`` is the autopilot of a .tlog that is listened to.
    """
    if isinstance(log, Recording):
        return log.truth
    from ekf_companion.logs import tlog_trajectory

    return None if (of := _heard(log, of)) is None else tlog_trajectory.truth(log, of)


def onboard(log: Log, of: Autopilot | None = None) -> Onboard:
    """Return firmware, parameters and messages, as far as a log holds them.

    ``of`` is the autopilot of a .tlog that is listened to.
    """
    if isinstance(log, Recording):
        return log.onboard
    from ekf_companion.logs import tlog_text

    return Onboard() if (of := _heard(log, of)) is None else tlog_text.read(log, of)


def utc_zero_ns(log: Log, of: Autopilot | None = None) -> int | None:
    """Return the UTC at which the autopilot's clock was zero, ns since 1970; None: not known."""
    if isinstance(log, Recording):
        found = log.utc_zero_ns
    else:
        from ekf_companion.logs import tlog_trajectory

        of = _heard(log, of)
        found = None if of is None else tlog_trajectory.utc_zero_ns(log, of)
    return found if found is not None and CLOCK_SET_S < found * 1e-9 < LATEST_S else None


def _heard(log: Tlog, of: Autopilot | None) -> Autopilot | None:
    """Return the autopilot that is listened to, by default the one that a session would find."""
    from ekf_companion.logs.tlog_senders import autopilot_of

    return of or autopilot_of(log)
