"""Writing of estimates as comma-separated text."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import orjson

from ekf_companion.logs.csv_lines import join_lines
from ekf_companion.logs.writer import STATUS_NAMES, EstimateWriter
from ekf_companion.nav import reason
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import COLUMNS, Table

_STATUS = COLUMNS.index("status") - 1
AT_ONCE = 1024
"""Lines made at a time: their text stays in the processor's cache."""
_NAMES = [name.encode() for name in STATUS_NAMES]


class Writer(EstimateWriter):
    """Writes estimates as CSV, every number with enough digits to be read back to the bit."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.file.write(",".join(COLUMNS).encode() + b"\n")
        self._lines = bytearray()

    def write(self, table: Table) -> None:
        """Append a line for each estimate."""
        for first in range(0, len(table), AT_ONCE):
            rows = slice(first, first + AT_ONCE)
            self._write_lines(table.stamp_ns[rows], table.values[rows])

    def _write_lines(self, stamp_ns: Stamps, values: Array) -> None:
        # JSON prints the shortest digits that read back the same, and does it fast
        numbers = orjson.dumps(
            np.ascontiguousarray(values[:, :_STATUS]), option=orjson.OPT_SERIALIZE_NUMPY
        )
        stamps = orjson.dumps(stamp_ns // 1000, option=orjson.OPT_SERIALIZE_NUMPY)
        ends = list(_ends(values[:, _STATUS : _STATUS + 3].astype(np.int64)))
        size = len(numbers) + len(stamps) + sum(count * len(end) for end, count in ends)
        if size > len(self._lines):
            self._lines = bytearray(size)
        places = array("q", [1, 1, 0])
        for end, count in ends:
            join_lines(numbers, stamps, end, count, self._lines, places)
        self.file.write(memoryview(self._lines)[: places[2]])


def _ends(numbers: npt.NDArray[np.int64]) -> Iterator[tuple[bytes, int]]:
    """Yield the ends of lines, and for how many consecutive lines each holds.

    They hold status, resets and reasons, of shape (n, 3).
    """
    firsts = np.flatnonzero((numbers[1:] != numbers[:-1]).any(axis=1)) + 1
    firsts = np.concatenate([[0], firsts])
    counts = np.diff(firsts, append=len(numbers)).tolist()
    for (status, resets, reasons), count in zip(numbers[firsts].tolist(), counts, strict=True):
        why = reason.names(reasons).encode()
        yield b",%s,%d,%s\n" % (_NAMES[status], resets, why), count
