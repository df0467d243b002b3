"""The tables of a fleet: a Parquet data set of logs, events and histograms, in a folder or a store.

Workers write a part per log and table, ``TABLE/version=V/config=C/KEY.parquet``. A key is the hash
of a log's name, stamp and content, so a task that runs twice writes the same file, and a file that
is there is never written again. The part of ``logs`` comes last: with it a log is done. When a run
ends, the parts are packed, many logs to a file whose name is the hash of theirs; what is loaded
counts each log once, whatever was interrupted.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from ekf_companion.errors import LogError, part_of
from ekf_companion.fleet import remote
from ekf_companion.fleet.observations import EVENTS, HISTOGRAMS
from ekf_companion.fleet.row import COLUMNS, Row

KEYS: Mapping[str, type] = {
    "key": str,
    "mark": int,
    "content": str,
    "version": str,
    "config": str,
    "settings": str,
}
"""Columns of ``logs`` before those of a row: what the row is of. ``key`` names log and content,
``mark`` the log's name, size and stamp, ``settings`` what of the configuration is no default."""
OF_LOG: Mapping[str, type] = {"key": str, "log": str, "version": str, "config": str}
TABLES: Mapping[str, Mapping[str, type]] = {
    "logs": {**KEYS, **COLUMNS},
    "events": {**OF_LOG, **EVENTS},
    "histograms": {**OF_LOG, **HISTOGRAMS},
}
"""Columns and types of each table."""
PACKED = "pack-"
"""Begins the name of a file of many logs."""
PER_PACK = 512
"""Logs of a packed file."""


@dataclass(frozen=True, slots=True)
class Partition:
    """Where the results of one version and configuration are."""

    place: str = field(repr=False)
    """Folder or URL of the data set."""
    version: str
    config: str
    settings: str = ""

    def folder(self, table: str) -> str:
        """Return the folder of a table's files."""
        return f"{self.place.rstrip('/')}/{table}/version={self.version}/config={self.config}"


def is_place(name: str) -> bool:
    """Return whether an output is a data set: a URL, or a folder that is there or ends with /."""
    return remote.is_url(name) or name.endswith("/") or Path(name).is_dir()


def key_of(name: str, content: str) -> str:
    """Return the hash of a log's name and content, 32 digits."""
    text = f"{name}\0{content}".encode(errors="backslashreplace")
    return hashlib.blake2b(text, digest_size=16).hexdigest()


def write_log(
    into: Partition,
    row: Row,
    mark: int,
    content: str,
    events: Iterable[Mapping[str, object]] = (),
    histograms: Iterable[Mapping[str, object]] = (),
) -> None:
    """Write the parts of one log, unless they are there.

    Raises:
        LogError: They cannot be written.
    """
    key = key_of(str(row["log"]), content)
    of_log = {"key": key, "log": row["log"], "version": into.version, "config": into.config}
    rows = {**of_log, "mark": mark, "content": content, "settings": into.settings, **row}
    name = key_of(key, str(mark))
    for table, found in (
        ("events", [{**of_log, **one} for one in events]),
        ("histograms", [{**of_log, **one} for one in histograms]),
        ("logs", [rows]),
    ):
        if found:
            _write(f"{into.folder(table)}/{name}.parquet", _arrow(table, found))


def is_written(into: Partition, name: str, mark: int, content: str) -> bool:
    """Return whether the parts of a log are there."""
    file = f"{key_of(key_of(name, content), str(mark))}.parquet"
    with opened(into.folder("logs")) as (system, folder):
        return bool(system.exists(f"{folder}/{file}"))


def marks(into: Partition) -> set[int]:
    """Return the marks of the logs that are done, of 64 bits each.

    Raises:
        LogError: A file of the data set cannot be read.
    """
    found: set[int] = set()
    for _, table in read_files(into.folder("logs"), ["mark"]):
        found.update(table.column("mark").to_pylist())
    return found


def loose(into: Partition) -> Iterator[list[str]]:
    """Yield the names of the files that are not packed, so many together as a pack has."""
    with opened(into.folder("logs")) as (system, folder):
        names = iter(sorted(one for one in _files(system, folder) if not one.startswith(PACKED)))
    while some := list(islice(names, PER_PACK)):
        yield some


