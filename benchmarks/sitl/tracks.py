"""Truth, the autopilot's own estimate and ours: position, velocity and attitude on one clock.

Positions are absolute: metres of ``place.HOME``, made of latitude, longitude and altitude. What the
autopilot and ODOMETRY count in metres about an origin is brought there by the autopilot's own
projection, so that an origin or a projection that is not the autopilot's own shows as an error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pyulog import ULog

from benchmarks.sitl.place import HOME, Places, by_ardupilot, by_px4, from_home, latest
from benchmarks.sitl.recording import Odometry, Projection, read_odometry
from ekf_companion.logs import dataflash_records
from ekf_companion.logs.stored_rows import Column
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

Rows = npt.NDArray[np.intp]
"""Numbers of rows."""

_ACCEL_BIAS = (13, 14, 15)
"""Among the states of EKF2."""
_IN_THE_AIR = 1.0
"""Height of the truth above its start, m."""
_NO_PLACE = 1 << 7 | 1 << 18
"""EKF3's status: constant position mode, dead reckoning (nav_filter_status)."""
_PLACE = 1 << 4
"""Its horizontal position is that of an aid."""
_EKF_ORIGIN = 0
"""Type of ORGN."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Track:
    """A motion sampled in time, on the vehicle's boot clock."""

    t: Array
    """s, ascending, shape (n,)."""
    pos_n: Array
    """m, north, east, down of ``place.HOME``, shape (n, 3)."""
    vel_n: Array
    """m/s, shape (n, 3)."""
    att_t: Array
    """s, shape (k,)."""
    euler: Array
    """Roll, pitch, yaw, rad, unwrapped, shape (k, 3)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flown:
    """What the logs of one flight hold."""

    truth: Track
    autopilot: Track
    """The lane that it flies on."""
    ours: Track | None
    """ODOMETRY that was sent, by the GPS_GLOBAL_ORIGIN beside it; None: none was sent."""
    taken: Track | None
    """ODOMETRY that arrived, as the autopilot reads it: about its own origin."""
    arrival: Array
    """When each of ``taken`` arrived, s; by its stamp, where the autopilot's log lacks it."""
    resets: Array
    """reset_counter of each of ``ours``, shape (n,)."""
    withheld: Array
    """Times of the ODOMETRY that was only recorded, s."""
    accel_bias: Array
    """The autopilot's estimate, m/s^2, shape (m, 3); without rows where its log lacks it."""
    own_resets: Array | None = None
    """When the autopilot reset its place or velocity, s; None: not logged."""
    dead_reckoning: float | None = None
    """Longest time for which the autopilot went without aid in the air, s; None: not logged."""


def from_px4(log: Path, recordings: Sequence[Path]) -> Flown:
    """Read a .ulg of PX4's simulator and the daemon's recordings of the same flight."""
    topics = {(one.name, one.multi_id): one.data for one in ULog(str(log)).data_list}

    def track(suffix: str) -> Track:
        local = topics[f"vehicle_local_position{suffix}", 0]
        turned = topics[f"vehicle_attitude{suffix}", 0]
        stamp = "timestamp_sample" if local["timestamp_sample"].any() else "timestamp"
        att_stamp = "timestamp_sample" if turned["timestamp_sample"].any() else "timestamp"
        pos_n = np.stack([local[name] for name in ("x", "y", "z")], axis=1).astype(float)
        return Track(
            t=local[stamp] * 1e-6,
            pos_n=from_home(by_px4(pos_n, _px4_origin(local))),
            vel_n=np.stack([local[name] for name in ("vx", "vy", "vz")], axis=1).astype(float),
            att_t=turned[att_stamp] * 1e-6,
            euler=_euler(np.stack([turned[f"q[{k}]"] for k in range(4)], axis=1)),
        )

    states = topics.get(("estimator_states", 0))
    accel = (
        np.zeros((0, 3))
        if states is None
        else np.stack([states[f"states[{k}]"] for k in _ACCEL_BIAS], axis=1)
    )
    local = topics["vehicle_local_position", 0]
    odometry = read_odometry(recordings)
    seen = topics.get(("vehicle_visual_odometry", 0))
    arrived = None if seen is None else (seen["timestamp_sample"] * 1e-6, seen["timestamp"] * 1e-6)
    return Flown(
        truth=track("_groundtruth"),
        autopilot=track(""),
        **_ours(odometry, by_px4, (local["timestamp"] * 1e-6, _px4_origin(local)), arrived),
        accel_bias=accel,
        own_resets=_moved(local),
        dead_reckoning=_inertial(topics.get(("estimator_status_flags", 0))),
    )


