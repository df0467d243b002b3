"""The column and unit of each quantity, from a map or from the header's names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.errors import ConfigError, LogError
from ekf_companion.logs import aids
from ekf_companion.logs.source import unpacked_name
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.yaml_file import read_yaml

DEGREE = float(np.pi / 180.0)
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "gyro": {"rad/s": 1.0, "deg/s": DEGREE},
    "accel": {"m/s2": 1.0, "m/s^2": 1.0, "g": STANDARD_GRAVITY},
    "mag": {"gauss": 1.0, "uT": 1e-2, "mG": 1e-3, "nT": 1e-5},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "pressure": {"Pa": 1.0, "hPa": 100.0},
    "angle": {"rad": 1.0, "deg": DEGREE},
    "number": {"": 1.0, "1": 1.0},
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6, "cm/s": 1e-2, "kn": 1852.0 / 3600.0},
}
"""Units by dimension, and their size in SI and radians."""
_SUFFIXES = {"rps": "rad/s", "dps": "deg/s", "mps2": "m/s2", "mps": "m/s", "kmph": "km/h"}
"""Spelling in header names of units with a slash; other units are spelt as they are."""
_BY_UNIT = {
    "m": "length",
    "m/s": "speed",
    "rad": "angle",
    "rad/s": "gyro",
    "Pa": "pressure",
    "1": "number",
}
"""Dimension of what an aid declares."""
UNITS = ("", "2", "3", "4")
"""Of the inertial units, behind ``gyro`` and ``accel``."""
QUANTITIES = {
    "time": "time",
    **{
        f"{sensor}{unit}_{axis}": sensor
        for unit in UNITS
        for sensor in ("gyro", "accel")
        for axis in "xyz"
    },
    **{f"mag_{axis}": "mag" for axis in "xyz"},
    "baro_alt": "length",
    "baro_press": "pressure",
    **dict.fromkeys(["gps_lat", "gps_lon", "gps_course", "heading", "heading_std"], "angle"),
    **dict.fromkeys(["gps_alt", "gps_north", "gps_east", "gps_h"], "length"),
    **dict.fromkeys(["gps_std_h", "gps_std_v"], "length"),
    **{name: _BY_UNIT[unit] for aid in aids.CSV.values() for name, unit in aid.csv.items()},
    **dict.fromkeys(["gps_vn", "gps_ve", "gps_vd", "gps_speed", "gps_std_vel"], "speed"),
}
"""Dimension of each quantity."""
GROUPS = {
    **{
        f"imu{unit}": [f"{sensor}{unit}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
        for unit in UNITS
    },
    "mag": [f"mag_{axis}" for axis in "xyz"],
}
"""Quantities that are only usable together."""
OPTIONS = ("hold", "origin", "heading_source", "delimiter")


class Source(NamedTuple):
    """The source of one quantity."""

    column: str | None
    """None: a constant."""
    value: float
    scale: float
    """To SI, sign included."""


def find_map(path: Path, columns: Mapping[str, Any] | None) -> tuple[str, Mapping[str, Any]]:
    """Return the name of the map for messages, and the map."""
    if columns is not None:
        return f"{path} (columns)", columns
    if (beside := map_beside(path)) is None:
        if os.path.lexists(name := _name_beside(path)):
            raise LogError(f"{name}: is no file, or a link to none: mend it, or move it away")
        return str(path), {}
    try:
        found = read_yaml(beside, is_watched=False)
    except ConfigError as error:
        raise LogError(str(error)) from None
    if not isinstance(found, dict):
        raise LogError(f"{beside}: must be a map from quantity to {{column: NAME, unit: UNIT}}")
    return str(beside), found


def map_beside(path: Path) -> Path | None:
    """Return the map of a file's columns that stands beside it; None: there is none."""
    beside = _name_beside(path)
    try:
        return beside if beside.is_file() else None
    except OSError:  # the log's name is so long that none can be longer
        return None


def _name_beside(path: Path) -> Path:
    return path.with_name(unpacked_name(path).name + ".columns.yaml")


