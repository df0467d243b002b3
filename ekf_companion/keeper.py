"""Checkpoints on the disk: one file, always whole, written by a thread that may be slow."""

from __future__ import annotations

import logging
import math
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
"""Seconds that a slow disk may take for the last one, where nobody says until when."""
REST = 1.0
"""Seconds between two files of parameters: anybody on the link may set one again and again."""
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


def open_memory(file: str) -> Slot | None:
    """Make the place, beside the checkpoint's file, of what was set over MAVLink; None: nowhere.

    Raises:
        ConfigError: The name cannot be meant.
    """
    loss = "what is set over MAVLink is forgotten at a restart"
    return Slot(Path(f"{file}.parameters"), loss, rest_s=REST) if file else None


class Slot:
    """Keeps the newest bytes under one name; a disk that is slow or full holds up nobody.

    They are written beside and renamed, so that whoever reads finds the old ones or the new ones
    whole. Nothing is forced to the disk, but for a copy where that is asked: the system's cache
    outlives the daemon, and after a loss of power the autopilot has rebooted too.
    """

    def __init__(
        self, path: Path, loss: str, *, force_s: float | None = None, rest_s: float = 0.0
    ) -> None:
        """Try the folder, and start the thread.

        Args:
            path: The file.
            loss: What it means that nothing can be kept, for the log.
            force_s: Seconds after which a copy is forced to the disk, to be read where a loss of
                power has taken the file; None: there is none.
            rest_s: Seconds to wait after each file before the next, which then is the newest.

        Raises:
            ConfigError: It cannot be a file of ours.
        """
        self.path = path
        self._loss = loss
        self._beside = path.with_name(path.name + ".new")
        self._copy = path.with_name(path.name + ".copy")
        self._force_s, self._rest_s = force_s, rest_s
        self._forced_s = -math.inf
        self._is_failing = False
        self._try()
        self._data: bytes | None = None
        self._closed = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def read(self) -> bytes | None:
        """Give what the last run left, if anything."""
        return self._read(self.path)

    def read_copy(self) -> bytes | None:
        """Give what was last forced to the disk, if anything."""
        return self._read(self._copy)

    def _read(self, path: Path) -> bytes | None:
        try:
            with path.open("rb") as file:
                return file.read(LARGEST)
        except FileNotFoundError:
            return None
        except OSError as error:
            _log.warning("%s: cannot be read: %s; %s", path, error.strerror, self._loss)
            return None

    def put_aside(self, what: str) -> None:
        """Give a file that is none of ours another name, before it is written over."""
        aside = self.path.with_name(self.path.name + ".foreign")
        try:
            self.path.replace(aside)
        except OSError as error:
            _log.warning("%s: is no %s; %s", self.path, what, error.strerror)
        else:
            _log.warning("%s: is no %s; it is now %s", self.path, what, aside.name)

    def keep(self, data: bytes) -> None:
        """Hand some over to be written; what still waits is not worth it any more."""
        self._data = data
        self._wake.set()

    def close(self) -> None:
        """Write the last, if the disk lets us."""
        self.finish()
        self.join(time.monotonic() + PATIENCE)

    def finish(self) -> None:
        """Have the last written; does not wait."""
        self._closed.set()
        self._wake.set()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))
        if self._thread.is_alive():
            _log.warning("%s: the disk is too slow; the last state may be missing", self.path)

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
            is_last, data = self._closed.is_set(), self._data
            if data is not None and data is not written:
                self._write(data, is_last=is_last)
                written = data
            if is_last:
                return
            self._closed.wait(self._rest_s)

    def _write(self, data: bytes, *, is_last: bool) -> None:
        try:
            self._beside.write_bytes(data)
            self._beside.replace(self.path)
            if self._force_s is not None:
                now_s = time.monotonic()
                if is_last or now_s >= self._forced_s + self._force_s:
                    self._forced_s = now_s
                    self._force(data)
        except OSError as error:
            self._complain(error)
        else:
            self._is_failing = False

    def _force(self, data: bytes) -> None:
        """Put a copy on the disk that a loss of power leaves whole."""
        with self._beside.open("wb", buffering=0) as file:
            file.write(data)
            os.fdatasync(file)
        self._beside.replace(self._copy)
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _complain(self, error: OSError) -> None:
        """Say once per trouble that there is nothing to go on from."""
        if not self._is_failing:
            words = error.strerror or os.strerror(error.errno or 0)
            _log.warning("%s: %s; %s", self.path, words, self._loss)
        self._is_failing = True


class Keeper(Slot):
    """Keeps the newest checkpoint."""

    def __init__(self, path: Path, interval: float) -> None:
        """Try the folder, and start the thread.

        Args:
            path: The file.
            interval: Between two checkpoints, s.

        Raises:
            ConfigError: It cannot be a file of ours.
        """
        super().__init__(path, "a restart would align anew")
        self._interval_ns = round(interval * 1e9)
        self._next_ns = 0
        self._resets = 0

    def read(self) -> bytes | None:
        """Give what the last run left, if anything; what is none of ours is put aside."""
        data = super().read()
        if data and not is_ours(data):
            self.put_aside("checkpoint")
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
