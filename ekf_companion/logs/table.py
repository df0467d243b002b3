"""Columns of numbers in comma-separated text, by the names in the first line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.source import MappedFile
from ekf_companion.logs.spool import Spool
from ekf_companion.nav.arrays import Array

KIND = "CSV file"
MOST_COLUMNS = 10_000
"""Largest number of columns; with more, the first line is not a header."""
SMALL = 1 << 20
"""Size, bytes, below which reading a table takes less time than importing Arrow."""
LONGEST_LINE = 1 << 20
"""Bytes of a line, at most: 10 000 columns of a hundred."""
BLOCK = 1 << 21
"""Bytes that Arrow reads at a time."""
AT_ONCE = 1 << 14
"""Rows that are taken out of the temporary storage at a time."""


class Table:
    """One file, of which :meth:`read` and :meth:`spool` parse the columns asked for."""

    def __init__(self, path: Path, delimiter: str = ",") -> None:
        """Read the file and its header.

        Raises:
            LogError: The file is missing, empty, not text, or its first line is no header.
        """
        self.path = path
        self._delimiter = delimiter
        self._file = MappedFile(path, KIND)
        self.notes = self._file.notes
        """What is to be said of the file itself."""
        head, _, _ = bytes(self._file.data[:LONGEST_LINE]).partition(b"\n")
        self._body = self._file.data[len(head) + 1 :]
        head = head.removesuffix(b"\r")
        if (count := head.count(delimiter.encode()) + 1) > MOST_COLUMNS:
            raise LogError(
                f"{path}: the first line has {count} columns, so it is no header (at most "
                f"{MOST_COLUMNS}); check the file or its name"
            )
        try:
            line = head.decode("utf-8-sig")
            cells = next(csv.reader([line], delimiter=delimiter), [])
        except (UnicodeDecodeError, csv.Error):
            raise LogError(f"{path}: not text, so no {KIND}; check the file or its name") from None
        if "\0" in line:
            raise LogError(f"{path}: not text, so no {KIND}; check the file or its name")
        self.names = [cell.strip() for cell in cells]
        """Column names in their order."""

    def read(self, names: Sequence[str]) -> dict[str, Array]:
        """Return columns by name, float64, all of one length; an empty cell is NaN.

        A last line that was cut short is left out.

        Raises:
            LogError: A column is absent or named twice, a cell is no number, a line is too short.
        """
        with self.spool(names) as spool:
            columns = {name: np.empty(len(spool)) for name in names}
            first = 0
            for rows in spool.blocks(AT_ONCE):
                for column, numbers in zip(columns.values(), rows.T, strict=True):
                    column[first : first + len(rows)] = numbers
                first += len(rows)
        return columns

    def spool(self, names: Sequence[str]) -> Spool:
        """Store columns as rows, in the order of the names, else as :meth:`read` does.

        Raises:
            LogError: As :meth:`read`; there is no room for a temporary file.
        """
        for name in names:
            if self.names.count(name) != 1:
                what = "no" if name not in self.names else "more than one"
                raise LogError(
                    f"{self.path}: {what} column {name!r}; there are: {', '.join(self.names)}"
                )
        body = self._whole_lines()
        self._check_lines(body)
        if not names:
            return Spool(0)
        where = [self.names.index(name) for name in names]
        spool = _spool_columns(body, self._delimiter, len(self.names), where, self._file)
        if spool is None:
            spool = Spool(len(names))
            spool.append(self._read_rows(body, where))
        return spool

    def _check_lines(self, body: memoryview) -> None:
        """Refuse a line that no table has, which would be in memory several times.

        Raises:
            LogError: There is one.
        """
        for place in range(0, len(body) - LONGEST_LINE, LONGEST_LINE):
            if b"\n" not in bytes(body[place : place + LONGEST_LINE]):
                raise LogError(
                    f"{self.path}: a line is longer than {LONGEST_LINE >> 20} MiB, so it is no "
                    "table; check the file or its name"
                )

    def _whole_lines(self) -> memoryview:
        """Return the lines below the header, without a last one that was cut short."""
        body, mark = self._body, self._delimiter.encode()
        tail = bytes(body[-LONGEST_LINE:])
        last = tail.rfind(b"\n") + 1
        # A line without its end may have lost the end of its last number too.
        if last < len(tail) and tail[last:].count(mark) < len(self.names) - 1:
            return body[: len(body) - len(tail) + last]
        return body

    def _read_rows(self, body: memoryview, where: Sequence[int]) -> Array:
        """Return columns as rows; the reader reports which line is wrong, and how.

        Raises:
            LogError: A cell is no number, or a line is too short.
        """
        if not any(line.strip() for line in self._lines(body)):
            return np.zeros((0, len(where)))
        try:
            rows: Array = np.loadtxt(
                self._lines(body),
                delimiter=self._delimiter,
                usecols=where,
                comments=None,
                encoding="latin-1",
                ndmin=2,
            )
        except ValueError as error:
            raise LogError(
                f"{self.path}: {error}, counted from the line after the header; "
                "mend or remove that line"
            ) from None
        return rows

    def _lines(self, body: memoryview) -> Iterator[bytes]:
        """Yield lines without what is no number; an empty cell becomes NaN."""
        mark = self._delimiter.encode()
        place = 0
        while place < len(body):
            block = bytes(body[place : place + BLOCK])
            block = block[: block.rfind(b"\n") + 1] or block
            place += len(block)
            block = block.replace(b"\r\n", b"\n").replace(b" ", b"").replace(b'"', b"")
            block += b"" if block.endswith(b"\n") else b"\n"
            for _ in range(2):  # twice: of ",,," the first pass fills every other cell
                block = block.replace(mark + mark, mark + b"nan" + mark)
            block = block.replace(mark + b"\n", mark + b"nan\n")
            block = block.replace(b"\n" + mark, b"\nnan" + mark)
            yield from io.BytesIO(b"nan" + block if block.startswith(mark) else block)


def _spool_columns(
    body: memoryview, delimiter: str, width: int, where: Sequence[int], file: MappedFile
) -> Spool | None:
    """Store columns by their numbers; None: the table is small, or its lines differ in width.

    Arrow reads a large table ten times as fast as numpy, and to the same bits.
    """
    if len(body) < SMALL:
        return None
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ImportError:
        return None
    labels = [str(index) for index in range(width)]
    used = [labels[index] for index in where]
    spool = Spool(len(where))
    try:
        with csv.open_csv(
            pa.BufferReader(pa.py_buffer(body)),
            read_options=csv.ReadOptions(column_names=labels, block_size=BLOCK),
            parse_options=csv.ParseOptions(delimiter=delimiter),
            convert_options=csv.ConvertOptions(
                include_columns=used,
                column_types=dict.fromkeys(used, pa.float64()),
                null_values=[""],
                check_utf8=False,
            ),
        ) as reader:
            for batch in reader:
                rows = np.empty((batch.num_rows, len(where)))
                for into, column in zip(rows.T, batch.columns, strict=True):
                    _copy(column, into)
                spool.append(rows)
                file.release()
    except pa.ArrowInvalid:
        spool.__exit__()
        return None
    finally:
        pa.default_memory_pool().release_unused()
    return spool


def _copy(column: Any, into: Array) -> None:
    """Copy a column of Arrow, with NaN where it has no number."""
    bits, data = column.buffers()
    first, end = column.offset, column.offset + len(column)
    numbers = np.frombuffer(data, dtype=np.float64, count=end)[first:]
    if not column.null_count:
        into[:] = numbers
        return
    known = np.unpackbits(np.frombuffer(bits, dtype=np.uint8), count=end, bitorder="little")
    into[:] = np.nan
    np.copyto(into, numbers, where=known[first:].view(np.bool_))
