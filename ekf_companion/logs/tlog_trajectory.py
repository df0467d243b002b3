"""Trajectories in a telemetry log: the autopilot's estimate, the simulator's truth.

Stamps are the autopilot's boot clock, unwrapped. Where the autopilot rebooted, the longest boot
is returned.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.clock_run import Unwinder, widened
from ekf_companion.logs.stored_rows import Column
from ekf_companion.logs.tlog import ORDER, STAMP, Autopilot, Tlog
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Mask, Stamps, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.stamps import BACK_NS
from ekf_companion.nav.state import EULER, Trajectory

_INERTIAL = ("HIGHRES_IMU", "RAW_IMU")
_TRUTH = ("SIM_STATE", "HIL_STATE_QUATERNION")
_ESTIMATE = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE")
_TIMES = {**dict.fromkeys(_INERTIAL, ("time_usec",)), "ATTITUDE": ("time_boot_ms",)}
"""Fields of messages of which only the clock is used."""
_ESTIMATED = {
    "GLOBAL_POSITION_INT": ("time_boot_ms", "lat", "lon", "alt", "vx", "vy", "vz"),
    "LOCAL_POSITION_NED": ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"),
    "ATTITUDE": ("time_boot_ms", *EULER),
}
_Q_NB = ("q1", "q2", "q3", "q4")
_TRUE = {
    "SIM_STATE": (*_Q_NB, "lat", "lon", "alt", "vn", "ve", "vd", "lat_int", "lon_int"),
    "HIL_STATE_QUATERNION": ("attitude_quaternion", "lat", "lon", "alt", "vx", "vy", "vz"),
}
"""Fields that a trajectory is made of: the others would take 20 MB for hours of flight."""
RATES = {**dict.fromkeys(_INERTIAL, 10.0), **dict.fromkeys((*_TRUTH, *_ESTIMATE), 25.0)}
"""Hz: between two such rows a motion is known to millimetres; of inertial samples only the clock is
used."""


def _boot_ns(table: Column, beside: Column | None = None) -> Stamps:
    """Return the boot time of a table's rows, ns, also where its counter of 32 bits went round.

    Args:
        table: Its rows.
        beside: Rows with milliseconds, if there are any, which tell how often microseconds did.
    """
    if "time_usec" not in (table.dtype.names or ()):
        return Unwinder(1_000_000).take(table["time_boot_ms"].astype(np.int64) * 1_000_000)
    t_ns = series.nanoseconds(table["time_usec"])
    if beside is None or not len(beside):
        return Unwinder(1000).take(t_ns)
    near = np.minimum(np.searchsorted(beside[ORDER], table[ORDER]), len(beside) - 1)
    return widened(t_ns, _boot_ns(beside)[near], 1000)


def _clock(tables: Sequence[Column], beside: Column | None) -> tuple[Stamps, Stamps]:
    """Return the record numbers of tables, ascending, and the boot time of each, ns."""
    order = np.concatenate([table[ORDER] for table in tables])
    t_ns = np.concatenate([_boot_ns(table, beside) for table in tables])
    by_order = np.argsort(order)
    return order[by_order], t_ns[by_order]


def _one_boot(tables: dict[str, Column]) -> dict[str, Column]:
    """Keep the records of the longest stretch in which the boot clock never goes back."""
    clocks = [table for name, table in tables.items() if name in (*_INERTIAL, "ATTITUDE")]
    if not clocks:
        return tables
    order, t_ns = _clock(clocks, tables.get("ATTITUDE"))
    cuts = np.flatnonzero(np.diff(t_ns) < -BACK_NS) + 1
    if len(cuts) == 0:
        return tables
    longest = max(np.split(order, cuts), key=len)
    return {
        name: table[(table[ORDER] >= longest[0]) & (table[ORDER] <= longest[-1])]
        for name, table in tables.items()
    }


def _tables(
    log: Tlog, of: Autopilot, names: Sequence[str], fields: Mapping[str, Sequence[str]]
) -> dict[str, Column]:
    """Return the autopilot's messages of one boot, by name, and those that carry its time."""
    ids = of.system_id, of.component_id
    names = [*names, *(name for name in ("ATTITUDE", *_INERTIAL) if name not in names)]
    tables = _one_boot(log.columns(names, *ids, rates=RATES, fields={**_TIMES, **fields}))
    return {name: table for name, table in tables.items() if len(table)}


def _stamps_before(
    log: Tlog, of: Autopilot, tables: dict[str, Column], order: Stamps
) -> tuple[Mask, Stamps]:
    """Return which records have an inertial message of that boot before them, and its time, ns."""
    clocks = [tables[name] for name in _INERTIAL if name in tables]
    none = np.zeros(len(order), dtype=np.bool_), np.zeros(0, dtype=np.int64)
    if not clocks:
        return none
    wanted = log.last_before(_INERTIAL, order)
    ids = of.system_id, of.component_id
    each = wanted[np.diff(wanted, prepend=-1) > 0]
    found = log.columns(_INERTIAL, *ids, fields=_TIMES, only=each)
    if not found:
        return none
    known, t_ns = _clock([*found.values()], tables.get("ATTITUDE"))
    at = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    is_of_boot = wanted >= min(int(table[ORDER][0]) for table in clocks)
    has_stamp = is_of_boot & (known[at] == wanted)
    return has_stamp, t_ns[at[has_stamp]]


def boot_clock(log: Tlog, of: Autopilot) -> tuple[Stamps, Stamps]:
    """Return the boot time of some records of the longest boot, ns, and the numbers of the records.

    Two of them are a tenth of a second apart or less; both are empty where no record carries the
    time.
    """
    tables = _tables(log, of, (), {})
    if not tables:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return _clock([*tables.values()], tables.get("ATTITUDE"))


