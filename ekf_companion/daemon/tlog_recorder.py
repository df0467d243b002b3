"""The recording: all frames in and out, in .tlog files that rotate, written by two threads.

One thread writes, four times a second: a kill loses less than a second. The other syncs what was
written, twice a second: a loss of power loses less than a second too, plus the time that a slow
disk takes for one sync. A disk that is missing, hangs or is full costs the recording and nothing
else; it is tried again. ``tlog_folder`` decides which files are ours and may be deleted.
"""

from __future__ import annotations

import errno
import logging
import os
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ekf_companion.config.service import RecordConfig
from ekf_companion.daemon.tlog_folder import TlogFolder
from ekf_companion.daemon.worker import Worker

_log = logging.getLogger(__name__)

MB = 1_000_000
WRITE_PERIOD = 0.25
"""Seconds between two writes."""
SYNC_PERIOD = 0.5
"""Seconds between two syncs."""
CHECK_PERIOD = 5.0
"""Seconds between two checks of what the disk has left; a call that takes longer hangs."""
BATCH = 1 << 18
"""Largest write, bytes."""
WAITING = 8 * MB
"""Bytes that wait for a slow disk: minutes of flight; beyond that nothing is recorded."""
SLACK = 16 * MB
"""Bytes beyond ``record.free_space`` at which a stopped recording begins again."""
UNSYNCED = 8
"""Files that wait for their last sync; beyond that, no new one is begun."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_FULL = (
    "%s: less than %g MB free, and deleting our older recordings would not be enough; nothing is "
    "recorded until there is room: record.free_space"
)
_NO_FILE = (
    "record.path: %s: %s; nothing is recorded, trying again every %.0f s; name a file in a folder "
    "that can be written to"
)


@dataclass(slots=True, eq=False)
class _File:
    descriptor: int
    size: int = 0
    """Bytes written."""
    synced: int = -1
    """Bytes on the disk; -1: not even the name is."""
    is_broken: bool = False
    """Whether to begin another at the next check."""


class Recorder:
    """Records what goes in and out; a missing, slow or full disk delays nobody."""

    def __init__(self, config: RecordConfig, path: str) -> None:
        """Start the threads; the first opens a file."""
        self._folder = TlogFolder(path)
        self._total_size = round(config.total_size * MB)
        self._file_size = min(round(config.file_size * MB), self._total_size // 2)
        self._free_space = round(config.free_space * MB)
        self.path = Path(path)
        """The file being written; as configured, until one could be opened."""
        self.recorded_bytes = 0
        """Bytes that the system has taken, of all files."""
        self._refused = self._accepted = 0  # written by the loop, all others by the threads
        self._lost = self._lost_before = self._total = 0
        self._records: deque[bytes] = deque()
        self._file: _File | None = None
        self._open: deque[_File] = deque()
        self._checked_s = -CHECK_PERIOD
        self._is_full = self._has_made_room = False
        self._trouble = ""
        self._sync_error: OSError | None = None
        self._syncer = Worker("tlog-sync", self._sync, period=SYNC_PERIOD)
        self._writer = Worker("tlog", self._write, begin=self._begin_file, period=WRITE_PERIOD)

    @property
    def unrecorded_bytes(self) -> int:
        """Bytes that a slow, full or broken disk did not take."""
        return self._refused + self._lost

    @property
    def trouble(self) -> str:
        """Why not everything is recorded at present; empty if it is."""
        if self._writer.busy_s > CHECK_PERIOD:
            return f"{self.path}: the disk does not answer"
        if self._is_full:
            return f"{self._folder.path}: less than {self._free_space / MB:g} MB free"
        if self._trouble:
            return f"{self.path}: {self._trouble}"
        if self._syncer.busy_s > CHECK_PERIOD:
            return f"{self.path}: the disk is so slow that a loss of power would cost the end"
        return ""

    def write(self, records: list[tuple[int, bytes]]) -> None:
        """Record stamps (us) and bytes; never waits."""
        for stamp, data in records:
            size = 8 + len(data)
            if self._accepted + size - self.recorded_bytes - self._lost > WAITING:
                if not self._refused:
                    _log.warning("%s: the disk is too slow; not all is recorded", self.path)
                self._refused += size
            else:
                self._records.append(stamp.to_bytes(8, "big") + data)
                self._accepted += size
        if records:
            self._writer.wake()

    def finish(self) -> None:
        """Have the rest written and synced; does not wait for it."""
        self._writer.finish()

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        if not (self._writer.join(end_s) and self._syncer.join(end_s)):
            _log.warning("%s: the disk is too slow; the end may be missing", self.path)
        elif (error := self._sync_error) is not None:
            _log.warning("%s: %s; the end may be missing", self.path, error.strerror)
        elif self.unrecorded_bytes:
            _log.warning("%s: %d bytes are missing", self.path, self.unrecorded_bytes)

    # On the thread that writes

    def _write(self, is_last: bool) -> None:
        """Write what waits, batch by batch."""
        waiting = len(self._records)
        while waiting > 0:
            batch: list[bytes] = []
            size = 0
            while len(batch) < waiting and size < BATCH:
                batch.append(self._records.popleft())
                size += len(batch[-1])
            waiting -= len(batch)
            self._write_batch(b"".join(batch))
            self._syncer.wake()
        if is_last:
            self._syncer.finish()

    def _write_batch(self, batch: bytes) -> None:
        error, self._sync_error = self._sync_error, None
        if error is not None:
            self._fail(error)
        if self._file is not None and 0 < self._file.size > self._file_size - len(batch):
            self._begin_file()
        if time.monotonic() >= self._checked_s + CHECK_PERIOD:
            self._check_disk()
        rest = memoryview(batch)
        try:
            while rest and self._file is not None and not self._is_full:
                written = os.write(self._file.descriptor, rest)
                self._file.size += written
                self._total += written
                self.recorded_bytes += written
                rest = rest[written:]
                self._has_made_room = False
        except OSError as failure:
            self._fail(failure)
        self._lost += len(rest)

    def _begin_file(self) -> None:
        """Begin the next file, or continue with the present one if that fails."""
        if len(self._open) > UNSYNCED:
            return
        try:
            path, descriptor = self._folder.create()
        except OSError as error:
            self._fail(error)
            return
        # In this order: the other thread closes each open file that is not the present one
        self.path, self._file = path, _File(descriptor)
        self._open.append(self._file)
        self._checked_s = -CHECK_PERIOD
        _log.info("Recording to %s", path)

    def _check_disk(self) -> None:
        """Replace a broken or deleted file, make room, and stop or resume recording."""
        if self._lost == self._lost_before and self._file is not None:
            self._trouble = ""
        self._lost_before = self._lost
        try:
            file = self._file
            if file is None or file.is_broken or os.fstat(file.descriptor).st_nlink == 0:
                self._begin_file()
            if self._total > self._total_size or self._file is None or not self._file.size:
                self._total = sum(size for _, size in self._folder.files())
                self._total -= self._folder.free(self._total - self._total_size)
            disk = os.statvfs(self._folder.path)
            wanted = self._free_space + (SLACK if self._is_full else 0)
            short = wanted - disk.f_bavail * disk.f_frsize
            is_full = self._folder.free(short, or_none=True) < short
            if is_full and not self._is_full:
                _log.warning(_FULL, self._folder.path, self._free_space / MB)
            elif self._is_full and not is_full:
                _log.info("%s: there is room again; recording goes on", self.path)
            self._is_full = is_full
        except OSError as error:
            self._fail(error)
        self._checked_s = time.monotonic()

    def _fail(self, error: OSError) -> None:
        """Warn once per fault that not everything is recorded, and schedule the next attempt."""
        words = error.strerror or str(error)
        if words != self._trouble and self._file is None:
            _log.warning(_NO_FILE, self.path, words, CHECK_PERIOD)
        elif words != self._trouble:
            _log.warning("%s: %s; not all is recorded", self.path, words)
        self._trouble = words
        if error.errno not in _NO_ROOM:
            if self._file is not None:
                self._file.is_broken = True
        elif not self._has_made_room:
            # A quota shows in no count of free space; a deletion that did not help is not repeated
            self._has_made_room = True
            with suppress(OSError):
                self._folder.free(BATCH, or_none=True)

    # On the thread that syncs

    def _sync(self, is_last: bool) -> None:
        """Sync what was written, and close the files that are complete."""
        for file in tuple(self._open):
            # Asked before its size: to a file that is complete nothing is added
            is_complete, size = is_last or file is not self._file, file.size
            try:
                if file.synced < size:
                    is_new, file.synced = file.synced < 0, size
                    os.fdatasync(file.descriptor)
                    if is_new:
                        self._folder.sync()
            except OSError as error:
                self._sync_error = error
            if is_complete:
                self._open.remove(file)
                os.close(file.descriptor)
            if is_last and not self.recorded_bytes:
                self._remove_empty()

    def _remove_empty(self) -> None:
        """Remove the file of a run that recorded nothing."""
        with suppress(OSError):
            if self._file is not None and self.path.stat().st_size == 0:
                self.path.unlink()
                _log.info("%s: nothing was recorded; removed", self.path)


def open_recorder(config: RecordConfig) -> Recorder | None:
    """Begin a recording; return None if none is wanted.

    Raises:
        ConfigError: No file can have that name.
    """
    return None if config.path is None else Recorder(config, config.path)