def from_map(where: str, name: str, entry: Any) -> Source:
    """Read one entry of a map.

    Raises:
        LogError: The quantity, key or unit is unknown, or the sign or value is invalid.
    """
    if name not in QUANTITIES:
        raise LogError(
            f"{where}: {name}: unknown quantity; known are {', '.join([*QUANTITIES, *OPTIONS])}"
        )
    if not isinstance(entry, Mapping) or not {"column", "value"} & set(entry):
        raise LogError(f"{where}: {name}: must be {{column: NAME, unit: UNIT}}, not {entry!r}")
    if unknown := set(entry) - {"column", "value", "unit", "sign"}:
        raise LogError(
            f"{where}: {name}: unknown key {sorted(map(str, unknown))[0]!r}; "
            "known are column, value, unit, sign"
        )
    units = _UNITS[QUANTITIES[name]]
    unit, sign, value = entry.get("unit"), entry.get("sign", 1), entry.get("value", np.nan)
    if unit not in units:
        said = "no unit" if unit is None else f"unknown unit {unit!r}"
        raise LogError(f"{where}: {name}: {said}; known are {', '.join(units)}")
    if sign not in (1, -1) or isinstance(sign, bool):
        raise LogError(f"{where}: {name}: sign {sign!r}: must be 1 or -1")
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise LogError(f"{where}: {name}: value {value!r}: must be a number")
    column = str(entry["column"]) if "column" in entry else None
    return Source(column=column, value=float(value), scale=sign * units[unit])


def from_header(path: Path, names: list[str], notes: list[str]) -> dict[str, Source]:
    """Return the quantities that the header's names declare; name other columns in the notes.

    Raises:
        LogError: A quantity has no known unit or two columns, or there is none.
    """
    sources: dict[str, Source] = {}
    ignored = []
    for name in names:
        # The longest quantity that the name begins with: heading_std before heading
        fits = [known for known in QUANTITIES if name == known or name.startswith(known + "_")]
        if not fits:
            ignored.append(name)
            continue
        quantity = max(fits, key=len)
        suffix = name[len(quantity) + 1 :]
        units = _UNITS[QUANTITIES[quantity]]
        unit = _SUFFIXES.get(suffix, suffix)
        if unit not in units:
            spelled = {known: suffix for suffix, known in _SUFFIXES.items()}
            known_names = ", ".join(
                f"{quantity}_{spelled.get(unit, unit)}"
                for unit in units
                if "/" not in unit or unit in spelled
            )
            raise LogError(f"{path}: column {name!r}: no known unit at its end; use {known_names}")
        if quantity in sources:
            raise LogError(f"{path}: {quantity} stands in two columns; keep one of them")
        sources[quantity] = Source(column=name, value=np.nan, scale=units[unit])
    if not sources:
        raise LogError(
            f"{path}: no column name of ours in the header ({', '.join(names[:8])} ...); declare "
            f"them in {path.name}.columns.yaml: gyro_x: {{column: NAME, unit: deg/s}} and so on"
        )
    if ignored:
        notes.append(f"columns that are not ours were ignored: {', '.join(ignored)}")
    return sources


def check_groups(path: Path, sources: Mapping[str, Source]) -> None:
    """Refuse a quantity without the others that it needs."""
    if "time" not in sources:
        raise LogError(f"{path}: no time column; name one time_us, time_ms or time_s, or map time")
    groups = list(GROUPS.values())
    if any(name.startswith("gps_") for name in sources):
        local = ["gps_north", "gps_east", "gps_h"]
        groups.append(local if set(local) & set(sources) else ["gps_lat", "gps_lon", "gps_alt"])
    if {"gps_speed", "gps_course"} & set(sources):
        groups.append(["gps_speed", "gps_course"])
    if {"gps_vn", "gps_ve", "gps_vd"} & set(sources):
        groups.append(["gps_vn", "gps_ve"])
    for group in groups:
        missing = [name for name in group if name not in sources]
        is_needed = len(missing) < len(group) or group[0] in ("gps_lat", "gps_vn")
        if missing and is_needed:
            dimension = _UNITS[QUANTITIES[missing[0]]]
            raise LogError(
                f"{path}: {', '.join(missing)} missing beside {', '.join(set(group) - {*missing})}"
                f"; declare a column for each (units: {', '.join(dimension)})"
            )
    if "heading_std" in sources and "heading" not in sources:
        raise LogError(f"{path}: heading_std without heading; declare a column for heading")
