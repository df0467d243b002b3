"""Finds the logs of files, folders and patterns of this machine."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from ekf_companion.errors import ConfigError
from ekf_companion.logs import csv_known
from ekf_companion.logs.csv_columns import map_beside
from ekf_companion.logs.estimate import OWN, is_written
from ekf_companion.logs.recording import counted
from ekf_companion.logs.source import header_of, real_path, suffix_of

SUFFIXES = (".tlog", ".bin", ".ulg", ".csv")
"""Kinds of logs that are looked for in folders."""
LONGEST = 255
"""Letters that are shown of a name that is none: no file's name has more."""
SHOWN = 4
"""Number of files left out for one reason that are named."""


def find_logs(names: Sequence[str]) -> list[Path]:
    """Return the logs of files, folders (recursively) and patterns, each once, in their order.

    Raises:
        ConfigError: A name is nothing of these, or there is no log at all.
    """
    found = list(dict.fromkeys(path for name in names for path in each_log(name)))
    if not found:
        raise ConfigError(f"{', '.join(names)}: no log in there ({', '.join(SUFFIXES)})")
    return found


def each_log(name: str) -> Iterator[Path]:
    """Yield the logs of a file, a folder or a pattern, in the order of their names.

    Raises:
        ConfigError: It is nothing of these.
    """
    path = Path(name)
    if os.path.isdir(name):  # which knows that a name of any length and letters may be none
        yield from (one for one in _files(path) if _is_log(one))
    elif os.path.exists(name):
        yield path
    else:
        matches = map(Path, sorted(glob.glob(name, recursive=True)))
        files = [one for one in matches if one.is_file()]
        if not files:
            what = printable(name if len(name) <= LONGEST else f"{name[:LONGEST]}...")
            raise ConfigError(f"{what}: no such file or folder, and no file matches it")
        yield from files


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, ordered by path; only one folder is in memory at a time."""
    try:
        with os.scandir(folder) as entries:
            found = sorted((one.name, one.is_dir(follow_symlinks=False)) for one in entries)
    except OSError:
        return  # it vanished, or may not be listed
    for name, is_folder in found:
        if is_folder:
            yield from _files(folder / name)
        else:
            yield folder / name


def left_out(names: Sequence[str], taken: Sequence[Path]) -> str:
    """Return how many files of the folders are not logs, which, and why; empty: none.

    ``taken`` are the logs that :func:`find_logs` found there, and the outputs.
    """
    ours = {real_path(path) for path in taken}
    ours |= {real_path(beside) for path in taken if (beside := map_beside(path)) is not None}
    found = {
        real_path(path): path
        for name in names
        if Path(name).is_dir()
        for path in _files(Path(name))
        if real_path(path) not in ours
    }
    if not found:
        return ""
    by_reason: dict[str, list[Path]] = {}
    for path in found.values():
        by_reason.setdefault(_why_not(path), []).append(path)
    groups = []
    for why, paths in sorted(by_reason.items()):
        shown = ", ".join(printable(path) for path in paths[:SHOWN])
        more = f" and {len(paths) - SHOWN} more" if len(paths) > SHOWN else ""
        groups.append(f"{shown}{more} ({why})")
    return f"{counted(len(found), 'file')} left out: {'; '.join(groups)}"


def _is_log(path: Path) -> bool:
    """Return whether a file in a folder may be a log, and not an estimate or another table."""
    return not _why_not(path)


def _why_not(path: Path) -> str:
    """Return why a file in a folder is left out; empty: it may be a log."""
    if suffix_of(path) not in SUFFIXES:
        return f"none of {', '.join(SUFFIXES)}"
    if not path.is_file():
        return "no file: a pipe, a device, or a link to none"
    if is_written(path):
        return OWN
    if suffix_of(path) != ".csv" or map_beside(path) is not None:
        return ""
    if not (names := header_of(path)):
        return ""  # it may be one, and its row says why it cannot be read
    if any(name.startswith("gyro_x") for name in names) or csv_known.find(names) is not None:
        return ""
    return "a table without inertial samples: no column gyro_x; name it by itself to have it read"


def printable(text: object) -> str:
    r"""Return a text that any file and terminal may hold.

    Bytes that are not UTF-8 become ``\udcff``, a line's end ``\n``, the begin of a terminal's
    command ``\x1b``: a name is one line, and moves no cursor.
    """
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode() for one in str(text)
    )
