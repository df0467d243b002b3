"""A log to be estimated from, wherever it is: a file of this machine or an object of a store."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ekf_companion.errors import UnreachableError
from ekf_companion.fleet import remote
from ekf_companion.fleet.folder import printable
from ekf_companion.logs.source import BLOCK


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A log and what its list says of it."""

    place: str = field(repr=False)
    """Path, or URL, which may hold a key or a signature: it is printed nowhere."""
    name: str
    """As tables and messages have it."""
    size: int | None = None
    """Bytes; None: its store does not say."""
    stamp: str = ""
    """Of its content, as its store has it: a time of change or an ETag; empty: not known."""
    about: tuple[tuple[str, str], ...] = ()
    """What a list says of it: column of the table and text."""

    @property
    def key(self) -> str:
        """A text by which an unchanged log is recognised without being read."""
        parts = (self.name, self.size, self.stamp)
        return " ".join(str(one) for one in parts if one not in (None, ""))

    @property
    def mark(self) -> int:
        """The hash of the key, 63 bits."""
        found = hashlib.blake2b(self.key.encode(errors="surrogateescape"), digest_size=8)
        return int.from_bytes(found.digest(), "big") >> 1

    @property
    def weight(self) -> int:
        """Its part of the work, >= 1: its bytes and one more."""
        return (self.size or 0) + 1

    @contextmanager
    def opened(self) -> Iterator[Path]:
        """Yield the path of the log; an object is in a temporary file meanwhile.

        Raises:
            UnreachableError: It cannot be fetched now.
            LogError: It cannot be fetched at all.
        """
        if not remote.is_url(self.place):
            yield Path(self.place)
            return
        with remote.fetched(self.place, self.name) as path:
            yield path


def of_path(path: Path) -> Source:
    """Return a file of this machine, which need not exist."""
    try:
        about = path.stat()
    except OSError:
        return Source(place=str(path), name=printable_name(path))
    return Source(
        place=str(path),
        name=printable_name(path),
        size=about.st_size,
        stamp=str(about.st_mtime_ns),
    )


def printable_name(name: object) -> str:
    """Return the name of a log in a form that no spreadsheet takes for a formula."""
    return printable(f"./{name}" if str(name).lstrip()[:1] in ("=", "+", "-", "@") else name)


def content_of(path: Path) -> str:
    """Return 32 digits of the hash of a file's bytes.

    Raises:
        UnreachableError: It cannot be read.
    """
    found = hashlib.blake2b(digest_size=16)
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                found.update(block)
    except OSError as error:
        raise UnreachableError(f"cannot be read: {error.strerror}") from None
    return found.hexdigest()
