"""The rows of one table of a log: in memory while they are few, else in a temporary file."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from ekf_companion.logs.spool import Spool
from ekf_companion.nav.arrays import Mask

Column = npt.NDArray[np.void]
IN_MEMORY = 1 << 22
"""Bytes of a table up to which no file is made: a log has twenty tables."""
AT_ONCE = 1 << 14
"""Rows that are read at a time."""


class StoredRows:
    """Appends rows of one type, and reads them part by part."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        """Start empty."""
        self.dtype = dtype
        """Of the rows."""
        self._spool = Spool(1, IN_MEMORY, dtype)

    def __len__(self) -> int:
        return len(self._spool)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.dtype.names or ()

    def append(self, rows: Column) -> None:
        """Add rows.

        Raises:
            LogError: There is no room for the temporary file.
        """
        self._spool.append(rows)

    def read(self, first: int, end: int) -> Column:
        """Return the rows from one number to before another, or to the end."""
        return self._spool.read(first, end - first)[:, 0]

    def parts(self) -> Iterator[tuple[int, Column]]:
        """Yield all rows in their order, part by part, each after the number of its first row."""
        for first in range(0, len(self), AT_ONCE):
            yield first, self.read(first, first + AT_ONCE)

    def all(self) -> Column:
        """Return all rows."""
        return self.read(0, len(self))

    def kept(self, keep: Callable[[int, Column], Mask]) -> StoredRows:
        """Return the rows for which a function, called with each of :meth:`parts`, is true."""
        if all(keep(first, rows).all() for first, rows in self.parts()):
            return self
        found = StoredRows(self.dtype)
        for first, rows in self.parts():
            found.append(rows[keep(first, rows)])
        return found
