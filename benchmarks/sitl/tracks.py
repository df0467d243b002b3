"""Truth, the autopilot's own estimate and ours: position, velocity and attitude on one clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyulog import ULog

from ekf_companion.logs import dataflash_records, tlog
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

COMPONENT_ID = 194
"""The daemon's."""
_LOCAL_NED = 1
_ACCEL_BIAS = (13, 14, 15)
"""Among the states of EKF2."""
_IN_THE_AIR = 1.0
"""Height of the truth above its start, m."""
_NO_PLACE = 1 << 7 | 1 << 18
"""EKF3's status: constant position mode, dead reckoning (nav_filter_status)."""
_PLACE = 1 << 4
"""Its horizontal position is that of an aid."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Track:
    """A motion sampled in time, on the vehicle's boot clock."""

    t: Array
    """s, ascending, shape (n,)."""
    pos_n: Array
    """m, north, east, down, shape (n, 3)."""
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
    ours: Track | None
    """None: no ODOMETRY was sent."""
    resets: Array
    """reset_counter of each ODOMETRY, shape (n,)."""
    quality: Array
    """Of each ODOMETRY, shape (n,)."""
    accel_bias: Array
    """The autopilot's estimate, m/s^2, shape (m, 3); without rows where its log lacks it."""
    own_resets: Array | None = None
    """When the autopilot reset its place or velocity, s; None: not logged."""
    dead_reckoning: float | None = None
    """Longest time for which the autopilot went without aid in the air, s; None: not logged."""


def from_px4(log: Path, recording: Path) -> Flown:
    """Read a .ulg of PX4's simulator and the daemon's recording of the same flight."""
    topics = {(one.name, one.multi_id): one.data for one in ULog(str(log)).data_list}

    def track(suffix: str) -> Track:
        local = topics[f"vehicle_local_position{suffix}", 0]
        turned = topics[f"vehicle_attitude{suffix}", 0]
        stamp = "timestamp_sample" if local["timestamp_sample"].any() else "timestamp"
        att_stamp = "timestamp_sample" if turned["timestamp_sample"].any() else "timestamp"
        return Track(
            t=local[stamp] * 1e-6,
            pos_n=np.stack([local[name] for name in ("x", "y", "z")], axis=1).astype(float),
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
    ours, resets, quality = _ours(recording)
    return Flown(
        truth=track("_groundtruth"),
        autopilot=track(""),
        ours=ours,
        resets=resets,
        quality=quality,
        accel_bias=accel,
        own_resets=_moved(topics["vehicle_local_position", 0]),
        dead_reckoning=_inertial(topics.get(("estimator_status_flags", 0))),
    )


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


def resumed_after(recording: Path) -> float:
    """Return the time from the autopilot's restart to the next ODOMETRY, s; infinite: none came."""
    log = tlog.read(recording)
    ours = log.columns(("ODOMETRY",), 1, COMPONENT_ID).get("ODOMETRY")
    theirs = log.columns(("SYSTEM_TIME",), 1, 1).get("SYSTEM_TIME")
    if ours is None or theirs is None:
        return float("inf")
    backwards = np.flatnonzero(np.diff(theirs["time_boot_ms"].astype(np.int64)) < 0)
    if not len(backwards):
        return float("inf")
    begun = theirs[tlog.STAMP][backwards[-1] + 1]
    later = ours[tlog.STAMP][ours[tlog.STAMP] > begun]
    return float((later[0] - begun) * 1e-6) if len(later) else float("inf")


def from_ardupilot(log: Path, recording: Path) -> Flown:
    """Read a .bin of ArduPilot's simulator and the daemon's recording of the same flight."""
    stored = dataflash_records.read_tables(log)[0]
    tables = {name: rows.all() for name, rows in stored.items()}
    fast, slow, own = tables["SIM2"], tables["SIM"], tables["XKF1"]
    own = own[own["C"] == 0]
    biases = tables["XKF2"]
    biases = biases[biases["C"] == 0]
    health = tables["XKF4"]
    health = health[health["C"] == 0]
    t, status = health["TimeUS"] * 1e-6, health["SS"].astype(np.int64)
    truth = _track(fast, slow)
    in_air = np.interp(t, truth.t, truth.pos_n[0, 2] - truth.pos_n[:, 2]) > _IN_THE_AIR
    is_lost = in_air & (((status & _NO_PLACE) != 0) | ((status & _PLACE) == 0))
    moved = np.any([np.diff(health[name]) != 0 for name in ("OFN", "OFE")], axis=0)
    ours, resets, quality = _ours(recording)
    return Flown(
        truth=truth,
        autopilot=_track(own, own),
        ours=ours,
        resets=resets,
        quality=quality,
        accel_bias=np.stack([biases[name] for name in ("AX", "AY", "AZ")], axis=1),
        own_resets=t[1:][moved],
        dead_reckoning=_longest(t, is_lost),
    )


def _track(motion: tlog.Column, attitude: tlog.Column) -> Track:
    """Return the track of two tables of a .bin: position and velocity, and the angles."""
    return Track(
        t=motion["TimeUS"] * 1e-6,
        pos_n=np.stack([motion[name] for name in ("PN", "PE", "PD")], axis=1),
        vel_n=np.stack([motion[name] for name in ("VN", "VE", "VD")], axis=1),
        att_t=attitude["TimeUS"] * 1e-6,
        euler=_angles(attitude),
    )


def _ours(recording: Path) -> tuple[Track | None, Array, Array]:
    """Return the ODOMETRY that the daemon sent, its reset counters and its qualities."""
    if not recording.exists():
        return None, np.zeros(0), np.zeros(0)
    log = tlog.read(recording)
    rows = log.columns(("ODOMETRY",), 1, COMPONENT_ID).get("ODOMETRY")
    if rows is None:
        return None, np.zeros(0), np.zeros(0)
    q_nb = np.asarray(rows["q"], dtype=float)
    q_nb /= np.linalg.norm(q_nb, axis=1, keepdims=True)
    velocity = np.stack([rows[name] for name in ("vx", "vy", "vz")], axis=1).astype(float)
    is_local = rows["child_frame_id"] == _LOCAL_NED
    t = rows["time_usec"] * 1e-6
    track = Track(
        t=t,
        pos_n=np.stack([rows[name] for name in ("x", "y", "z")], axis=1).astype(float),
        vel_n=np.where(is_local[:, None], velocity, so3.rotate(q_nb, velocity)),
        att_t=t,
        euler=_euler(q_nb),
    )
    return track, np.asarray(rows["reset_counter"]), np.asarray(rows["quality"])


def _euler(q_nb: Array) -> Array:
    """Return roll, pitch, yaw of quaternions, unwrapped, shape (n, 3)."""
    return np.unwrap(so3.to_euler(np.asarray(q_nb, dtype=float)), axis=0)


def _angles(table: tlog.Column) -> Array:
    """Return roll, pitch, yaw of a table in degrees, unwrapped, rad."""
    degrees = np.stack([table[name] for name in ("Roll", "Pitch", "Yaw")], axis=1)
    return np.unwrap(np.deg2rad(degrees), axis=0)