def _px4_origin(local: Any) -> Places:
    """Return where a local position counts from; ``HOME`` where it has no origin.

    The altitude of an origin that it was given on our estimate is 0, which means none.
    """
    has_origin = local["ref_timestamp"] > 0
    lat, lon, alt = (
        np.where(has_origin & np.isfinite(local[name]) & (local[name] != 0.0), local[name], usual)
        for name, usual in zip(("ref_lat", "ref_lon", "ref_alt"), HOME, strict=True)
    )
    return Places(lat, lon, alt)


def _moved(local: Any) -> Array:
    """Return when a reset counter of the local position moved, s."""
    counts = [local[f"{name}_reset_counter"].astype(int) for name in ("xy", "vxy", "z", "vz")]
    return np.asarray(local["timestamp_sample"][1:][np.diff(counts, axis=1).any(axis=0)] * 1e-6)


def _inertial(flags: Any) -> float | None:
    """Return the longest time for which EKF2 was in inertial dead reckoning in the air, s."""
    if flags is None or "cs_inertial_dead_reckoning" not in flags:
        return None
    is_lost = (flags["cs_inertial_dead_reckoning"] != 0) & (flags["cs_in_air"] != 0)
    return _longest(flags["timestamp"] * 1e-6, is_lost)


def _longest(t: Array, is_lost: Array) -> float:
    """Return the longest time (s) for which a state lasted."""
    longest, since = 0.0, None
    for now, lost in zip(t, is_lost, strict=True):
        since = (now if since is None else since) if lost else None
        longest = max(longest, now - since if since is not None else 0.0)
    return float(longest)


def from_ardupilot(log: Path, recordings: Sequence[Path]) -> Flown:
    """Read a .bin of ArduPilot's simulator and the daemon's recordings of the same flight."""
    stored = dataflash_records.read_tables(log)[0]
    tables = {name: rows.all() for name, rows in stored.items()}
    health, own = tables["XKF4"], _primary(tables["XKF1"], tables["XKF4"])
    biases = tables["XKF2"]
    biases = biases[biases["C"] == 0]
    health = health[health["C"] == 0]
    t, status = health["TimeUS"] * 1e-6, health["SS"].astype(np.int64)
    truth = _track(tables["SIM2"], tables["SIM"], HOME)
    in_air = np.interp(t, truth.t, truth.pos_n[0, 2] - truth.pos_n[:, 2]) > _IN_THE_AIR
    is_lost = in_air & (((status & _NO_PLACE) != 0) | ((status & _PLACE) == 0))
    moved = np.any([np.diff(health[name]) != 0 for name in ("OFN", "OFE")], axis=0)
    stamps, origins = _origins(tables.get("ORGN"))
    is_placed = own["TimeUS"] * 1e-6 >= stamps[0]
    own = own[is_placed] if is_placed.any() else own
    seen = tables.get("VISP")
    arrived = None if seen is None else (seen["RTimeUS"] * 1e-6, seen["TimeUS"] * 1e-6)
    return Flown(
        truth=truth,
        autopilot=_track(own, own, latest(own["TimeUS"] * 1e-6, stamps, origins)),
        **_ours(read_odometry(recordings), by_ardupilot, (stamps, origins), arrived),
        accel_bias=np.stack([biases[name] for name in ("AX", "AY", "AZ")], axis=1),
        own_resets=t[1:][moved],
        dead_reckoning=_longest(t, is_lost),
    )


