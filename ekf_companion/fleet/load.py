"""Reads the tables of a fleet, each log once: a data set, or a table of ``batch``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ekf_companion.errors import ConfigError, LogError, require
from ekf_companion.fleet import dataset, remote
from ekf_companion.fleet.dataset import TABLES, Partition, shown

_FOLDER = re.compile(r"version=([^/=]+)/config=([0-9a-f]+)$")
NEEDED = ("log", "outcome")
"""Columns without which a table is none of logs."""


class Build(NamedTuple):
    """A version and a configuration of which a data set has results."""

    version: str
    config: str

    def __str__(self) -> str:
        return f"{self.version}/{self.config}"


def builds(place: str) -> list[Build]:
    """Return the builds of a data set, in their order.

    Raises:
        ConfigError: It is none.
    """
    with dataset.opened(place) as (system, inner):
        system.invalidate_cache()
        base = f"{inner.rstrip('/')}/logs"
        there = system.glob(f"{base}/version=*/config=*") if system.exists(base) else []
    found = [Build(*match.groups()) for one in there if (match := _FOLDER.search(str(one)))]
    if not found:
        where = shown(place)
        raise ConfigError(f"{where}: holds no results; write some: batch LOGS -o {where}")
    return sorted(found)


def select(place: str, wanted: str) -> Build:
    """Return the build of a data set that a text begins to name; empty: the only one.

    Raises:
        ConfigError: There is none, or several.
    """
    found = [one for one in builds(place) if str(one).startswith(wanted) or one.config == wanted]
    if len(found) == 1:
        return found[0]
    names = ", ".join(map(str, found or builds(place)))
    what = f"several builds begin with {wanted!r}" if found else f"no build begins with {wanted!r}"
    raise ConfigError(f"{shown(place)}: {what}; name one with --of: {names}")


def load(place: str, table: str = "logs", of: str = "") -> Any:
    """Return a table of a fleet, ordered by log, as a ``pyarrow.Table``.

    Args:
        place: A data set, or a .csv or .parquet of ``batch``, which holds ``logs`` alone.
        table: One of ``TABLES``.
        of: The build, as far as it must be named.

    Raises:
        ConfigError: There is no such table.
        LogError: It cannot be read, or is none of a fleet.
    """
    require("fleet", shown(place), "pyarrow.parquet")
    if not remote.is_url(place) and Path(place).is_file():
        if table != "logs":
            raise ConfigError(f"{place}: holds no table of {table}; a data set does")
        return _of_file(Path(place))
    return _of_data_set(place, table, select(place, of))


def _of_data_set(place: str, table: str, build: Build) -> Any:
    import pyarrow as pa
    from pyarrow import compute

    into = Partition(place, *build)
    parts: list[Any] = []
    known: Any = pa.array([], pa.string())
    for name, part in dataset.read_files(into.folder(table), None):
        checked = _checked(part, table, f"{shown(into.folder(table))}/{name}")
        fresh = compute.invert(compute.is_in(checked.column("key"), value_set=known))
        checked = checked.filter(fresh)
        known = pa.concat_arrays([known, checked.column("key").combine_chunks().unique()])
        parts.append(checked)
    found = pa.concat_tables(parts) if parts else dataset.schema(table).empty_table()
    if table == "logs":
        found = _first_of_each(found)
    order = [("log", "ascending"), *((n, "ascending") for n in _ORDER.get(table, ("key",)))]
    return found.sort_by(order)


_ORDER = {
    "events": ("key", "begin_s", "kind", "subject", "evidence"),
    "histograms": ("key", "quantity"),
}


def _first_of_each(table: Any) -> Any:
    """Return the rows without those of a key that has been before."""
    import pyarrow as pa

    seen: set[str] = set()
    rows = [
        index
        for index, key in enumerate(table.column("key").to_pylist())
        if not (key in seen or seen.add(key))  # type: ignore[func-returns-value]
    ]
    return table.take(pa.array(rows, pa.int64()))


def _of_file(path: Path) -> Any:
    import pyarrow as pa
    from pyarrow import csv, parquet

    try:
        if path.suffix == ".csv":
            types = {name: dataset.schema("logs").field(name).type for name in TABLES["logs"]}
            convert = csv.ConvertOptions(column_types=types, strings_can_be_null=True)
            read = csv.ReadOptions(block_size=1 << 24)
            parse = csv.ParseOptions(newlines_in_values=True)
            table = csv.read_csv(path, read, parse, convert)
        else:
            table = parquet.read_table(path, partitioning=None)
    except (pa.ArrowException, OSError, ValueError) as error:
        what = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise LogError(f"{path}: is no table of batch: {what}") from None
    return _checked(table, "logs", str(path)).sort_by("log")


def _checked(table: Any, name: str, where: str) -> Any:
    """Return a table with the columns of its kind alone, of their types; missing ones are empty.

    Raises:
        LogError: It is none of a fleet.
    """
    import pyarrow as pa

    schema = dataset.schema(name)
    needed: Sequence[str] = NEEDED if name == "logs" else ("key", "log")
    names = table.column_names
    missing = {*needed} - {*names}
    if missing or len({*names}) < len(names):
        lacks = (
            f"it has no column {', '.join(sorted(missing))}" if missing else "columns come twice"
        )
        raise LogError(f"{where}: is no table of {name}: {lacks}")
    columns = []
    for field in schema:
        if field.name not in names:
            columns.append(pa.nulls(len(table), field.type))
            continue
        try:
            columns.append(table.column(field.name).cast(field.type))
        except (pa.ArrowException, ValueError):
            raise LogError(
                f"{where}: is no table of {name}: column {field.name} is no {field.type}"
            ) from None
    return pa.table(columns, schema=schema)


def export(table: Any, path: Path) -> None:
    """Write a table as .csv or .parquet, byte for byte the same of the same rows.

    Raises:
        LogError: The file cannot be written.
    """
    from ekf_companion.fleet import table as files

    files.check(path)
    files.write_arrow(path, table)
