"""A batch: many logs to one table, killed and resumed.

Finished logs are in a journal beside the table, a line per log, until the table is complete.
"""

from __future__ import annotations

import json
import os
import re
import stat
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TextIO

from ekf_companion.config.config import Config
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.fleet.build import fingerprint
from ekf_companion.fleet.executor import Executor, Lost, largest_first
from ekf_companion.fleet.row import COLUMNS, OUTCOMES, Row, examine_source, failed
from ekf_companion.fleet.source import Source

_BEGIN = re.compile(r'\[("[0-9a-f]{0,16}("(,( ({}?)?)?)?)?)?')
"""A first line that was cut short: the fingerprint of the settings."""
LARGEST = 1 << 28
"""Bytes of a journal: of a hundred thousand logs."""
Progress = Callable[[int, int], None]
"""Called with the bytes of the logs that are done, and of all."""


def run(
    logs: Sequence[Source],
    config: Config,
    journal: Path,
    executor: Executor,
    progress: Progress | None = None,
) -> list[Row]:
    """Examine all logs that are not in the journal; return all rows in the order of the logs.

    Raises:
        LogError: The journal cannot be written.
        ConfigError: A file with its name is not a journal.
    """
    written = _read_journal(journal, config)
    rows = {log.key: written[log.key] for log in logs if log.key in written}
    done = sum(log.weight for log in logs if log.key in rows)
    total = sum(log.weight for log in logs)
    left = [log for log in logs if log.key not in rows]
    try:
        with open(journal, "a" if written else "w", encoding="utf-8", opener=_own) as file:
            if not written:
                _add_line(file, fingerprint(config), {})
            task = partial(examine_source, config=config)
            for log, found in executor.run(task, largest_first(left, lambda log: log.weight)):
                row = failed(log.name, found.why) if isinstance(found, Lost) else found
                rows[log.key] = row
                if row["outcome"] != "unread":  # the next run may read it
                    _add_line(file, log.key, row)
                done += log.weight
                if progress is not None:
                    progress(done, total)
    except OSError as error:
        raise LogError(f"{journal}: cannot be written: {error.strerror}") from error
    return [rows[log.key] for log in logs]


def _add_line(file: TextIO, key: str, row: Row) -> None:
    file.write(json.dumps([key, row]) + "\n")
    file.flush()


def _own(path: str, flags: int) -> int:
    """Open a journal without following links, and without waiting for the writer of a FIFO."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)


def _read_journal(path: Path, config: Config) -> dict[str, Row]:
    """Return the rows of an earlier run by key; none if its settings were different.

    Raises:
        ConfigError: It is not a journal, and would be lost.
    """
    try:
        with open(path, "rb", opener=_own) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ConfigError(f"{path}: is not a regular file; move it away")
            data = file.read(LARGEST + 1)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; move it away") from error
    if len(data) > LARGEST:
        raise ConfigError(f"{path}: is larger than any journal of a batch; move it away")
    lines = data.decode(errors="replace").splitlines()
    found = dict(filter(None, map(_read_line, lines)))
    # The first line may be cut short, if that is all there is
    if lines and not found and not _BEGIN.fullmatch(lines[0]):
        raise ConfigError(
            f"{path}: is no journal of a batch, which would stand there; move it away, or name "
            "another table"
        )
    return found if fingerprint(config) in found else {}


def _read_line(line: str) -> tuple[str, Row] | None:
    """Return the key and the row of a line; None: it is cut short, or not a line of a journal."""
    try:
        match json.loads(line):
            case [str(key), dict(row)] if not row or _is_row(row):
                return key, row
    except (ValueError, RecursionError):
        pass
    return None


def _is_row(row: Row) -> bool:
    """Return whether a row could be the table's: its columns, of their types, text in UTF-8."""
    if row.keys() != COLUMNS.keys() or row["outcome"] not in OUTCOMES:
        return False
    for name, value in row.items():
        kinds = (int, float) if COLUMNS[name] is float else COLUMNS[name]
        if value is None or (isinstance(value, kinds) and not isinstance(value, bool)):
            if isinstance(value, str):
                value.encode()  # a UnicodeEncodeError is a ValueError
            if not isinstance(value, int) or abs(value) < 1 << 63:
                continue
        return False
    return True