def _primary(own: Column, health: Column) -> Column:
    """Return the rows of the lane that was flown on."""
    lanes = health[health["C"] == 0]
    rows = np.searchsorted(lanes["TimeUS"], own["TimeUS"], side="right") - 1
    return np.asarray(own[own["C"] == lanes["PI"][np.maximum(rows, 0)]])


def _origins(rows: Column | None) -> tuple[Array, Places]:
    """Return when EKF3's origin was set or moved, s, and where to; ``HOME`` if it never was."""
    if rows is not None:
        rows = rows[rows["Type"] == _EKF_ORIGIN]
    if rows is None or not len(rows):
        return np.zeros(1), Places(*(np.array([one]) for one in HOME))
    return rows["TimeUS"] * 1e-6, Places(rows["Lat"], rows["Lng"], rows["Alt"].astype(float))


def _track(motion: Column, attitude: Column, origin: Places) -> Track:
    """Return the track of two tables of a .bin: position and velocity, and the angles."""
    pos_n = np.stack([motion[name] for name in ("PN", "PE", "PD")], axis=1).astype(float)
    return Track(
        t=motion["TimeUS"] * 1e-6,
        pos_n=from_home(by_ardupilot(pos_n, origin)),
        vel_n=np.stack([motion[name] for name in ("VN", "VE", "VD")], axis=1),
        att_t=attitude["TimeUS"] * 1e-6,
        euler=_angles(attitude),
    )


def _ours(
    odometry: Odometry | None,
    project: Projection,
    origins: tuple[Array, Places],
    arrived: tuple[Array, Array] | None,
) -> dict[str, Any]:
    """Return what of ``Flown`` is about ODOMETRY.

    Args:
        odometry: All that was recorded.
        project: The autopilot's projection.
        origins: Times (s) and places of the autopilot's origin.
        arrived: Stamps of what the autopilot logged as arrived, and when that was, s; None: it
            logs nothing, and all that was sent counts as arrived.
    """
    nothing = np.zeros(0)
    if odometry is None:
        return {
            "ours": None,
            "taken": None,
            "arrival": nothing,
            "resets": nothing,
            "withheld": nothing,
        }
    sent = odometry.only(odometry.is_sent)
    taken, arrival = sent, sent.t
    if arrived is not None and len(arrived[0]):
        rows, places = match(sent.t, arrived[0])
        taken, arrival = sent.only(rows), arrived[1][places]
    own = sent.origin or latest(sent.t, *origins)
    read = latest(taken.t, *origins)
    return {
        "ours": _placed(sent, project, own) if len(sent.t) else None,
        "taken": _placed(taken, project, read) if len(taken.t) else None,
        "arrival": arrival,
        "resets": sent.resets,
        "withheld": odometry.t[~odometry.is_sent],
    }


def match(stamps: Array, others: Array, within: float = 2e-3) -> tuple[Rows, Rows]:
    """Return the rows of stamps that others repeat within a time (s), and which those are."""
    order = np.argsort(others, kind="stable")
    ordered = others[order]
    after = np.clip(np.searchsorted(ordered, stamps), 0, len(others) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(ordered[before] - stamps) < np.abs(ordered[after] - stamps)
    nearest = np.where(is_before, before, after)
    rows = np.flatnonzero(np.abs(ordered[nearest] - stamps) <= within)
    return rows, order[nearest[rows]]


def _placed(odometry: Odometry, project: Projection, origin: Places) -> Track:
    """Return ODOMETRY as a track, about an origin."""
    return Track(
        t=odometry.t,
        pos_n=from_home(project(odometry.pos_n, origin)),
        vel_n=odometry.vel_n,
        att_t=odometry.t,
        euler=odometry.euler,
    )


def _euler(q_nb: Array) -> Array:
    """Return roll, pitch, yaw of quaternions, unwrapped, shape (n, 3)."""
    return np.unwrap(so3.to_euler(np.asarray(q_nb, dtype=float)), axis=0)


def _angles(table: Column) -> Array:
    """Return roll, pitch, yaw of a table in degrees, unwrapped, rad."""
    degrees = np.stack([table[name] for name in ("Roll", "Pitch", "Yaw")], axis=1)
    return np.unwrap(np.deg2rad(degrees), axis=0)
