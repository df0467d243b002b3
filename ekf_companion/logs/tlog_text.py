"""Firmware, parameters and messages of a telemetry log (.tlog)."""

from __future__ import annotations

import numpy as np

from ekf_companion.logs.onboard import (
    MOST,
    MOST_PARAMETERS,
    Message,
    Onboard,
    clean,
    level_of,
    onboard,
)
from ekf_companion.logs.stored_rows import Column
from ekf_companion.logs.tlog import ORDER, Autopilot, Tlog
from ekf_companion.logs.tlog_trajectory import boot_clock

_INT_TYPES = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4"}
"""MAV_PARAM_TYPE of integers, whose bytes PX4 sends in place of a float's."""
_FIELDS = {
    "PARAM_VALUE": ("param_id", "param_value", "param_type"),
    "STATUSTEXT": ("severity", "text", "id", "chunk_seq"),
    "AUTOPILOT_VERSION": ("flight_sw_version",),
}
_NAMES = {"px4": "PX4", "ardupilot": "ArduPilot"}


def read(log: Tlog, of: Autopilot) -> Onboard:
    """Return firmware, parameters and messages of the autopilot."""
    ids = of.system_id, of.component_id
    found = log.columns([*_FIELDS], *ids, fields=_FIELDS)
    firmware = ""
    if (rows := found.get("AUTOPILOT_VERSION")) is not None:
        said = rows["flight_sw_version"][rows["flight_sw_version"] != 0]
        if len(said):
            major, minor, patch, _ = int(said[-1]).to_bytes(4, "big")
            firmware = f"{_NAMES.get(of.family, '')} {major}.{minor}.{patch}".strip()
    messages, more = _messages(log, of, found.get("STATUSTEXT"))
    is_bytewise = of.family == "px4"
    parameters = _parameters(found.get("PARAM_VALUE"), is_bytewise=is_bytewise)
    return onboard(messages, parameters, firmware, more)


def _parameters(rows: Column | None, *, is_bytewise: bool) -> dict[str, float]:
    """Return the first value of each parameter."""
    values: dict[str, float] = {}
    for row in rows if rows is not None else ():
        name, kind = clean(bytes(row["param_id"])), int(row["param_type"])
        if name not in values and len(values) < MOST_PARAMETERS:
            value = row["param_value"]
            if is_bytewise and kind in _INT_TYPES:
                value = np.frombuffer(value.tobytes(), _INT_TYPES[kind])[0]
            values[name] = float(value)
    return values


def _messages(log: Tlog, of: Autopilot, rows: Column | None) -> tuple[list[Message], int]:
    """Return the lines, with those in several parts joined, and how many more there are."""
    if rows is None:
        return [], 0
    order, t_ns = boot_clock(log, of)
    kept = rows[:MOST]
    at = kept[ORDER]
    # Of other boots than the longest no stamp is on the clock of the estimates
    is_stamped = (at >= order[0]) & (at <= order[-1]) if len(order) else np.zeros(len(at), bool)
    stamps = np.interp(at, order, t_ns) if len(order) else np.zeros(len(at))
    found: list[tuple[int | None, str, bytes]] = []
    last = (0, 0)
    for row, stamp, is_known in zip(kept, stamps.tolist(), is_stamped.tolist(), strict=True):
        number, part = int(row["id"]), int(row["chunk_seq"])
        if found and number and part and last == (number, part - 1):
            found[-1] = (*found[-1][:2], found[-1][2] + bytes(row["text"]))
        else:
            stamp_ns = int(stamp) if is_known else None
            found.append((stamp_ns, level_of(int(row["severity"])), bytes(row["text"])))
        last = number, part
    lines = [Message(stamp_ns, level, clean(text)) for stamp_ns, level, text in found]
    return lines, len(rows) - len(kept)
