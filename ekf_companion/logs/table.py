"""Columns of numbers in comma-separated text, by the names in the first line."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.source import MappedFile
from ekf_companion.nav.arrays import Array

KIND = "CSV file"
MOST_COLUMNS = 10_000
"""Beyond, the first line is no header."""
SMALL = 1 << 20
"""Bytes below which a table is read sooner than Arrow is imported."""
LONGEST_LINE = 1 << 20
"""Bytes of the first and last line that are looked at."""
BLOCK = 1 << 22
"""Bytes that Arrow reads at once."""


class Table:
    """One file, of which :meth:`read` parses the columns asked for."""

    def __init__(self, path: Path, delimiter: str = ",") -> None:
        """Read the file and its header.

        Raises:
            LogError: The file is missing, empty, not text, or its first line is no header.
        """
        self.path = path
        self._delimiter = delimiter
        self._file = MappedFile(path, KIND)
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
        for name in names:
            if self.names.count(name) != 1:
                what = "no" if name not in self.names else "more than one"
                raise LogError(
                    f"{self.path}: {what} column {name!r}; there are: {', '.join(self.names)}"
                )
        body = self._whole_lines()
        if not names:
            return {}
        where = [self.names.index(name) for name in names]
        columns = _read_columns(body, self._delimiter, len(self.names), where, self._file)
        if columns is None:
            columns = [*self._read_rows(bytes(body), where)]
        return dict(zip(names, columns, strict=True))

    def _whole_lines(self) -> memoryview:
        """Return the lines below the header, without a last one that was cut short."""
        body, mark = self._body, self._delimiter.encode()
        tail = bytes(body[-LONGEST_LINE:])
        last = tail.rfind(b"\n") + 1
        # A line without its end may have lost the end of its last number too.
        if last < len(tail) and tail[last:].count(mark) < len(self.names) - 1:
            return body[: len(body) - len(tail) + last]
        return body

    def _read_rows(self, body: bytes, where: Sequence[int]) -> Array:
        """Return columns by their numbers, by a reader that says what is wrong in which line.

        Raises:
            LogError: A cell is no number, or a line is too short.
        """
        mark = self._delimiter.encode()
        body = body.replace(b"\r\n", b"\n").replace(b" ", b"").replace(b'"', b"")
        if not body.strip():
            return np.zeros((len(where), 0))
        body += b"" if body.endswith(b"\n") else b"\n"
        for _ in range(2):  # twice: of ",,," the first pass fills every other cell
            body = body.replace(mark + mark, mark + b"nan" + mark)
        body = body.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
        body = b"nan" + body if body.startswith(mark) else body
        try:
            numbers = np.loadtxt(
                io.BytesIO(body),
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
        columns: Array = numbers.T.copy()
        return columns


def _read_columns(
    body: memoryview, delimiter: str, width: int, where: Sequence[int], file: MappedFile
) -> list[Array] | None:
    """Return columns by their numbers; None if the table is small, or not of one width throughout.

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
    grown = _GrowingColumns(len(used))
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
                grown.append([one.to_numpy(zero_copy_only=False) for one in batch.columns], body)
                file.release()
    except pa.ArrowInvalid:
        return None
    return grown.columns()


class _GrowingColumns:
    """Columns that grow in place: room that is not used yet takes no memory."""

    def __init__(self, count: int) -> None:
        self._columns: list[Array] = [np.empty(0)] * count
        self._size = 0

    def append(self, columns: Sequence[Array], body: memoryview) -> None:
        """Append the columns of a block of the body."""
        first, self._size = self._size, self._size + len(columns[0])
        if self._size > len(self._columns[0]):
            # As many rows as the file will have if all blocks are like this one, and more
            blocks = len(body) / BLOCK + 1.0
            room = int(max(1.5 * blocks * len(columns[0]), 1.5 * self._size))
            for index, column in enumerate(self._columns):
                self._columns[index] = np.empty(room)
                self._columns[index][:first] = column[:first]
        for into, column in zip(self._columns, columns, strict=True):
            into[first : self._size] = column

    def columns(self) -> list[Array]:
        """Return the columns."""
        return [column[: self._size] for column in self._columns]
