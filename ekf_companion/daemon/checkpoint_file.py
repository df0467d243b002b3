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

from ekf_companion.config.file_name import check_name
from ekf_companion.engine.checkpoint import Clocks, is_ours

_log = logging.getLogger(__name__)

LARGEST = 1 << 20
"""Bytes; no checkpoint comes near."""
READING = 2.0
"""Seconds that a slow disk may take to give what the last run left; then we start without it."""
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
        ConfigError: The name cannot be one of a file.
    """
    if not file:
        return None
    check_name("checkpoint.file", file)
    return Keeper(Path(file), interval)


def open_memory(file: str) -> Slot | None:
    """Make the place, beside the checkpoint's file, of what was set over MAVLink; None: nowhere."""
    loss = "what is set over MAVLink is forgotten at a restart"
    return Slot(Path(f"{file}.parameters"), loss, rest_s=REST) if file else None


class Slot:
    """Keeps the newest bytes under one name; a disk that is away, slow or full holds up nobody.

    All that touches the disk is done by a thread; only for what the last run left is it waited, and
    not for long.

    They are written beside and renamed, so that whoever reads finds the old ones or the new ones
    whole. Nothing is forced to the disk, but for a copy where that is asked: the system's cache
    outlives the daemon, and after a loss of power the autopilot has rebooted too.
    """

    def __init__(
        self, path: Path, loss: str, *, force_s: float | None = None, rest_s: float = 0.0
    ) -> None:
        """Start the thread, which reads at once.

        Args:
            path: The file.
            loss: What it means that nothing can be kept, for the log.
            force_s: Seconds after which a copy is forced to the disk, to be read where a loss of
                power has taken the file; None: there is none.
            rest_s: Seconds to wait after each file before the next, which then is the newest.
        """
        self.path = path
        self.is_late = False
        """Whether the disk has not given in time what the last run left."""
        self._loss = loss
        self._beside = path.with_name(path.name + ".new")
        self._copy = path.with_name(path.name + ".copy")
        self._force_s, self._rest_s = force_s, rest_s
        self._forced_s = -math.inf
        self._is_failing = False
        self._found: bytes | None = None
        self._found_copy: bytes | None = None
        self._has_read = threading.Event()
        self._late_s = time.monotonic() + READING
        self._aside = ""
        self._data: bytes | None = None
        self._closed = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keeper", daemon=True)
        self._thread.start()

    def read(self) -> bytes | None:
        """Give what the last run left, if anything, and if the disk is not too slow."""
        return self._found if self._wait() else None

    def read_copy(self) -> bytes | None:
        """Give what was last forced to the disk, as ``read``."""
        return self._found_copy if self._wait() else None

    def _wait(self) -> bool:
        """Wait until it is read; say once if that takes too long."""
        if not self.is_late and not self._has_read.wait(max(self._late_s - time.monotonic(), 0.0)):
            self.is_late = True
            _log.warning(
                "%s: the disk has not given it within %g s; starting without it", self.path, READING
            )
        return not self.is_late

    def put_aside(self, what: str) -> None:
        """Have a file that is none of ours given another name, before it is written over."""
        self._aside = what

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

    # The thread's side

    def _run(self) -> None:
        is_usable = self._begin()
        self._has_read.set()
        written: bytes | None = None
        while is_usable:
            self._wake.wait()
            self._wake.clear()
            is_last, data = self._closed.is_set(), self._data
            if data is not None and data is not written:
                self._rename()
                self._write(data, is_last=is_last)
                written = data
            if is_last:
                return
            self._closed.wait(self._rest_s)

    def _begin(self) -> bool:
        """Read what there is; give whether anything can be kept there, and say if not."""
        try:
            if self.path.exists() and not self.path.is_file():
                _log.warning(
                    "checkpoint.file: %s: is no plain file; %s; name another", self.path, self._loss
                )
                return False
            self._load()
            is_there = self._beside.exists()
            self._beside.touch()
            if not is_there:
                self._beside.unlink()
        except OSError as error:
            self._complain(error)
        return True

    def _load(self) -> None:
        self._found = self._read(self.path)
        if self._force_s is not None:
            self._found_copy = self._read(self._copy)

    def _read(self, path: Path) -> bytes | None:
        try:
            with path.open("rb") as file:
                return file.read(LARGEST)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            _log.warning("%s: cannot be read: %s; %s", path, error.strerror, self._loss)
            return None

    def _rename(self) -> None:
        """Give a file that is none of ours another name."""
        if not (what := self._aside):
            return
        self._aside = ""
        aside = self.path.with_name(self.path.name + ".foreign")
        try:
            self.path.replace(aside)
        except OSError as error:
            _log.warning("%s: is no %s; %s", self.path, what, error.strerror)
        else:
            _log.warning("%s: is no %s; it is now %s", self.path, what, aside.name)

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
        """Start the thread, which reads at once.

        Args:
            path: The file.
            interval: Between two checkpoints, s.
        """
        super().__init__(path, "a restart would align anew")
        self._interval_ns = round(interval * 1e9)
        self._next_ns = 0
        self._resets = 0

    def _load(self) -> None:
        super()._load()
        if self._found and not is_ours(self._found):
            self.put_aside("checkpoint")

    def is_due(self, now_ns: int, resets: int) -> bool:
        """Whether to keep one now: the interval is over, or the estimate has just been reset.

        A count of resets that was told must not be told again after a restart.
        """
        if now_ns < self._next_ns and resets == self._resets:
            return False
        self._next_ns = now_ns + self._interval_ns
        self._resets = resets
        return True
