"""State that outlives the daemon: files that are always complete, written by threads."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from pathlib import Path

from ekf_companion.config.file_name import check_name
from ekf_companion.daemon.worker import Worker
from ekf_companion.engine.checkpoint import is_ours

_log = logging.getLogger(__name__)

LARGEST = 1 << 20
"""Largest file that is read, bytes; no state comes near."""
READING = 2.0
"""Seconds that a slow disk may take to return the state of the last run."""
PARAMETER_PERIOD = 1.0
"""Seconds between two files of parameters: anybody on the link may set one again and again."""
_LATE = "%s: the disk did not return it within %g s; starting without it"
_NO_FILE = "checkpoint.file: %s: is not a regular file; %s; name another"


class StateFile:
    """Writes the newest state to a file; the caller never waits for the disk, except to read.

    The new state is written to another file and renamed, so that a reader finds either the old or
    the new one, complete. Few files need a sync: the system's cache outlives the daemon, and after
    a loss of power the autopilot has rebooted too.
    """

    def __init__(
        self, path: Path, loss: str, *, period: float = 0.0, is_synced: bool = False
    ) -> None:
        """Start the thread, which reads the state of the last run.

        ``loss`` says in the log what a failure to write means. Two files are at least ``period`` s
        apart; synced, each is complete even after a loss of power.
        """
        self.path = path
        self.is_late = False
        """Whether the disk was too slow to return the state of the last run."""
        self._loss, self._is_synced = loss, is_synced
        self._new_path = path.with_name(path.name + ".new")
        self._found: bytes | None = None
        self._has_read, self._late_s = threading.Event(), time.monotonic() + READING
        self._is_usable, self._is_failing = True, False
        self._foreign = ""
        self._data: bytes | None = None
        self._written: bytes | None = None
        self._worker = Worker("state", self._write, begin=self._begin, period=period)

    def read(self) -> bytes | None:
        """Return the state of the last run; None if there is none, or the disk is too slow."""
        if not self.is_late and not self._has_read.wait(max(self._late_s - time.monotonic(), 0.0)):
            self.is_late = True
            _log.warning(_LATE, self.path, READING)
        return None if self.is_late else self._found

    def set_aside(self, kind: str) -> None:
        """Have a file that is not ours renamed before the first write."""
        self._foreign = kind

    def write(self, data: bytes) -> None:
        """Have the state written; it replaces an older one that still waits."""
        self._data = data
        self._worker.wake()

    def finish(self) -> None:
        """Have the last state written; does not wait for it."""
        self._worker.finish()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        if not self._worker.join(end_s):
            _log.warning("%s: the disk is too slow; the last state may be missing", self.path)

    # On the thread

    def _begin(self) -> None:
        """Read the file, and warn if nothing can be written."""
        try:
            if self.path.exists() and not self.path.is_file():
                self._is_usable = False
                _log.warning(_NO_FILE, self.path, self._loss)
                return
            self._load()
            is_there = self._new_path.exists()
            self._new_path.touch()
            if not is_there:
                self._new_path.unlink()
        except OSError as error:
            self._complain(error)
        finally:
            self._has_read.set()

    def _load(self) -> None:
        with contextlib.suppress(FileNotFoundError), self.path.open("rb") as file:
            self._found = file.read(LARGEST)

    def _write(self, is_last: bool) -> None:
        data = self._data
        if data is None or data is self._written or not self._is_usable:
            return
        self._written = data
        try:
            if self._foreign and self.path.exists():
                name = self.path.name + ".foreign"
                self.path.replace(self.path.with_name(name))
                _log.warning("%s: is not a %s; renamed to %s", self.path, self._foreign, name)
            self._foreign = ""
            with self._new_path.open("wb") as file:
                file.write(data)
                file.flush()
                if self._is_synced:
                    os.fdatasync(file)
            self._new_path.replace(self.path)
            if self._is_synced:
                sync(self.path.parent)
            self._is_failing = False
        except OSError as error:
            with contextlib.suppress(OSError):
                self._new_path.unlink()  # the half of it takes room from others
            self._complain(error)

    def _complain(self, error: OSError) -> None:
        """Warn once, until something has been written again."""
        if not self._is_failing:
            words = error.strerror or os.strerror(error.errno or 0)
            _log.warning("%s: %s; %s", self.path, words, self._loss)
        self._is_failing = True


class CheckpointFile(StateFile):
    """Writes the newest checkpoint."""

    def __init__(self, path: Path, interval: float) -> None:
        """Start the thread, which reads the checkpoint of the last run; the interval is in s."""
        self._interval_ns, self._next_ns, self._resets = round(interval * 1e9), 0, 0
        super().__init__(path, "a restart would align anew")

    def _load(self) -> None:
        super()._load()
        if self._found and not is_ours(self._found):
            self.set_aside("checkpoint")

    def is_due(self, now_ns: int, resets: int) -> bool:
        """Return whether to write one now: the interval is over, or the estimate was just reset.

        A count of resets that was sent must not be sent again after a restart.
        """
        if now_ns < self._next_ns and resets == self._resets:
            return False
        self._next_ns, self._resets = now_ns + self._interval_ns, resets
        return True


def open_checkpoint_file(file: str, interval: float) -> CheckpointFile | None:
    """Start to read and write checkpoints; return None if no file is named.

    Raises:
        ConfigError: No file can have that name.
    """
    if not file:
        return None
    check_name("checkpoint.file", file)
    return CheckpointFile(Path(file), interval)


def open_parameter_file(file: str) -> StateFile | None:
    """Start to read and write the parameters set over MAVLink, beside the checkpoint."""
    loss = "what is set over MAVLink is forgotten at a restart"
    return StateFile(Path(f"{file}.parameters"), loss, period=PARAMETER_PERIOD) if file else None


def sync(path: Path) -> None:
    """Force a file, or the names in a folder, to the disk.

    Raises:
        OSError: There is none, or the disk fails.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
