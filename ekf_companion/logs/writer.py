"""Writing of estimates to a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import numpy as np
import orjson

from ekf_companion.errors import LogError
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import COLUMNS, Status

_STATUS = COLUMNS.index("status") - 1
_NAMES = [status.name.lower().encode() for status in Status]


def create(path: Path) -> BinaryIO:
    """Open a file to write to.

    Raises:
        LogError: It cannot be opened.
    """
    try:
        return path.open("wb")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


class CsvWriter:
    """Writes estimates as CSV, every number with enough digits to be read back to the bit."""

    def __init__(self, path: Path) -> None:
        """Open the file and write the header.

        Raises:
            LogError: The file cannot be opened.
        """
        self._file = create(path)
        self._file.write(",".join(COLUMNS).encode() + b"\n")

    def __enter__(self) -> CsvWriter:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def write(self, stamp_ns: Stamps, values: Array) -> None:
        """Append estimates: stamps, shape (n,), and the columns after the time, shape (n, 33)."""
        if len(stamp_ns) == 0:
            return
        # JSON prints the shortest digits that read back the same, and does it fast
        text = orjson.dumps(
            np.ascontiguousarray(values[:, :_STATUS]), option=orjson.OPT_SERIALIZE_NUMPY
        )
        bodies = text[2:-2].replace(b"null", b"").split(b"],[")
        times = orjson.dumps(stamp_ns // 1000, option=orjson.OPT_SERIALIZE_NUMPY)[1:-1].split(b",")
        names = [_NAMES[status] for status in values[:, _STATUS].astype(int).tolist()]
        resets = values[:, _STATUS + 1].astype(int).tolist()
        lines = [b"%s,%s,%s,%d\n" % line for line in zip(times, bodies, names, resets, strict=True)]
        self._file.write(b"".join(lines))
