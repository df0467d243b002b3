"""The row of a log: what was estimated, how well, and what it says of vehicle and sensors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ekf_companion.analysis import score
from ekf_companion.analysis.flight_review import FlightReview, review
from ekf_companion.config.config import Config
from ekf_companion.core.memory.aid import BY_KIND
from ekf_companion.errors import CompanionError, UnreachableError
from ekf_companion.fleet.folder import printable
from ekf_companion.fleet.source import Source, printable_name
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status

Row = dict[str, str | int | float | None]
"""Results of one log, by column; None: not known."""

SKIPPED = {"truth": 30.0, "autopilot": 20.0}
"""Seconds at the start that are left out of the errors, as in ``compare``."""
_TRAJECTORY = {"truth": "truth", "autopilot": "own"}
"""Fields of a report, in the order in which a review compares with them."""
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
    "firmware": str,
    "airframe": str,
    "receiver": str,
    "hardware": str,
    "vehicle": str,
    "notes": str,
}
"""The columns and their types. ``outcome`` is one of :data:`OUTCOMES`, ``why`` says why it failed;
``grade`` and ``verdict`` are those that ``report`` gives. Errors are RMS, against the autopilot's
own estimate and against the log's truth. Firmware, airframe and receiver are as the log names them,
hardware and vehicle as a list does."""
OUTCOMES = ("estimated", "failed", "unread")
"""``failed``: nothing could be estimated; ``unread``: it could not be fetched this time."""
_AIRFRAME = ("SYS_AUTOSTART", "FRAME_CLASS", "FRAME_TYPE", "Q_FRAME_CLASS", "FRAME")
_RECEIVER = ("GPS1_TYPE", "GPS_TYPE", "GPS_1_PROTOCOL", "GPS_1_CONFIG")
"""Parameters by which PX4 and ArduPilot are told what they fly on and which receiver they have."""


def examine(path: Path, config: Config, name: str | None = None) -> Row:
    """Run the estimator over a log, and return its row; a log that fails has one that says why.

    ``name`` is that of the row; None: the path.
    """
    name = printable_name(path) if name is None else name
    try:
        return row_of(name, review(path, config))
    except CompanionError as error:
        return failed_of(error, path, name)


def examine_source(source: Source, config: Config) -> Row:
    """Do the same with a log wherever it is."""
    try:
        with source.opened() as path:
            row = examine(path, config, source.name)
    except CompanionError as error:
        return failed_of(error, None, source.name)
    return {**row, **dict(source.about)}


def failed_of(error: CompanionError, path: Path | None, name: str) -> Row:
    """Return the row of a log that ended in an error: its sentence, without the log's name."""
    why = str(error).removeprefix(f"{path}: ").removeprefix(f"{name}: ")
    row = failed(name, why if path is None else why.replace(str(path), name))
    return {**row, "outcome": "unread"} if isinstance(error, UnreachableError) else row


def failed(name: str, why: str) -> Row:
    """Return the row of a log that could not be estimated from."""
    row: Row = {"log": name, "outcome": "failed", "why": printable(why)}
    return {**dict.fromkeys(COLUMNS), **row}


def row_of(name: str, flight: FlightReview) -> Row:
    """Return the row of a log that was estimated from."""
    return {**dict.fromkeys(COLUMNS), **dict(_found(name, flight)), **_about(flight)}


def _about(flight: FlightReview) -> Row:
    """Return what a log says of vehicle and receiver; None: nothing."""
    texts = flight.onboard

    def of(names: tuple[str, ...]) -> str:
        values = texts.parameters
        return ", ".join(f"{one} {values[one]:.6g}" for one in names if values.get(one))

    rate = flight.report.rates.get(Kind.GNSS, 0.0)
    receiver = [of(_RECEIVER), f"{rate:.0f} Hz" if rate >= 0.5 else ""]
    return {
        "firmware": printable_name(texts.firmware) or None,
        "airframe": of(_AIRFRAME) or None,
        "receiver": ", ".join(filter(None, receiver)) or None,
    }


def _found(name: str, flight: FlightReview) -> Iterator[tuple[str, str | int | float]]:
    """Yield the results of a log, by column."""
    report = flight.report
    yield from {"log": name, "outcome": "estimated", "autopilot": report.family}.items()
    yield "estimates", len(flight.table)
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
    whose_others = [whose for whose in SKIPPED if getattr(report, _TRAJECTORY[whose]) is not None]
    for whose, other in zip(whose_others, flight.others, strict=True):
        found = score.score(flight.ours, other, SKIPPED[whose])
        for column, (field, scale) in _ERRORS.items():
            if (spread := getattr(found, field)) is not None:
                yield f"{whose}_{column}", spread.rms * scale
    judgement = flight.judgement
    yield from {"grade": judgement.grade, "verdict": judgement.sentence}.items()
    yield "notes", "; ".join(report.notes)
