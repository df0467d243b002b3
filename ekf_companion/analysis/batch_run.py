"""Many logs in several processes: a failure stops no other log, and a run can be resumed.

Finished logs are in a journal beside the table, a line per log, until the table is complete.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import re
import signal
import stat
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Protocol, TextIO

from ekf_companion.analysis.batch import COLUMNS, Row, examine, failed
from ekf_companion.config.config import Config
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.version import __version__

_BEGIN = re.compile(r'\[("[0-9a-f]{0,16}("(,( ({}?)?)?)?)?)?')
"""A first line that was cut short: the fingerprint of the settings."""
LARGEST = 1 << 28
"""Bytes of a journal: of a hundred thousand logs."""
Task = Callable[[Path], Row]
Progress = Callable[[int, int], None]
"""Called with the bytes of the logs that are done, and of all."""


class Executor(Protocol):
    """Runs the task on each log: in processes of this machine, or elsewhere."""

    def run(self, task: Task, logs: Sequence[Path]) -> Iterator[tuple[Path, Row]]:
        """Yield each log and its row once it is known, in any order; no log stops the others."""


class Processes:
    """An executor of several processes on this machine."""

    def __init__(self, jobs: int) -> None:
        """Use so many processes, >= 1."""
        self._jobs = jobs

    def run(self, task: Task, logs: Sequence[Path]) -> Iterator[tuple[Path, Row]]:
        """Yield each log and its row once it is known.

        If a process dies, the unfinished logs are examined again, each in a process of its own, so
        that only the log that kills it fails.
        """
        again: list[Path] = []
        for log, row in self._run_together(task, logs, self._jobs):
            if row is None:
                again.append(log)
            else:
                yield log, row
        for log in again:
            ((_, row),) = self._run_together(task, [log], 1)
            why = "the process that read it was killed, perhaps for want of memory"
            yield log, failed(log, why) if row is None else row

    def _run_together(
        self, task: Task, logs: Sequence[Path], jobs: int
    ) -> Iterator[tuple[Path, Row | None]]:
        """Yield each log and its row, or None where a process has died."""
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_worker)
        try:
            futures = {pool.submit(task, log): log for log in logs}
            for future in as_completed(futures):
                log, error = futures[future], future.exception()
                if isinstance(error, BrokenProcessPool):
                    yield log, None
                elif error is not None:
                    yield log, failed(log, f"a bug: {type(error).__name__}: {error}")
                else:
                    yield log, future.result()
        finally:
            pool.shutdown(cancel_futures=True)


def _begin_worker() -> None:
    """Ignore Ctrl-C, which the parent handles, and end with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def run(
    logs: Sequence[Path],
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
    keys = {log: _key(log) for log in logs}
    written = _read_journal(journal, config)
    rows = {log: written[key] for log, key in keys.items() if key in written}
    sizes = {log: log.stat().st_size + 1 if log.exists() else 1 for log in logs}
    done, total = sum(sizes[log] for log in rows), sum(sizes.values())
    left = [log for log in logs if log not in rows]
    try:
        with open(journal, "a" if written else "w", encoding="utf-8", opener=_own) as file:
            if not written:
                _add_line(file, _fingerprint(config), {})
            # The largest first, so that no process ends long after the others
            by_size = sorted(left, key=sizes.__getitem__, reverse=True)
            for log, row in executor.run(partial(examine, config=config), by_size):
                rows[log] = row
                _add_line(file, keys[log], row)
                done += sizes[log]
                if progress is not None:
                    progress(done, total)
    except OSError as error:
        raise LogError(f"{journal}: cannot be written: {error.strerror}") from error
    return [rows[log] for log in logs]


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
    return found if _fingerprint(config) in found else {}


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
    if row.keys() != COLUMNS.keys() or row["outcome"] not in ("estimated", "failed"):
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


def _key(log: Path) -> str:
    """Return a key by which an unchanged log is recognised."""
    about = log.stat() if log.exists() else None
    return f"{log} {about.st_size} {about.st_mtime_ns}" if about else str(log)


def _fingerprint(config: Config) -> str:
    text = f"{__version__} {config!r}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]
