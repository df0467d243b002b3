"""Writing of estimates to a file of the kind that its suffix names, chunk by chunk."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, cast

import numpy as np

from ekf_companion.errors import LogError, part_of
from ekf_companion.logs.map_time import Label
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, known_rows
from ekf_companion.nav.state import GEODETIC, POSITION, QUATERNION, VELOCITY, Status, Table

STDOUT = Path("-")
"""The name of the standard output."""
STATUS_NAMES = [status.name.lower() for status in Status]
"""Words for ``Status``, by its number."""
WRITERS = {
    ".csv": "csv_writer",
    ".gpx": "gpx_writer",
    ".kml": "kml_writer",
    ".mcap": "mcap_writer",
    ".parquet": "parquet_writer",
    ".tum": "tum_writer",
    ".ulg": "ulog_writer",
}
"""Module by suffix: its class ``Writer`` is imported when it is needed."""
RATES = {".gpx": 5.0, ".kml": 5.0}
"""Default limit on the rows of a kind, Hz: of a track on a map. Other kinds have none."""


LONGEST = 50
"""Characters of a file's name that are used in a temporary name: with more it might be too long."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


class EstimateWriter:
    """A file of estimates."""

    points: int | None = None
    """Points of the track so far; None: this kind has no track."""

    def __init__(self, path: Path) -> None:
        """Open the file and write its header.

        Raises:
            LogError: The file cannot be opened.
        """
        self.path = path
        self._stack = ExitStack()
        self.file = self._stack.enter_context(create(path))
        self._stack.callback(self.finish)  # before the file is closed

    def __enter__(self) -> EstimateWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the end of the file, and close it; after an error, drop it."""
        self._stack.__exit__(kind, error, trace)

    def write(self, table: Table) -> None:
        """Append estimates.

        Raises:
            LogError: This format cannot hold them.
        """
        raise NotImplementedError

    def refuse_times_before_zero(self, table: Table, kind: str) -> None:
        """Refuse estimates with stamps that a kind of file, named with its article, cannot hold.

        Raises:
            LogError: A time is before zero.
        """
        if len(table) and table.stamp_ns.min() < 0:
            raise LogError(
                f"{self.path}: {kind} cannot hold times before zero, which the log has; name a .csv"
            )

    def finish(self) -> None:
        """Write the end of the file."""


def open_writer(path: Path, label: Callable[[], Label] = Label) -> EstimateWriter:
    """Open a file by its suffix; ``-`` is CSV on the standard output.

    Only formats for maps use the label: finding when a log began takes a look at all of it.

    Raises:
        LogError: It cannot be opened.
        MissingPackageError: A package that its kind needs is not installed.
    """
    name = WRITERS[".csv" if path == STDOUT else path.suffix]
    with part_of("formats", str(path)):
        module = import_module(f"ekf_companion.logs.{name}")
    is_map = path.suffix in RATES
    return cast("EstimateWriter", module.Writer(path, label()) if is_map else module.Writer(path))


@contextmanager
def create(path: Path) -> Iterator[BinaryIO]:
    """Open a file to write to; it gets its name once it is complete.

    An interrupted one leaves nothing, and an older file of that name unchanged.

    Raises:
        LogError: It cannot be opened, or there is no room for it.
    """
    if path == STDOUT:
        if sys.stdout is None:
            raise LogError("-: the standard output is closed; name a file")
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    is_plain = path.is_file() or not path.exists()  # a pipe or a device is written as it is
    target = path.with_name(f".{path.name[:LONGEST]}.{os.getpid()}") if is_plain else path
    try:
        file = target.open("wb")
    except OSError as error:
        raise _not_written(path, error) from error
    try:
        with file:
            yield file
        if is_plain:
            _give_name(target, path)
    except BaseException as error:
        if is_plain:
            target.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            raise _not_written(path, error) from error
        raise


def _give_name(target: Path, path: Path) -> None:
    try:
        target.replace(path)
    except OSError as error:  # the older one is another user's, or may not be changed
        raise _not_written(path, error) from error


def _not_written(path: Path, error: OSError) -> LogError:
    older = "; the older file of that name is as it was" if path.is_file() else ""
    return LogError(f"{path}: cannot be written: {error.strerror}{older}")


class Thinning:
    """Keeps the first estimate of each period, chunk after chunk."""

    def __init__(self, rate: float | None) -> None:
        """Keep at most so many per second, Hz; None: all."""
        self._period = None if rate is None else np.int64(round(1e9 / rate))
        self._slot: int | None = None

    def thin(self, table: Table) -> Table:
        """Return the next estimates without those that are left out."""
        if self._period is None or len(table) == 0:
            return table
        slot = table.stamp_ns // self._period
        first = np.diff(slot, prepend=slot[0] - 1 if self._slot is None else self._slot) != 0
        self._slot = int(slot[-1])
        return Table(stamp_ns=table.stamp_ns[first], values=table.values[first])


def with_position(table: Table) -> Table:
    """Return the estimates that have a position, velocity and attitude."""
    known = known_rows(table.columns((*GEODETIC, *POSITION, *VELOCITY, *QUATERNION)))
    return Table(stamp_ns=table.stamp_ns[known], values=table.values[known])


def east_north_up(table: Table) -> tuple[Array, Array]:
    """Return positions east, north, up of the origin, m, and attitudes in that frame.

    The attitudes rotate a body frame of forward, left, up into east, north, up: the frames of ROS
    REP 103, which most viewers expect. Quaternions are (w, x, y, z), shape (n, 4).
    """
    north, east, down = (table.column(name) for name in POSITION)
    return np.stack([east, north, -down], axis=1), so3.to_east_north_up(table.columns(QUATERNION))
