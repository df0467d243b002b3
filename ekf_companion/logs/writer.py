"""Writing of estimates to a CSV file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np
import orjson

from ekf_companion.errors import LogError
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import COLUMNS, Status

_STATUS = COLUMNS.index("status") - 1
_NAMES = [status.name.lower().encode() for status in Status]


@contextmanager
def create(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write to; it has its name once it is complete.

    What is interrupted leaves nothing, and an older file of that name as it was.

    Raises:
        LogError: It cannot be opened.
    """
    is_plain = path.is_file() or not path.exists()  # a pipe or /dev/stdout is written as it is
    target = path.with_name(f".{path.name}.{os.getpid()}") if is_plain else path
    try:
        file = target.open("wb")
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        with file:
            yield file
        if is_plain:
            target.replace(path)
    except BaseException:
        if is_plain:
            target.unlink(missing_ok=True)
        raise


class CsvWriter:
    """Writes estimates as CSV, every number with enough digits to be read back to the bit."""

    def __init__(self, path: Path) -> None:
        """Open the file and write the header.

        Raises:
            LogError: The file cannot be opened.
        """
        self._stack = ExitStack()
        self._file = self._stack.enter_context(create(path))
        self._file.write(",".join(COLUMNS).encode() + b"\n")

    def __enter__(self) -> CsvWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file; after an error there is none."""
        self._stack.__exit__(kind, error, trace)

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
