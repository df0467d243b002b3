"""Finds the logs of a batch, and makes a table's row of each."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from ekf_companion.analysis import score
from ekf_companion.config.config import Config
from ekf_companion.core.memory.aid import BY_KIND
from ekf_companion.errors import CompanionError, ConfigError
from ekf_companion.logs import csv_known
from ekf_companion.logs.csv_columns import map_beside
from ekf_companion.logs.estimate import OWN, is_written, of_table
from ekf_companion.logs.recording import counted
from ekf_companion.logs.source import real_path, suffix_of
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status, Table
from ekf_companion.review import convert
from ekf_companion.review.report import Report
from ekf_companion.review.verdict import judge_log

Row = dict[str, str | int | float | None]
"""Results of one log, by column; None: not known."""

SUFFIXES = (".tlog", ".bin", ".ulg", ".csv")
"""Kinds of logs that are looked for in folders."""
SHOWN = 4
"""Number of files left out for one reason that are named."""
SKIPPED = {"truth": 30.0, "autopilot": 20.0}
"""Seconds at the start that are left out of the errors, as in ``compare``."""
_RATES = (Kind.IMU, Kind.GNSS, Kind.HEADING, Kind.MAG, *BY_KIND)
_ERRORS = {
    "horizontal_m": ("horizontal", 1.0),
    "vertical_m": ("vertical", 1.0),
    "velocity_mps": ("velocity", 1.0),
    "tilt_deg": ("tilt", 180.0 / np.pi),
    "yaw_deg": ("yaw", 180.0 / np.pi),
}
"""RMS errors: the score's field, and its size in the column's unit."""
_NUMBERS = {
    "duration_s": float,
    "estimates": int,
    **{f"{kind.name.lower()}_hz": float for kind in _RATES},
    **{f"{status.name.lower()}_s": float for status in Status},
    "resets": int,
    "reboots": int,
    "gaps": int,
    "late": int,
    "gnss_delay_s": float,
    "gyro_noise_rps": float,
    "accel_noise_mps2": float,
    **{f"{whose}_{name}": float for whose in SKIPPED for name in _ERRORS},
}
COLUMNS: Mapping[str, type] = {
    "log": str,
    "outcome": str,
    "grade": str,
    "verdict": str,
    "why": str,
    "autopilot": str,
    **_NUMBERS,
    "last_reset": str,
    "notes": str,
}
"""The columns and their types. ``outcome`` is ``estimated`` or ``failed``, ``why`` says why it
failed; ``grade`` and ``verdict`` are those that ``report`` gives. Errors are RMS, against the
autopilot's own estimate and against the log's truth."""


def find_logs(names: Sequence[str]) -> list[Path]:
    """Return the logs of files, folders (recursively) and patterns, each once, in their order.

    Raises:
        ConfigError: A name is nothing of these, or there is no log at all.
    """
    found: dict[Path, None] = {}
    for name in names:
        path = Path(name)
        if path.is_dir():
            below = [one for one in sorted(path.rglob("*")) if one.is_file() and _is_log(one)]
        elif path.exists():
            below = [path]
        else:
            matches = sorted(glob.glob(name, recursive=True))
            below = [one for one in map(Path, matches) if one.is_file()]
            if not below:
                raise ConfigError(f"{name}: no such file or folder, and no file matches it")
        found |= dict.fromkeys(below)
    if not found:
        raise ConfigError(f"{', '.join(names)}: no log in there ({', '.join(SUFFIXES)})")
    return list(found)


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
        for path in sorted(Path(name).rglob("*"))
        if path.is_file() and real_path(path) not in ours
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
    if is_written(path):
        return OWN
    if path.suffix.lower() != ".csv" or map_beside(path) is not None:
        return ""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            names = [name.strip() for name in file.readline(1 << 16).split(",")]
    except OSError:
        return ""  # it may be one, and its row says why it cannot be read
    if any(name.startswith("gyro_x") for name in names) or csv_known.find(names) is not None:
        return ""
    return "a table without inertial samples: no column gyro_x; name it by itself to have it read"


def examine(path: Path, config: Config) -> Row:
    """Run the estimator over a log, and return its row; a log that fails has one that says why."""
    try:
        table, report = convert.estimate(path, config)
    except CompanionError as error:
        return failed(path, str(error).removeprefix(f"{path}: "))
    return {**dict.fromkeys(COLUMNS), **dict(_found(path, table, report))}


def _name(path: Path) -> str:
    """Return the name of a log in a form that no spreadsheet takes for a formula."""
    return printable(f"./{path}" if str(path).lstrip()[:1] in ("=", "+", "-", "@") else path)


def printable(text: object) -> str:
    r"""Return a text that any file may hold: bytes that are not UTF-8 as ``\udcff``."""
    return str(text).encode(errors="backslashreplace").decode()


def failed(path: Path, why: str) -> Row:
    """Return the row of a log that could not be estimated from."""
    row: Row = {"log": _name(path), "outcome": "failed", "why": printable(why)}
    return {**dict.fromkeys(COLUMNS), **row}


def _found(path: Path, table: Table, report: Report) -> Iterator[tuple[str, str | int | float]]:
    """Yield the results of a log, by column."""
    yield from {"log": _name(path), "outcome": "estimated", "autopilot": report.family}.items()
    yield "estimates", len(table)
    yield "duration_s", round(sum(report.seconds.values()), 3)
    for kind in _RATES:
        if report.counts[kind]:
            yield f"{kind.name.lower()}_hz", round(report.rates.get(kind, 0.0), 3)
    for status, seconds in report.seconds.items():
        yield f"{status.name.lower()}_s", round(seconds, 3)
    if (health := report.health) is not None:
        yield from {"resets": report.resets, "reboots": report.reboots}.items()
        yield from {"gaps": health.gaps, "late": health.reruns}.items()
        yield "gyro_noise_rps", health.gyro_noise
        yield "accel_noise_mps2", health.accel_noise
        if report.counts[Kind.GNSS]:
            yield "gnss_delay_s", health.gnss_delay
        if report.resets:
            yield "last_reset", report.reset_reason
    estimate = of_table(table, "ekf-companion")
    for whose, other in (("autopilot", report.own), ("truth", report.truth)):
        if other is not None:
            found = score.score(estimate, other, SKIPPED[whose])
            for name, (field, scale) in _ERRORS.items():
                if (spread := getattr(found, field)) is not None:
                    yield f"{whose}_{name}", spread.rms * scale
    judgement = judge_log(report)
    yield from {"grade": judgement.grade, "verdict": judgement.sentence}.items()
    yield "notes", "; ".join(report.notes)
