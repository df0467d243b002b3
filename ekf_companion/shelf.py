"""The folder of recordings: which files are ours, how the next is called, which goes first."""

from __future__ import annotations

import fcntl
import logging
import os
import re
import stat
import time
from contextlib import suppress
from pathlib import Path

_log = logging.getLogger(__name__)

_START = "%Y%m%dT%H%M%SZ"


class Shelf:
    """The folder: the next name, the files that are ours, and the oldest of them."""

    def __init__(self, path: str) -> None:
        """Take ``record.path``; ``%s`` becomes now, UTC."""
        first = Path(path.replace("%s", time.strftime(_START, time.gmtime())))
        self.folder = first.parent
        self._stem, self._suffix = first.stem, first.suffix
        kind = Path(path)
        stem, suffix = (
            re.escape(part).replace("%s", r"\d{8}T\d{6}Z") for part in (kind.stem, kind.suffix)
        )
        self._ours = re.compile(rf"{stem}(?:-\d+)?{suffix}", re.ASCII)
        self._number = 0

    def create(self) -> tuple[Path, int]:
        """Open a new file of the next number that is free; give its path and descriptor.

        Raises:
            OSError: It cannot be opened.
        """
        self._number = self._number or self._last()
        while True:
            number = self._number + 1
            mark = f"-{number}" if number > 1 else ""
            path = self.folder / f"{self._stem}{mark}{self._suffix}"
            try:
                descriptor = os.open(
                    path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC, 0o640
                )
            except FileExistsError:
                self._number = number
                continue
            self._number = number
            with suppress(OSError):  # not every file system has locks
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return path, descriptor

    def files(self) -> list[tuple[int, str, int]]:
        """Give when each file of ours was last written, ns, its name and its bytes; oldest first.

        Raises:
            OSError: The folder cannot be read.
        """
        found = []
        with os.scandir(self.folder) as entries:
            for entry in entries:
                if self._ours.fullmatch(entry.name):
                    with suppress(FileNotFoundError):
                        status = entry.stat(follow_symlinks=False)
                        if stat.S_ISREG(status.st_mode):
                            found.append((status.st_mtime_ns, entry.name, status.st_size))
        return sorted(found)

    def free(self, size: int) -> int:
        """Delete our oldest files that nobody writes, until so many bytes are free; give those."""
        freed = 0
        for _, name, held in self.files() if size > 0 else ():
            if freed >= size:
                break
            with suppress(OSError):
                if self._remove(self.folder / name):
                    _log.info("%s: deleted, the oldest of ours, to make room", self.folder / name)
                    freed += held
        return freed

    def sync(self) -> None:
        """Force the names in the folder to the disk."""
        descriptor = os.open(self.folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def _last(self) -> int:
        """Give the largest number behind this run's name that is taken; 0: none."""
        mine = re.compile(rf"{re.escape(self._stem)}(?:-(\d+))?{re.escape(self._suffix)}", re.ASCII)
        with os.scandir(self.folder) as entries:
            taken = [found for entry in entries if (found := mine.fullmatch(entry.name))]
        return max((int(found[1] or 1) for found in taken), default=0)

    def _remove(self, path: Path) -> bool:
        """Delete a file, unless whoever writes it has locked it."""
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
        except BlockingIOError:
            return False
        finally:
            os.close(descriptor)
        return True
