"""The table on many logs: as a file, and as lines to read."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ekf_companion.errors import ConfigError, require
from ekf_companion.fleet.folder import printable
from ekf_companion.fleet.row import COLUMNS, Row
from ekf_companion.fleet.source import printable_name
from ekf_companion.logs.recording import counted
from ekf_companion.logs.writer import create

KINDS = (".csv", ".parquet")
FEWEST = 50
"""Characters behind a log's name that are shown on any terminal."""


def check(path: Path) -> None:
    """Refuse a file of no known kind, or of one that cannot be written here.

    Raises:
        ConfigError: It is of no known kind.
        MissingPackageError: The package for Parquet is not installed.
    """
    if path.suffix not in KINDS:
        raise ConfigError(f"{path}: unknown kind of table; known are {', '.join(KINDS)}")
    if path.suffix == ".parquet":
        require("formats", str(path), "pyarrow.parquet")


def write(path: Path, rows: Sequence[Row]) -> None:
    """Write the table by the file's suffix.

    Raises:
        LogError: The file cannot be written.
    """
    with create(path) as file:
        if path.suffix == ".parquet":
            import pyarrow as pa
            from pyarrow import parquet

            types = {str: pa.string(), int: pa.int64(), float: pa.float64()}
            schema = pa.schema([(name, types[kind]) for name, kind in COLUMNS.items()])
            parquet.write_table(pa.Table.from_pylist(list(rows), schema=schema), file)
            return
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        file.write(text.getvalue().encode())


def write_arrow(path: Path, table: Any) -> None:
    """Write a ``pyarrow.Table`` by the file's suffix.

    Raises:
        LogError: The file cannot be written.
    """
    with create(path) as file:
        if path.suffix == ".parquet":
            from pyarrow import parquet

            parquet.write_table(table, file)
            return
        for batch in table.to_batches(max_chunksize=10_000) or [table]:
            text = io.StringIO()
            writer = csv.DictWriter(text, table.column_names, lineterminator="\n")
            if file.tell() == 0:
                writer.writeheader()
            for row in batch.to_pylist():
                texts = {name: printable_name(one) for name, one in row.items() if type(one) is str}
                writer.writerow({**row, **texts})
            file.write(text.getvalue().encode())


def lines(rows: Sequence[Row], width: int | None = None) -> list[str]:
    """Return a line on each log with its verdict, and the number of each outcome.

    Args:
        rows: Of the table.
        width: To which the line of a log with a verdict is cut, characters; None: it is not.
            Why a log failed is never cut.
    """
    names = [printable(row["log"]) for row in rows]
    longest = max(map(len, names), default=0)
    found = []
    for name, row in zip(names, rows, strict=True):
        line = f"{name:{longest}}  "
        if row["outcome"] != "estimated":
            found.append(f"{line}{row['outcome']}: {printable(row['why'])}")
            continue
        line += f"{row['duration_s'] or 0:.0f} s, {row['verdict']}"
        # At least the grade and the size are read, also behind a long name
        most = max(width, longest + FEWEST) if width else len(line)
        found.append(line if len(line) <= most else line[: most - 3].rstrip(" ,") + "...")
    counts = Counter(str(row["outcome"]) for row in rows)
    total = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
    return [*found, f"{counted(len(rows), 'log')}: {total}"]
