"""The folder of recordings: which files are ours, how the next is called, which goes first.

A board without a clock begins anew at 1970 or at its last shutdown, so that neither the times of
files nor the times in their names say which is the oldest. A list beside them does: a line for
each file that was begun, in that order.
"""

from __future__ import annotations

import fcntl
import logging
import os
import re
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ekf_companion.config.file_name import check_name

_log = logging.getLogger(__name__)

LIST_SIZE = 1 << 16
"""Bytes of the list beyond which the names of files that are gone are left out."""
_START = "%Y%m%dT%H%M%SZ"


class Shelf:
    """The folder: the next name, the files that are ours, and the oldest of them."""

    def __init__(self, path: str) -> None:
        """Take ``record.path``; ``%s`` becomes now, UTC. Nothing is looked at on the disk.

        Raises:
            ConfigError: It cannot be the name of a file.
        """
        check_name("record.path", path)
        first = Path(path.replace("%s", time.strftime(_START, time.gmtime())))
        self.folder = first.parent
        self._stem, self._suffix = first.stem, first.suffix
        kind = Path(path)
        self._list = self.folder / f".{kind.name}.list"
        self._begun: list[str] = []
        stem, suffix = (
            re.escape(part).replace("%s", r"\d{8}T\d{6}Z") for part in (kind.stem, kind.suffix)
        )
        self._ours = re.compile(rf"{stem}(?:-\d+)?{suffix}", re.ASCII)
        self._has_time = "%s" in kind.name
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
            self._note(path.name)
            return path, descriptor

    def files(self) -> list[tuple[str, int]]:
        """Give the name of each file of ours and its bytes; the oldest first.

        Ours are those in the list, and where the name says the time of start, all of such names:
        they come first, by when they were last written. A name without a time could be anybody's.

        Raises:
            OSError: The folder cannot be read.
        """
        place = {name: k for k, name in enumerate([*self._listed(), *self._begun])}
        found = []
        with os.scandir(self.folder) as entries:
            for entry in entries:
                if entry.name in place or (self._has_time and self._ours.fullmatch(entry.name)):
                    with suppress(FileNotFoundError):
                        status = entry.stat(follow_symlinks=False)
                        if stat.S_ISREG(status.st_mode):
                            order = place.get(entry.name, -1), status.st_mtime_ns
                            found.append((order, entry.name, status.st_size))
        return [(name, size) for _, name, size in sorted(found)]

    def free(self, size: int, *, or_none: bool = False) -> int:
        """Delete our oldest files that nobody writes, until so many bytes are free; give those.

        Args:
            size: Bytes.
            or_none: None is deleted where all of them would be too few: what fills the disk is
                somebody else's, and would still.
        """
        if size <= 0:
            return 0
        found = self.files()
        if or_none and sum(held for name, held in found if self._is_idle(name)) < size:
            return 0
        freed = 0
        for name, held in found:
            if freed >= size:
                break
            with suppress(OSError):
                if self._remove(self.folder / name):
                    _log.info("%s: deleted, the oldest of ours, to make room", self.folder / name)
                    freed += held
        return freed

    def sync(self) -> None:
        """Force our list, and the names in the folder, to the disk.

        A flight usually ends with a loss of power: that it was the last must be known after it.
        """
        with suppress(FileNotFoundError):
            _force(self._list, os.O_RDONLY)
        _force(self.folder, os.O_RDONLY | os.O_DIRECTORY)

    def _note(self, name: str) -> None:
        """Write down that a file was begun; a disk that takes no line still has it in this run."""
        self._begun.append(name)
        try:
            if self._list.exists() and self._list.stat().st_size > LIST_SIZE:
                beside = self._list.with_name(self._list.name + ".new")
                kept = [one for one in self._listed() if (self.folder / one).exists()]
                beside.write_text(
                    "".join(f"{one}\n" for one in kept), encoding="utf-8", errors="surrogateescape"
                )
                beside.replace(self._list)
            with self._list.open("a", encoding="utf-8", errors="surrogateescape") as lines:
                lines.write(f"{name}\n")
        except OSError as error:
            _log.warning("%s: %s; a later run may not know our files", self._list, error.strerror)

    def _listed(self) -> list[str]:
        """Give the names in the list that our name can make, whatever else stands there."""
        try:
            lines = self._list.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
        except OSError:
            return []
        return [line for line in lines if self._ours.fullmatch(line)]

    def _last(self) -> int:
        """Give the largest number behind this run's name that is taken; 0: none."""
        mine = re.compile(rf"{re.escape(self._stem)}(?:-(\d+))?{re.escape(self._suffix)}", re.ASCII)
        with os.scandir(self.folder) as entries:
            taken = [found for entry in entries if (found := mine.fullmatch(entry.name))]
        return max((int(found[1] or 1) for found in taken), default=0)

    def _remove(self, path: Path) -> bool:
        """Delete a file, unless whoever writes it has locked it."""
        with _locked(path) as is_ours:
            if is_ours:
                path.unlink()
            return is_ours

    def _is_idle(self, name: str) -> bool:
        """Whether a file could be deleted."""
        try:
            with _locked(self.folder / name) as is_ours:
                return is_ours
        except OSError:
            return False


@contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Give whether nobody writes a file, and nobody begins to meanwhile.

    Raises:
        OSError: It cannot be opened, or has no locks.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        yield _lock(descriptor)
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _force(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
