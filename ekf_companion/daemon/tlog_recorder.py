"""The recording: what went in and out, in .tlog files that rotate, written by a thread.

The loop hands over whole records four times a second and never waits. The thread writes them at
once, whatever the disk does: at a kill less than a second is lost. Beside it ``flusher`` forces
them to the disk twice a second: at a power cut it is the same, and what a slow disk takes for one
time on top of it. A disk that is away, hangs or is full costs the recording and nothing else; it is
tried again. Which files are ours, to make room, is decided by ``shelf``.
"""

from __future__ import annotations

import errno
import logging
import os
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ekf_companion.config.service import RecordConfig
from ekf_companion.daemon.tlog_folder import Shelf

_log = logging.getLogger(__name__)

MB = 1_000_000
HAND_OVER = 0.25
"""Seconds between two handings over to the thread."""
BATCH = 1 << 18
"""Bytes that are handed over sooner."""
WAITING = 8 * MB
"""Bytes that wait for a slow disk: minutes of flight; what comes then is lost to the recording."""
SYNC = 0.5
"""Seconds after which what was written is forced to the disk."""
LOOK = 5.0
"""Seconds between two looks at what the disk has left; a disk that takes longer does not answer."""
SLACK = 16 * MB
"""Bytes more than ``record.free_space`` before a recording that stopped begins again."""
UNFORCED = 8
"""Files begun that a disk has not taken yet; beyond that, none is begun."""
PATIENCE = 0.6
"""Seconds that a slow disk may take for the end of the recording, where nobody says until when."""
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)


def open_recorder(config: RecordConfig) -> Recorder | None:
    """Begin a recording; None: none is wanted.

    Raises:
        ConfigError: The name cannot be one of a file.
    """
    return None if config.path is None else Recorder(config, config.path)


