"""Rows of numbers put aside for a while: in memory while they are few, else in a temporary file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError

Array = npt.NDArray[np.float64]

IN_MEMORY = 1 << 26
"""Bytes up to which no file is made."""


class Spool:
    """Takes rows at its end, and gives any of them back to the bit."""

    def __init__(self, width: int, in_memory: int = IN_MEMORY) -> None:
        """Begin without rows; they will have so many numbers each."""
        self._file = tempfile.SpooledTemporaryFile(max_size=in_memory)  # noqa: SIM115
        self._width = width
        self._size = 0

    def __len__(self) -> int:
        """Give the number of rows."""
        return self._size

    def __enter__(self) -> Spool:
        """Give the spool."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Forget the rows; the file, if there was one, is gone."""
        self._file.close()

    def append(self, rows: Array) -> None:
        """Add rows, shape (n, width).

        Raises:
            LogError: There is no room for the temporary file.
        """
        with _sentence():
            self._file.seek(self._size * self._width * 8)
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).tobytes())
        self._size += len(rows)

    def read(self, first: int, count: int) -> Array:
        """Give rows from one on, shape (count, width).

        Raises:
            LogError: The temporary file cannot be read.
        """
        with _sentence():
            self._file.seek(first * self._width * 8)
            data = self._file.read(count * self._width * 8)
        return np.frombuffer(bytearray(data)).reshape(count, self._width)


@contextmanager
def _sentence() -> Iterator[None]:
    """Say what to do where the file system fails."""
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{tempfile.gettempdir()}: the temporary file of the smoother fails: {error.strerror}; "
            "name a roomier folder in the environment variable TMPDIR"
        ) from error
