"""Columns of numbers in comma-separated text, by the names in the first line."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs.source import read_bytes
from ekf_companion.nav.arrays import Array

KIND = "CSV file"
MOST_COLUMNS = 10_000
"""Beyond, the first line is no header."""


class Table:
    """One file, of which :meth:`read` parses the columns asked for."""

    def __init__(self, path: Path, delimiter: str = ",") -> None:
        """Read the file and its header.

        Raises:
            LogError: The file is missing, empty, not text, or its first line is no header.
        """
        self.path = path
        self._delimiter = delimiter
        data = read_bytes(path, KIND).replace(b"\r\n", b"\n")
        head, _, self._body = data.partition(b"\n")
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
        if not body.strip() or not names:
            return {name: np.zeros(0) for name in names}
        try:
            numbers = np.loadtxt(
                io.BytesIO(body),
                delimiter=self._delimiter,
                usecols=[self.names.index(name) for name in names],
                comments=None,
                encoding="latin-1",
                ndmin=2,
            )
        except ValueError as error:
            raise LogError(
                f"{self.path}: {error}, counted from the line after the header; "
                "mend or remove that line"
            ) from None
        return dict(zip(names, numbers.T.copy(), strict=True))

    def _whole_lines(self) -> bytes:
        """Return the lines below the header, empty cells filled with nan."""
        body, mark = self._body, self._delimiter.encode()
        last = body.rfind(b"\n", 0, len(body)) + 1
        # A line without its end may have lost the end of its last number too.
        if body[last:].count(mark) < len(self.names) - 1:
            body = body[:last]
        elif last < len(body):
            body += b"\n"
        body = body.replace(b" ", b"").replace(b'"', b"")
        for _ in range(2):  # twice: of ",,," the first pass fills every other cell
            body = body.replace(mark + mark, mark + b"nan" + mark)
        body = body.replace(mark + b"\n", mark + b"nan\n").replace(b"\n" + mark, b"\nnan" + mark)
        return b"nan" + body if body.startswith(mark) else body