class Recorder:
    """Keeps what went in and out; a disk that is away, slow or full holds up nobody."""

    def __init__(self, config: RecordConfig, path: str) -> None:
        """Start the thread, which opens the first file.

        Raises:
            ConfigError: The name cannot be one of a file.
        """
        self._shelf = Shelf(path)
        self._total_size = round(config.total_size * MB)
        self._file_size = min(round(config.file_size * MB), self._total_size // 2)
        self._free_space = round(config.free_space * MB)
        self._waiting: list[bytes] = []
        self._size = 0
        self._next = 0.0
        # Each count has one writer: the loop's are the first two
        self._handed = self._refused = 0
        self._taken = self._recorded = self._lost = 0
        self._batches: queue.SimpleQueue[bytes] = queue.SimpleQueue()

        self.path = Path(path)
        self._file: int | None = None
        self._held = self._total = 0
        self._is_new = self._is_dirty = self._is_full = self._is_broken = False
        self._has_made_room = False
        self._trouble = ""
        self._lost_before = 0
        self._forced, self._looked = 0.0, -LOOK
        self._busy_since: float | None = time.monotonic()
        self._flusher = Flusher(self._shelf.sync)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    @property
    def recorded_bytes(self) -> int:
        """What the system has taken, of all files."""
        return self._recorded

    @property
    def unrecorded_bytes(self) -> int:
        """What a slow, full or broken disk did not take."""
        return self._refused + self._lost

    @property
    def trouble(self) -> str:
        """Why not all is recorded at present; empty: all is."""
        busy_since = self._busy_since
        if busy_since is not None and time.monotonic() - busy_since > LOOK:
            return f"{self.path}: the disk does not answer"
        if self._is_full:
            return f"{self._shelf.folder}: less than {self._free_space / MB:g} MB free"
        if self._trouble:
            return f"{self.path}: {self._trouble}"
        if self._flusher.late_s > LOOK:
            return f"{self.path}: the disk is so slow that a loss of power would cost the end"
        return ""

    # The loop's side

    def write(self, record: list[tuple[int, bytes]]) -> None:
        """Append stamps (us) and bytes; to be called ten times a second or more."""
        for stamp, data in record:
            self._waiting += stamp.to_bytes(8, "big"), data
            self._size += 8 + len(data)
        now = time.monotonic()
        if now >= self._next or self._size >= BATCH:
            self._next = now + HAND_OVER
            self._hand_over()

    def close(self) -> None:
        """Write what is left, if the disk lets us."""
        self.finish()
        self.join(time.monotonic() + PATIENCE)

    def finish(self) -> None:
        """Have written what is left; does not wait."""
        self._hand_over()
        self._batches.put(b"")

    def join(self, end_s: float) -> None:
        """Wait until that is done, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))
        self._flusher.join(end_s)
        if self._thread.is_alive() or self._flusher.waiting:
            _log.warning("%s: the disk is too slow; the end may be missing", self.path)
        elif (error := self._flusher.error()) is not None:
            _log.warning("%s: %s; the end may be missing", self.path, error.strerror)
        elif self.unrecorded_bytes:
            _log.warning("%s: %d bytes are missing", self.path, self.unrecorded_bytes)

    def _hand_over(self) -> None:
        if not self._size:
            return
        batch = b"".join(self._waiting)
        self._waiting.clear()
        self._size = 0
        if self._handed - self._taken + len(batch) <= WAITING:
            self._handed += len(batch)
            self._batches.put(batch)
            return
        if not self._refused:
            _log.warning("%s: the disk is too slow; not all is recorded", self.path)
        self._refused += len(batch)

    # The thread's side

    def _run(self) -> None:
        """Write batch by batch, until an empty one."""
        self._begin()
        while True:
            self._busy_since = None
            wait = max(0.0, self._forced + SYNC - time.monotonic()) if self._is_dirty else None
            try:
                batch = self._batches.get(timeout=wait)
            except queue.Empty:
                self._force()
                continue
            if not batch:
                break
            self._busy_since = time.monotonic()
            self._take(batch)
            self._taken += len(batch)
            if self._is_dirty and time.monotonic() >= self._forced + SYNC:
                self._force()
        if self._file is not None:
            self._flusher.close(self._file, has_new_name=self._is_new)
        self._flusher.finish()

    def _take(self, batch: bytes) -> None:
        if (error := self._flusher.error()) is not None:
            self._fail(error)
        if self._held and self._held + len(batch) > self._file_size:
            self._rotate()
        if time.monotonic() >= self._looked + LOOK:
            self._look()
        if self._file is None or self._is_full:
            self._lost += len(batch)
            return
        rest = memoryview(batch)
        try:
            while rest:
                written = os.write(self._file, rest)
                self._is_dirty = True
                self._held += written
                self._total += written
                self._recorded += written
                rest = rest[written:]
            self._has_made_room = False
        except OSError as error:
            self._lost += len(rest)
            self._fail(error)

    def _force(self) -> None:
        """Have what was written forced to the disk; not waited for."""
        self._forced = time.monotonic()
        if self._file is not None and self._flusher.force(self._file, has_new_name=self._is_new):
            self._is_new = self._is_dirty = False

    def _rotate(self) -> None:
        """Begin the next file, or go on with the old one where that cannot be."""
        if self._flusher.waiting > UNFORCED:
            return
        try:
            path, file = self._shelf.create()
        except OSError as error:
            self._fail(error)
            return
        if self._file is not None:
            self._flusher.close(self._file, has_new_name=self._is_new)
        self.path, self._file = path, file
        self._held, self._is_new, self._is_dirty, self._is_broken = 0, True, False, False
        self._looked = -LOOK
        _log.info("Recording to %s", path)

    def _look(self) -> None:
        """See what the disk has left, and make room."""
        self._looked = time.monotonic()
        if self._lost == self._lost_before and self._file is not None:
            self._trouble = ""
        self._lost_before = self._lost
        try:
            is_gone = self._file is None or os.fstat(self._file).st_nlink == 0
            if is_gone or self._is_broken:
                self._rotate()
                self._looked = time.monotonic()
            if self._total > self._total_size or not self._held:
                self._total = sum(size for _, size in self._shelf.files())
                self._total -= self._shelf.free(self._total - self._total_size)
            disk = os.statvfs(self._shelf.folder)
            wanted = self._free_space + (SLACK if self._is_full else 0)
            short = wanted - disk.f_bavail * disk.f_frsize
            self._stop_or_go_on(self._shelf.free(short, or_none=True) < short)
        except OSError as error:
            self._fail(error)

    def _stop_or_go_on(self, is_full: bool) -> None:
        if is_full and not self._is_full:
            _log.warning(
                "%s: less than %g MB free, and older recordings of ours could not make room; "
                "nothing is recorded until there is some: record.free_space",
                self._shelf.folder,
                self._free_space / MB,
            )
        elif self._is_full and not is_full:
            _log.info("%s: there is room again; recording goes on", self.path)
        self._is_full = is_full

    def _begin(self) -> None:
        """Open the first file; where that cannot be, it is tried again at each look."""
        self._rotate()
        if self._file is None:
            self._looked = time.monotonic()

    def _fail(self, error: OSError) -> None:
        """Say once per trouble that not all is recorded; plan the way out of it."""
        words = error.strerror or str(error)
        if words != self._trouble and self._file is None:
            _log.warning(
                "record.path: %s: %s; nothing is recorded, and it is tried again every %.0f s; "
                "name a file in a folder that can be written to",
                *(self.path, words, LOOK),
            )
        elif words != self._trouble:
            _log.warning("%s: %s; not all is recorded", self.path, words)
        self._trouble = words
        if error.errno in _NO_ROOM:
            # A quota shows in no count of free space. What was of no use once goes on being so
            if not self._has_made_room:
                self._has_made_room = True
                with suppress(OSError):
                    self._shelf.free(BATCH, or_none=True)
        else:
            self._is_broken = True


class _Wish(NamedTuple):
    file: int
    has_new_name: bool
    is_last: bool
    """Whether the file is then to be closed."""


class Flusher:
    """Takes wishes from one thread, and fulfils them in another, in their order."""

    def __init__(self, force_names: Callable[[], None]) -> None:
        """Start the thread.

        Args:
            force_names: Forces the names in the folder to the disk; may raise OSError.
        """
        self._force_names = force_names
        self._wishes: queue.SimpleQueue[_Wish | None] = queue.SimpleQueue()
        self._errors: queue.SimpleQueue[OSError] = queue.SimpleQueue()
        # Each count has one writer
        self._asked = self._done = 0
        self._begun_s = 0.0
        self._thread = threading.Thread(target=self._run, name="flusher", daemon=True)
        self._thread.start()

    @property
    def waiting(self) -> int:
        """Wishes that are not fulfilled yet."""
        return self._asked - self._done

    @property
    def late_s(self) -> float:
        """Since the wish was taken up that is not fulfilled yet, s; 0: there is none."""
        return time.monotonic() - self._begun_s if self.waiting else 0.0

    def force(self, file: int, *, has_new_name: bool) -> bool:
        """Have an open file forced to the disk, unless the last time has not ended yet."""
        if self.waiting:
            return False
        self._ask(_Wish(file, has_new_name, is_last=False))
        return True

    def close(self, file: int, *, has_new_name: bool) -> None:
        """Have a file forced to the disk and closed; it is not the caller's any more."""
        self._ask(_Wish(file, has_new_name, is_last=True))

    def error(self) -> OSError | None:
        """Give what went wrong since, if anything, once."""
        return None if self._errors.empty() else self._errors.get()

    def finish(self) -> None:
        """End when all is done; does not wait."""
        self._wishes.put(None)

    def join(self, end_s: float) -> None:
        """Wait for the end, or until a time of the monotonic clock, s."""
        self._thread.join(max(end_s - time.monotonic(), 0.0))

    def _ask(self, wish: _Wish) -> None:
        if not self.waiting:
            self._begun_s = time.monotonic()
        self._asked += 1
        self._wishes.put(wish)

    def _run(self) -> None:
        while (wish := self._wishes.get()) is not None:
            self._begun_s = time.monotonic()
            try:
                self._fulfil(wish)
            except OSError as error:
                self._errors.put(error)
            self._done += 1

    def _fulfil(self, wish: _Wish) -> None:
        try:
            os.fdatasync(wish.file)
            if wish.has_new_name:
                self._force_names()
        finally:
            if wish.is_last:
                os.close(wish.file)