def pack(names: Sequence[str], into: Partition) -> None:
    """Write files of one log each as one, and delete them then.

    Raises:
        LogError: A file cannot be read or written.
    """
    import pyarrow as pa

    name = f"{PACKED}{hashlib.blake2b(' '.join(names).encode(), digest_size=16).hexdigest()}"
    for table in reversed(tuple(TABLES)):
        parts, keys = [], set[str]()
        for _, part in read_files(into.folder(table), None, names):
            # A log that was only touched has two rows, for their marks, and its events once
            fresh = {*part.column("key").to_pylist()} - keys
            if fresh if table != "logs" else len(part):
                parts.append(part)
                keys |= fresh
        if parts:
            _write(f"{into.folder(table)}/{name}.parquet", pa.concat_tables(parts))
    for table in TABLES:
        with opened(into.folder(table)) as (system, folder):
            there = {*_files(system, folder)}
            if gone := [f"{folder}/{one}" for one in names if one in there]:
                system.rm(gone)


def read_files(
    folder: str, columns: Sequence[str] | None, names: Sequence[str] | None = None
) -> Iterator[tuple[str, Any]]:
    """Yield the name and the content of each Parquet file of a folder, or of those that are named.

    Raises:
        LogError: One cannot be read, or is no table of a fleet.
    """
    with part_of("fleet", remote.shown(folder) if remote.is_url(folder) else folder):
        import pyarrow as pa
        from pyarrow import parquet
    with opened(folder) as (system, inner):
        there = sorted(_files(system, inner))
        wanted = there if names is None else sorted({*there} & {*names})
        for name in wanted:
            where = f"{shown(folder)}/{name}"
            with opened(folder), system.open(f"{inner}/{name}", "rb") as file:
                data = file.read()
            try:
                yield name, parquet.read_table(io.BytesIO(data), columns=columns, partitioning=None)
            except (pa.ArrowException, OSError, ValueError, KeyError) as error:
                raise LogError(
                    f"{where}: is no table of a fleet, or is damaged ({type(error).__name__}); "
                    "move it away, and the next run writes it again"
                ) from None


def shown(place: str) -> str:
    """Return a folder, or a URL without its secrets."""
    return remote.shown(place) if remote.is_url(place) else place


@contextmanager
def opened(place: str) -> Iterator[tuple[Any, str]]:
    """Yield the file system of a folder or URL, and the path there; errors become sentences."""
    if remote.is_url(place):
        with remote.sentences(remote.shown(place)):
            yield remote.file_system(place)
        return
    with part_of("fleet", place):
        from fsspec.implementations.local import LocalFileSystem
    try:
        yield LocalFileSystem(auto_mkdir=True), str(Path(place).absolute())
    except OSError as error:
        raise LogError(f"{place}: cannot be read or written: {error.strerror or error}") from None


def _files(system: Any, folder: str) -> list[str]:
    system.invalidate_cache()
    if not system.exists(folder):
        return []
    found = (str(one).rpartition("/")[2] for one in system.ls(folder, detail=False))
    return [one for one in found if one.endswith(".parquet")]


def schema(table: str) -> Any:
    """Return the schema of a table."""
    import pyarrow as pa

    types = {str: pa.string(), int: pa.int64(), float: pa.float64(), list: pa.list_(pa.int64())}
    return pa.schema([(name, types[kind]) for name, kind in TABLES[table].items()])


def _arrow(table: str, rows: Sequence[Mapping[str, object]]) -> Any:
    import pyarrow as pa

    return pa.Table.from_pylist([dict(one) for one in rows], schema=schema(table))


def _write(path: str, table: Any) -> None:
    """Write a file at once, unless it is there: never a part of one, and never anew."""
    from pyarrow import parquet

    buffer = io.BytesIO()
    parquet.write_table(table, buffer, compression="zstd")
    with opened(path) as (system, inner):
        if system.exists(inner):
            return
        if remote.is_url(path):
            system.pipe_file(inner, buffer.getvalue())
            return
        Path(inner).parent.mkdir(parents=True, exist_ok=True)
        part = Path(f"{inner}.{os.getpid()}.part")
        try:
            part.write_bytes(buffer.getvalue())
            part.replace(inner)
        finally:
            part.unlink(missing_ok=True)  # of a full disk
