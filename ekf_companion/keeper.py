"""Checkpoints on the disk: one file, always whole, written by a thread that may be slow."""

from __future__ import annotations

import logging
import os
import threading
import time
import uuid
from functools import cache
from pathlib import Path

from ekf_companion.checkpoint import Clocks, is_ours
from ekf_companion.errors import ConfigError

_log = logging.getLogger(__name__)

LARGEST = 1 << 20
"""Bytes; no checkpoint comes near."""
PATIENCE = 0.6
"""Seconds that a slow disk may take for the last one: with the recording's, no more than 2 s pass
from SIGTERM to the end."""
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def clocks() -> Clocks:
    """Read the companion's clocks."""
    if not (boot_id := _boot_id()):
        return Clocks(time.time_ns())
    return Clocks(time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME), boot_id)


@cache
def _boot_id() -> bytes:
    """Give the 16 bytes that Linux draws at boot; empty: none, and unix time has to do."""
    try:
        return uuid.UUID(_BOOT_ID.read_text(encoding="ascii").strip()).bytes
    except (OSError, ValueError):
        return b""


def open_keeper(file: str, interval: float) -> Keeper | None:
    """Make a keeper; None: none is wanted.

    Raises:
        ConfigError: The name cannot be meant.
    """
    return Keeper(Path(file), interval) if file else None


class Keeper:
    """Keeps the newest checkpoint under one name; a disk that is slow or full holds up nobody.

    It is written beside and renamed, so that whoever reads finds the old one or the new one whole.
    Nothing is forced to the disk: the system's cache outlives the daemon, and after a loss of power
    the autopilot has rebooted too.
    """

    def __init__(self, path: Path, interval: float) -> None:
        """Try the folder, and start the thread.

        Args:
            path: The file.
            interval: Between two checkpoints, s.

        Raises:
            ConfigError: It cannot be a file of ours.
        """
        self.path = path
        self._beside = path.with_name(path.name + ".new")
        self._interval_ns = round(interval * 1e9)
        self._next_ns = 0
        self._resets = 0
        self._is_failing = False
        self._try()
        self._data: bytes | None = None
        self._is_closed = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def read(self) -> bytes | None:
        """Give what the last run left, if anything; what is none of ours is put aside."""
        try:
            with self.path.open("rb") as file:
                data = file.read(LARGEST)
            if data and not is_ours(data):
                aside = self.path.with_name(self.path.name + ".foreign")
                self.path.replace(aside)
                _log.warning("%s: is no checkpoint; it is now %s", self.path, aside.name)
        except FileNotFoundError:
            return None
        except OSError as error:
            _log.warning("%s: cannot be read: %s; aligning anew", self.path, error.strerror)
            return None
        return data

    def is_due(self, now_ns: int, resets: int) -> bool:
        """Whether to keep one now: the interval is over, or the estimate has just been reset.

        A count of resets that was told must not be told again after a restart.
        """
        if now_ns < self._next_ns and resets == self._resets:
            return False
        self._next_ns = now_ns + self._interval_ns
        self._resets = resets
        return True

    def keep(self, data: bytes) -> None:
        """Hand one over to be written; one that still waits is not worth it any more."""
        self._data = data
        self._wake.set()

    def close(self) -> None:
        """Write the last one, if the disk lets us."""
        self._is_closed = True
        self._wake.set()
        self._thread.join(PATIENCE)
        if self._thread.is_alive():
            _log.warning("%s: the disk is too slow; the last checkpoint may be missing", self.path)

    def _try(self) -> None:
        if self.path.exists() and not self.path.is_file():
            raise ConfigError(f"checkpoint.file: {self.path}: is no plain file; name another")
        try:
            self._beside.touch()
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
            raise ConfigError(
                f"checkpoint.file: {self.path}: {error.strerror}; "
                "name a file in a folder that can be written to"
            ) from error
        except OSError as error:
            self._complain(error)

    def _run(self) -> None:
        written: bytes | None = None
        while True:
            self._wake.wait()
            self._wake.clear()
            is_last, data = self._is_closed, self._data
            if data is not None and data is not written:
                self._write(data)
                written = data
            if is_last:
                return

    def _write(self, data: bytes) -> None:
        try:
            self._beside.write_bytes(data)
            self._beside.replace(self.path)
        except OSError as error:
            self._complain(error)
        else:
            self._is_failing = False

    def _complain(self, error: OSError) -> None:
        """Say once per trouble that there is nothing to go on from."""
        if not self._is_failing:
            words = error.strerror or os.strerror(error.errno or 0)
            _log.warning("%s: %s; a restart would align anew", self.path, words)
        self._is_failing = True
