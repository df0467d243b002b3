"""Senders in a telemetry log: its vehicles, by their heartbeats and their other messages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ekf_companion.logs.tlog import Autopilot, Tlog
from ekf_companion.mavlink.discovery import is_autopilot
from ekf_companion.mavlink.frame import STX_2
from ekf_companion.mavlink.messages import IDS

INERTIAL = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""Messages with inertial samples."""
_ARDUPILOT = (
    *("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "AHRS", "AHRS2", "MEMINFO", "HWSTATUS"),
    *("SENSOR_OFFSETS", "SIMSTATE", "EKF_STATUS_REPORT"),
)
"""Messages that ArduPilot sends and PX4 does not."""
_PX4 = ("ESTIMATOR_STATUS", "ALTITUDE", "ACTUATOR_CONTROL_TARGET", "UTM_GLOBAL_POSITION")
"""Messages that PX4 sends and ArduPilot does not."""
_FAMILIES = {3: "ardupilot", 12: "px4"}
"""MAV_AUTOPILOT."""
_STAYS = 2
"""Heartbeats from which on a sender counts: a single one may be stray."""
_HEARTBEAT = IDS["HEARTBEAT"]
_READ = [_HEARTBEAT, *(IDS[name] for name in {*INERTIAL, *_ARDUPILOT, *_PX4})]


@dataclass(slots=True)
class Sender:
    """One system and component of a log."""

    system_id: int
    component_id: int
    heartbeats: int = 0
    """Those of an autopilot that flies a vehicle."""
    samples: int = 0
    """Messages with inertial samples."""
    family: str = "unknown"
    """``px4``, ``ardupilot`` or ``unknown``: by its heartbeats, or by its other messages."""

    @property
    def is_vehicle(self) -> bool:
        """Whether it is the autopilot of a vehicle, and not a stray frame."""
        return self.heartbeats >= _STAYS or (self.heartbeats == 0 and self.samples > 0)

    @property
    def autopilot(self) -> Autopilot:
        """Its ids and family."""
        return Autopilot(self.system_id, self.component_id, self.family)


def senders(log: Tlog) -> list[Sender]:
    """Return the autopilots of a log, and other senders of inertial samples, by their ids."""
    messages: Counter[tuple[int, ...]] = Counter()
    heartbeats: Counter[tuple[int, ...]] = Counter()
    for rows, raw, begin in log.bytes_of(_READ):
        place = rows["place"] - begin
        is_second = raw[place] == STX_2
        ids = raw[place + np.where(is_second, 5, 3)], raw[place + np.where(is_second, 6, 4)]
        messages.update(_counted(rows["message_id"], *ids))
        is_beat = rows["message_id"] == _HEARTBEAT
        place, payload = place[is_beat], place[is_beat] + np.where(is_second[is_beat], 10, 6)
        # Behind custom_mode: the type, the autopilot; 0 if the payload is cut short
        said = [np.where(raw[place + 1] > at, raw[payload + at], 0) for at in (4, 5)]
        heartbeats.update(_counted(*(one[is_beat] for one in ids), *said))
    found: dict[tuple[int, int], Sender] = {}
    for (number, system, component), count in messages.items():
        sender = found.setdefault((system, component), Sender(system, component))
        sender.samples += count if number in {IDS[name] for name in INERTIAL} else 0
    for (system, component, kind, autopilot), count in heartbeats.items():
        sender = found[system, component]
        sender.heartbeats += count if is_autopilot(autopilot, kind) else 0
        if sender.family == "unknown":
            sender.family = _FAMILIES.get(autopilot, "unknown")
    for sender in found.values():
        if sender.family == "unknown" and not sender.heartbeats:
            sender.family = _family(
                {
                    number
                    for number, system, component in messages
                    if (system, component) == (sender.system_id, sender.component_id)
                }
            )
    return [one for _, one in sorted(found.items()) if one.heartbeats or one.samples]


def _counted(*columns: np.ndarray) -> Counter[tuple[int, ...]]:
    """Return the number of occurrences of each row of some columns."""
    table = np.stack([column.astype(np.int64) for column in columns], axis=1)
    rows, counts = np.unique(table, axis=0, return_counts=True)
    return Counter(dict(zip(map(tuple, rows.tolist()), counts.tolist(), strict=True)))


def _family(numbers: set[int]) -> str:
    """Return the family whose messages these are."""
    for family, names in (("ardupilot", _ARDUPILOT), ("px4", _PX4)):
        if numbers & {IDS[name] for name in names}:
            return family
    return "unknown"


def unannounced(found: Iterable[Sender], wanted: int | None) -> Sender | None:
    """Return the sender of samples to use where no autopilot sends heartbeats.

    Args:
        found: All senders.
        wanted: System id of the one to listen to; None: any.

    Returns:
        Component 1 before any other, then the one with most samples. None: there is none, or a
        PX4 or ArduPilot sends heartbeats, or another autopilot does that sends samples too.
    """
    asked = [one for one in found if wanted in (None, one.system_id)]
    if any(one.heartbeats and (one.samples or one.family != "unknown") for one in asked):
        return None
    silent = [one for one in asked if one.samples]
    return max(silent, key=lambda one: (one.component_id == 1, one.samples), default=None)


def others(found: Iterable[Sender], used: Autopilot) -> list[Sender]:
    """Return one autopilot of each system other than the one in use: other vehicles."""
    vehicles: dict[int, Sender] = {}
    for one in found:
        is_other = one.system_id != used.system_id and one.is_vehicle
        if is_other and (one.heartbeats == 0 or one.family != "unknown" or one.samples):
            vehicles.setdefault(one.system_id, one)
    return [*vehicles.values()]


def autopilot_of(log: Tlog, wanted: int | None = None) -> Autopilot | None:
    """Return the autopilot that a session would listen to; None: there is none.

    Among several, one of known firmware comes first, then component 1, then the one with most
    samples.
    """
    found = senders(log)
    if (silent := unannounced(found, wanted)) is not None:
        return silent.autopilot
    asked = [one for one in found if one.heartbeats and wanted in (None, one.system_id)]
    best = max(
        asked,
        key=lambda one: (one.family != "unknown", one.component_id == 1, one.samples),
        default=None,
    )
    return None if best is None else best.autopilot
