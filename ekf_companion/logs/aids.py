"""Columns of the aids that declare themselves, in each kind of log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import Kind

DOWN = 25
"""ROTATION_PITCH_270 (ArduPilot), ROTATION_DOWNWARD_FACING (PX4)."""
GOOD = 4
"""RFND.Stat: RangeFinder::Status::Good."""
LAST_SENSOR = 3
"""airspeed_source: the last number of a sensor; above it is what the autopilot makes up."""
LONGEST = 2.0
"""Between two distances of a wheel, of which a speed is made, s."""

Table = Mapping[str, Any]
"""Columns by name."""


class Columns(NamedTuple):
    """Where an aid stands in one format."""

    name: str
    """Of the message or topic."""
    needed: tuple[str, ...]
    """Columns without which it is not used."""
    read: Callable[[Table], tuple[Mask, tuple[Array, ...]]]
    """Returns which rows are measurements, and the columns of the events."""


class Logged(NamedTuple):
    """Where an aid stands in the logs."""

    csv: dict[str, str]
    """The unit of each quantity, in the order of the row; the first is the measurement."""
    dataflash: Columns
    ulog: tuple[Columns, ...]
    """The first that holds a measurement counts."""


_FIELDS = ("current_distance", "min_distance", "max_distance")


def _rfnd(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the ranges of RFND of the first sensor that looks down.

    Source: ArduPilot, ``LogStructure.h``. Before 3.5 no orientation is logged; then two sensors
    stand in a row, and since 4.0 each in its own.
    """
    for suffix in ("", "1", "2"):
        names = f"Dist{suffix}", f"Orient{suffix}"
        if not {*names} <= {*table}:
            continue
        distance, orientation = (np.asarray(table[name]) for name in names)
        if {distance.dtype.kind, orientation.dtype.kind} - {*"iuf"}:
            continue
        good = (orientation == DOWN) & (distance > 0.0)
        if (status := table.get(f"Stat{suffix}")) is not None:
            good &= np.asarray(status) == GOOD
        if good.any() and "Instance" in table:
            good &= np.asarray(table["Instance"]) == np.asarray(table["Instance"])[good].min()
        if good.any():
            return good, (distance.astype(float), np.full(len(distance), np.nan))
    nothing = np.full(len(next(iter(table.values()), ())), np.nan)
    return np.zeros(len(nothing), dtype=bool), (nothing, nothing)


def _distance_sensor(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the ranges of distance_sensor that are within the sensor's own and look down."""
    distance = np.asarray(topic["current_distance"], dtype=float)
    good = np.isfinite(distance)
    good &= distance > np.asarray(topic["min_distance"])
    good &= distance < np.asarray(topic["max_distance"])
    if "orientation" in topic:
        good &= np.asarray(topic["orientation"]) == DOWN
    if "signal_quality" in topic:
        good &= np.asarray(topic["signal_quality"]) != 0
    variance = np.asarray(topic["variance"], dtype=float) if "variance" in topic else np.nan
    std = np.sqrt(np.where(np.asarray(variance) > 0.0, variance, np.nan))
    return good, (distance, np.broadcast_to(std, distance.shape))


def _arsp(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the indicated airspeeds of ARSP, of the first sensor that is used and healthy.

    Source: ArduPilot, ``LogStructure.h``.
    """
    speed = np.asarray(table["Airspeed"], dtype=float)
    good = np.isfinite(speed)
    for name in ("H", "U"):
        if name in table and (np.asarray(table[name]) != 0).any():
            good &= np.asarray(table[name]) != 0
    instance = table.get("I", table.get("Instance"))
    if instance is not None and good.any():
        good &= np.asarray(instance) == np.asarray(instance)[good].min()
    return good, (speed, np.full(len(speed), np.nan), np.ones(len(speed)))


def _airspeed_validated(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the true airspeeds that are of a sensor, not of the autopilot's own estimate.

    Source: PX4, ``AirspeedValidated.msg``: since 1.16 ``airspeed_source``, before the index.
    """
    speed = np.asarray(topic["true_airspeed_m_s"], dtype=float)
    good = np.isfinite(speed)
    number = topic.get("airspeed_source", topic.get("selected_airspeed_index"))
    if number is not None:
        good &= (np.asarray(number) >= 1) & (np.asarray(number) <= LAST_SENSOR)
    return good, (speed, np.full(len(speed), np.nan), np.zeros(len(speed)))


def _airspeed(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the true airspeeds of the sensor."""
    speed = np.asarray(topic["true_airspeed_m_s"], dtype=float)
    return np.isfinite(speed), (speed, np.full(len(speed), np.nan), np.zeros(len(speed)))


def _wenc(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the mean speeds of the wheels of WENC that turn, from the rows before and after.

    Source: ArduPilot, ``LogStructure.h``: distances that add up, m.
    """
    distances = np.stack([np.asarray(table[name], dtype=float) for name in ("Dist0", "Dist1")])
    if (moves := np.ptp(distances, axis=1) > 0.0).any():
        distances = distances[moves]
    distance, t = distances.mean(axis=0), np.asarray(table["TimeUS"], dtype=float) * 1e-6
    speed, good = np.zeros(len(t)), np.zeros(len(t), dtype=bool)
    if len(t) > 2:
        span = t[2:] - t[:-2]
        good[1:-1] = (span > 0.0) & (span < LONGEST) & np.isfinite(distance[2:] - distance[:-2])
        gained = np.where(good[1:-1], distance[2:] - distance[:-2], 0.0)
        speed[1:-1] = gained / np.where(good[1:-1], span, 1.0)
    return good, (speed, np.full(len(speed), np.nan))


LOGGED = {
    Kind.RANGE: Logged(
        {"range": "m", "range_std": "m"},
        Columns("RFND", (), _rfnd),
        (Columns("distance_sensor", _FIELDS, _distance_sensor),),
    ),
    Kind.AIRSPEED: Logged(
        {"airspeed": "m/s", "airspeed_std": "m/s"},
        Columns("ARSP", ("Airspeed",), _arsp),
        (
            Columns("airspeed_validated", ("true_airspeed_m_s",), _airspeed_validated),
            Columns("airspeed", ("true_airspeed_m_s",), _airspeed),
        ),
    ),
    Kind.WHEEL: Logged(
        {"wheel_speed": "m/s", "wheel_speed_std": "m/s"},
        Columns("WENC", ("Dist0", "Dist1"), _wenc),
        (),
    ),
}
"""By kind."""
DATAFLASH = {one.dataflash.name: (kind, one.dataflash) for kind, one in LOGGED.items()}
"""By message."""
ULOG = {aid.name: (kind, aid) for kind, one in LOGGED.items() for aid in one.ulog}
"""By topic."""
CSV = {kind: one.csv for kind, one in LOGGED.items()}
"""The unit of each quantity, by kind."""
