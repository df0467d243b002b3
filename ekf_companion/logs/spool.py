"""Temporary storage for rows of numbers: in memory while they are few, else in a file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.nav.arrays import Array

IN_MEMORY = 1 << 26
"""Bytes up to which no file is made."""


class Spool:
    """Appends rows, and reads any of them back to the bit."""

    def __init__(self, width: int, in_memory: int = IN_MEMORY) -> None:
        """Start empty, for rows of ``width`` numbers."""
        self._file = tempfile.SpooledTemporaryFile(max_size=in_memory)  # noqa: SIM115
        self._width = width
        self._size = 0

    def __len__(self) -> int:
        return self._size

    def __enter__(self) -> Spool:
        return self

    def __exit__(self, *_: object) -> None:
        """Delete the rows and the file."""
        self._file.close()

    def append(self, rows: Array) -> None:
        """Add rows, shape (n, width).

        Raises:
            LogError: There is no room for the temporary file.
        """
        with _translated():
            self._file.seek(self._size * self._width * 8)
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).tobytes())
        self._size += len(rows)

    def read(self, first: int, count: int) -> Array:
        """Return ``count`` rows from ``first`` on, shape (count, width).

        Raises:
            LogError: The temporary file cannot be read.
        """
        with _translated():
            self._file.seek(first * self._width * 8)
            data = self._file.read(count * self._width * 8)
        return np.frombuffer(bytearray(data)).reshape(count, self._width)


@contextmanager
def _translated() -> Iterator[None]:
    """Turn an error of the file system into one that names the remedy."""
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{tempfile.gettempdir()}: the temporary file of the smoother fails: {error.strerror}; "
            "name a roomier folder in the environment variable TMPDIR"
        ) from error