def utc_zero_ns(log: Tlog, of: Autopilot) -> int | None:
    """Return the UTC at which the autopilot's clock was zero, ns, by the recorder's clock.

    None where that was not set, or the autopilot rebooted.
    """
    if log.began_s is None:
        return None
    ids = of.system_id, of.component_id
    found = log.columns(["ATTITUDE", *_INERTIAL], *ids, rates=RATES, fields=_TIMES)
    names = [name for name in ("ATTITUDE", *_INERTIAL) if name in found]
    if not names:
        return None
    table = found[names[0]]
    t_ns = _boot_ns(table)
    if (np.diff(t_ns) < -BACK_NS).any():
        return None
    return int(np.median(table[STAMP].astype(np.int64) * 1000 - t_ns))


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def reference(log: Tlog, of: Autopilot) -> Trajectory | None:
    """Return the autopilot's own estimate on its boot clock, or None if the log holds none.

    Position is that of GLOBAL_POSITION_INT, or of LOCAL_POSITION_NED about GPS_GLOBAL_ORIGIN;
    velocity that of LOCAL_POSITION_NED or GLOBAL_POSITION_INT; attitude that of ATTITUDE.
    """
    world, local, origin = "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "GPS_GLOBAL_ORIGIN"
    tables = _tables(log, of, [world, local, origin, "ATTITUDE"], _ESTIMATED)
    if not {world, local, "ATTITUDE"} & tables.keys():
        return None
    tables = {
        name: table if name == origin else table[series.ascending(_boot_ns(table))]
        for name, table in tables.items()
    }
    parts: dict[str, npt.NDArray[Any]] = {}
    if world in tables:
        table = tables[world]
        table = table[(table["lat"] != 0) | (table["lon"] != 0)]  # 0, 0: no position yet
        t_ns, alt = _boot_ns(table), table["alt"] * 1e-3
        lat, lon = np.deg2rad(table["lat"] * 1e-7), so3.wrap(np.deg2rad(table["lon"] * 1e-7))
        parts |= {"pos_t_ns": t_ns, "lat": lat, "lon": lon, "alt": alt}
        parts |= {"vel_t_ns": t_ns, "vel_n": series.stack(table, "vx", "vy", "vz") * 1e-2}
    if local in tables:
        table = tables[local]
        t_ns = _boot_ns(table)
        parts |= {"vel_t_ns": t_ns, "vel_n": series.stack(table, "vx", "vy", "vz")}
        if len(parts.get("pos_t_ns", ())) == 0 and origin in tables:
            row = tables[origin][-1]
            lat0, lon0 = np.deg2rad(row["latitude"] * 1e-7), np.deg2rad(row["longitude"] * 1e-7)
            frame = LocalFrame(float(lat0), float(lon0), float(row["altitude"] * 1e-3))
            lat, lon, alt = frame.to_geodetic(series.stack(table, "x", "y", "z"))
            parts |= {"pos_t_ns": t_ns, "lat": lat, "lon": lon, "alt": alt}
    if "ATTITUDE" in tables:
        table = tables["ATTITUDE"]
        table = table[known_rows(series.stack(table, *EULER))]
        parts |= {"att_t_ns": _boot_ns(table)}
        parts |= {"q_nb": so3.from_euler(table["roll"], table["pitch"], table["yaw"])}
    sources = ", ".join(name for name in (world, local, "ATTITUDE") if name in tables)
    return Trajectory(name=f"autopilot ({sources})", **parts)


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def truth(log: Tlog, of: Autopilot) -> Trajectory | None:
    """Return the simulator's truth on the autopilot's boot clock, or None if there is none.

    SIM_STATE (ArduPilot) has no stamp and HIL_STATE_QUATERNION (PX4) an empty one: each takes the
    time of the inertial message recorded just before it, which was sent in the same pass.
    """
    if not any(log.counts.get(IDS[name]) for name in _TRUTH):
        return None
    tables = _tables(log, of, _TRUTH, _TRUE)
    name = next((name for name in _TRUTH if name in tables), None)
    if name is None:
        return None
    has_stamp, t_ns = _stamps_before(log, of, tables, tables[name][ORDER])
    later = series.ascending(t_ns)
    table, t_ns = tables.pop(name)[np.flatnonzero(has_stamp)[later]], t_ns[later]
    if name == "SIM_STATE":
        exact = (table["lat_int"] != 0) | (table["lon_int"] != 0)
        lat_deg = np.where(exact, table["lat_int"] * 1e-7, table["lat"])
        lon_deg = np.where(exact, table["lon_int"] * 1e-7, table["lon"])
        alt, vel_n = table["alt"].astype(float), series.stack(table, "vn", "ve", "vd")
        q_nb = series.stack(table, *_Q_NB)
    else:
        lat_deg, lon_deg, alt = table["lat"] * 1e-7, table["lon"] * 1e-7, table["alt"] * 1e-3
        vel_n = series.stack(table, "vx", "vy", "vz") * 1e-2
        q_nb = table["attitude_quaternion"].astype(float)
    known = np.abs(np.linalg.norm(q_nb, axis=1) - 1.0) < 0.1
    return Trajectory(
        name=f"simulator ({name})",
        pos_t_ns=t_ns,
        lat=np.deg2rad(lat_deg),
        lon=so3.wrap(np.deg2rad(lon_deg)),
        alt=alt,
        vel_t_ns=t_ns,
        vel_n=vel_n,
        att_t_ns=t_ns[known],
        q_nb=so3.normalise(q_nb[known]),
    )
