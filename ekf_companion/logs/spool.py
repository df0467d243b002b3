"""Temporary storage for rows: in memory while they are few, else in a file."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError

IN_MEMORY = 1 << 24
"""Bytes up to which the rows stay in memory."""
ON_DISK = "/var/tmp"
"""Folder of the file unless TMPDIR names another: on many boards /tmp is in memory."""


class Spool:
    """Appends rows, and reads any of them back to the bit."""

    def __init__(
        self, width: int, in_memory: int = IN_MEMORY, dtype: npt.DTypeLike = np.float64
    ) -> None:
        """Start empty, for rows of ``width`` numbers of a type."""
        self._file: IO[bytes] = io.BytesIO()
        self._in_memory: int | None = in_memory
        self._size = 0
        self._dtype = np.dtype(dtype)
        self.width = width
        """Numbers in a row."""

    def __len__(self) -> int:
        return self._size

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        """Delete the rows and the file."""
        self._file.close()

    def __del__(self) -> None:
        self._file.close()

    def append(self, rows: npt.NDArray[Any]) -> None:
        """Add rows, shape (n, width).

        Raises:
            LogError: There is no room for the temporary file.
        """
        data = _bytes_of(np.ascontiguousarray(rows, dtype=self._dtype))
        place = self._size * self.width * self._dtype.itemsize
        with _translated():
            if self._in_memory is not None and place + data.nbytes > self._in_memory:
                self._move_to_disk()
            self._file.seek(place)
            self._file.write(data.data)
        self._size += len(rows)

    def read(self, first: int, count: int) -> npt.NDArray[Any]:
        """Return ``count`` rows from ``first`` on, or as many as there are, shape (n, width).

        Raises:
            LogError: The temporary file cannot be read.
        """
        rows = np.empty((min(count, self._size - first), self.width), dtype=self._dtype)
        with _translated():
            self._file.seek(first * self.width * self._dtype.itemsize)
            got = self._file.readinto(_bytes_of(rows))  # type: ignore[attr-defined]
        assert got == rows.nbytes, "what was appended is there"
        return rows

    def blocks(self, count: int) -> Iterator[npt.NDArray[Any]]:
        """Yield all rows in their order, ``count`` at a time."""
        for first in range(0, self._size, count):
            yield self.read(first, count)

    def _move_to_disk(self) -> None:
        file = tempfile.TemporaryFile(dir=folder())  # noqa: SIM115
        file.write(self._file.getbuffer())  # type: ignore[attr-defined]
        self._file, self._in_memory = file, None


def _bytes_of(rows: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return a view of the rows as bytes: a buffer does not allow all column names."""
    return rows.reshape(-1).view(np.uint8) if rows.nbytes else np.empty(0, dtype=np.uint8)


def folder() -> str:
    """Return the folder of temporary files: that of TMPDIR, or one that is on a disk."""
    is_named = tempfile.tempdir is not None or any(map(os.environ.get, ("TMPDIR", "TEMP", "TMP")))
    if not is_named and os.access(ON_DISK, os.W_OK):
        return ON_DISK
    return tempfile.gettempdir()


@contextmanager
def _translated() -> Iterator[None]:
    """Turn an error of the file system into one that names the remedy."""
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{folder()}: the temporary file of a long recording fails: {error.strerror}; "
            "name a roomier folder in the environment variable TMPDIR"
        ) from error
