"""The folder of recordings: which files are ours, the next name, and which is deleted first.

A board without a clock starts in 1970, or at its last shutdown, so that neither the times of files
nor the times in their names show which is the oldest. A list beside them does: it has a line for
each file that was begun, in that order.
"""

from __future__ import annotations

import fcntl
import logging
import os
import re
import stat
import time
from contextlib import suppress
from pathlib import Path

from ekf_companion.config.file_name import check_name
from ekf_companion.daemon.checkpoint_file import sync

_log = logging.getLogger(__name__)

LIST_SIZE = 1 << 16
"""Bytes of the list beyond which the names of files that are gone are left out."""
_TIME_FORMAT = "%Y%m%dT%H%M%SZ"
_TIME_PATTERN = r"\d{8}T\d{6}Z"


class TlogFolder:
    """The folder of recordings, of which other files may be in it too."""

    def __init__(self, path: str) -> None:
        """Read ``record.path``, where ``%s`` becomes now, UTC; the disk is not touched.

        Raises:
            ConfigError: No file can have that name.
        """
        check_name("record.path", path)
        started = time.strftime(_TIME_FORMAT, time.gmtime())
        kind, first = Path(path), Path(path.replace("%s", started))
        self.path = first.parent
        self._stem, self._suffix = first.stem, first.suffix
        self._has_time = "%s" in kind.name
        stem, suffix = (
            re.escape(part).replace("%s", _TIME_PATTERN) for part in (kind.stem, kind.suffix)
        )
        self._ours = re.compile(rf"{stem}(?:-\d+)?{suffix}", re.ASCII)
        self._list = self.path / f".{kind.name}.list"
        self._begun: list[str] = []
        self._number = 0

    def create(self) -> tuple[Path, int]:
        """Open a new file of the next free number; return its path and descriptor.

        Raises:
            OSError: It cannot be opened.
        """
        self._number = self._number or self._largest_number()
        while True:
            self._number += 1
            mark = f"-{self._number}" if self._number > 1 else ""
            path = self.path / f"{self._stem}{mark}{self._suffix}"
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
            with suppress(FileExistsError):
                descriptor = os.open(path, flags, 0o640)
                break
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._add_to_list(path.name)
        return path, descriptor

    def files(self) -> list[tuple[Path, int]]:
        """Return path and size of each file of ours, the oldest first.

        Ours are those in the list, and, if the name contains the time of start, all of such names:
        they come first, by when they were last written. A name without a time could be anybody's.

        Raises:
            OSError: The folder cannot be read.
        """
        order = {name: k for k, name in enumerate([*self._listed(), *self._begun])}
        found = []
        for name in os.listdir(self.path):
            if name in order or (self._has_time and self._ours.fullmatch(name)):
                with suppress(FileNotFoundError):
                    status = os.lstat(self.path / name)
                    if stat.S_ISREG(status.st_mode):
                        found.append(
                            (order.get(name, -1), status.st_mtime_ns, name, status.st_size)
                        )
        return [(self.path / name, size) for _, _, name, size in sorted(found)]

    def free(self, size: int, *, or_none: bool = False) -> int:
        """Delete our oldest files, except those being written; return the bytes freed.

        Args:
            size: Bytes to free; at 0 nothing is looked at.
            or_none: Delete nothing if all of our files together are too small: others fill the
                disk, and would go on.

        Raises:
            OSError: The folder cannot be read.
        """
        if size <= 0:
            return 0
        idle = [(path, held) for path, held in self.files() if _is_idle(path)]
        if or_none and sum(held for _, held in idle) < size:
            return 0
        freed = 0
        for path, held in idle:
            if freed < size:
                with suppress(OSError):
                    path.unlink()
                    freed += held
                    _log.info("%s: deleted to make room, as the oldest of ours", path)
        return freed

    def sync(self) -> None:
        """Force our list, and the names in the folder, to the disk.

        Raises:
            OSError: The disk fails.
        """
        with suppress(FileNotFoundError):
            sync(self._list)
        sync(self.path)

    def _add_to_list(self, name: str) -> None:
        """Add a file to the list; if the disk fails, only this run knows it."""
        self._begun.append(name)
        new = self._list.with_name(self._list.name + ".new")
        try:
            if self._list.exists() and self._list.stat().st_size > LIST_SIZE:
                kept = [one for one in self._listed() if (self.path / one).exists()]
                new.write_bytes(os.fsencode("".join(f"{one}\n" for one in kept)))
                new.replace(self._list)
            with self._list.open("ab") as lines:
                lines.write(os.fsencode(f"{name}\n"))
        except OSError as error:
            with suppress(OSError):
                new.unlink()
            _log.warning("%s: %s; a later run may not know our files", self._list, error.strerror)

    def _listed(self) -> list[str]:
        """Return the names in the list, but only those that ``record.path`` can make."""
        try:
            lines = os.fsdecode(self._list.read_bytes()).splitlines()
        except OSError:
            return []
        return [line for line in lines if self._ours.fullmatch(line)]

    def _largest_number(self) -> int:
        """Return the largest number behind this run's name that is taken; 0 if none is."""
        mine = re.compile(rf"{re.escape(self._stem)}(?:-(\d+))?{re.escape(self._suffix)}", re.ASCII)
        taken = [found for name in os.listdir(self.path) if (found := mine.fullmatch(name))]
        return max((int(found[1] or 1) for found in taken), default=0)


def _is_idle(path: Path) -> bool:
    """Return whether nobody writes a file: a writer locks it."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC
    with suppress(OSError), open(os.open(path, flags), "rb", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
