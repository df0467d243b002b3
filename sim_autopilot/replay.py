"""A recorded flight as frames at their times, whatever format it was recorded in.

A .tlog holds the autopilot's own frames. The other formats hold none: their samples are put into
the messages that the autopilot would have sent (GPS_RAW_INT has no vertical velocity).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.logs import csv, dataflash, tlog, ulog
from ekf_companion.logs.recording import Recording
from ekf_companion.logs.tlog_senders import autopilot_of
from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import HeadingSource, Kind
from sim_autopilot.sensors import pressure
from sim_autopilot.telemetry import centidegrees

Timed = tuple[int, bytes]
"""Time of sending, ns, and the frame."""

_READERS = {".bin": dataflash.read, ".ulg": ulog.read, ".csv": csv.read}
_AUTOPILOTS = {"px4": 12, "ardupilot": 3}
_GENERIC = 0
_INERTIAL, _MAGNETOMETER, _BAROMETER = 0x3F, 64 | 128 | 256, 512 | 2048
_SECOND_NS = 1_000_000_000
_UINT32_MS = (1 << 32) * 1_000_000
"""ns."""


def frames(path: Path) -> Iterator[Timed]:
    """Yield a log's frames in the order in which they are sent, from its own start.

    Raises:
        LogError: The file cannot be read, or is of no format that is known.
    """
    suffix = path.suffix.lower()
    if suffix == ".tlog":
        return _of_tlog(path)
    if suffix not in _READERS:
        known = ", ".join([".tlog", *_READERS])
        raise LogError(f"{path}: cannot be replayed; known are {known}")
    return of_recording(_READERS[suffix](path))


def _of_tlog(path: Path) -> Iterator[Timed]:
    log = tlog.read(path)
    theirs = autopilot_of(log)
    latest_us = 0
    for stamp_us, frame in log.frames():
        system, component = (frame[5], frame[6]) if frame[0] == 0xFD else (frame[3], frame[4])
        if theirs is None or (system, component) == (theirs.system_id, theirs.component_id):
            latest_us = max(latest_us, stamp_us)
            yield latest_us * 1000, frame


def of_recording(recording: Recording) -> Iterator[Timed]:
    """Yield the messages that an autopilot with these sensors would send."""
    events = recording.events
    # A foreign log may count from 1970; an autopilot's milliseconds since its start have 32 bits
    is_unix = len(events) and events.t_ns.min() > _UINT32_MS
    zero_ns = int(events.t_ns.min()) - _SECOND_NS if is_unix else 0
    autopilot = _AUTOPILOTS.get(recording.family, _GENERIC)
    sender = Sender(1, 1)
    stamps = events.t_ns - zero_ns
    arrival = np.maximum.accumulate(stamps).tolist() if len(events) else []
    attitudes = _attitudes(recording, zero_ns)
    mag, baro, updated = (0.0, 0.0, 0.0), 0.0, _INERTIAL
    armed, landed, yaw_cdeg, next_beat_ns = False, 0, 0, 0
    rows = zip(arrival, stamps.tolist(), events.kind.tolist(), events.values.tolist(), strict=True)
    for now_ns, t_ns, kind, values in rows:
        if now_ns >= next_beat_ns:
            next_beat_ns = now_ns + _SECOND_NS
            for name, fields in _status(autopilot, now_ns, armed, landed).items():
                yield now_ns, sender.message(name, **fields)
        while attitudes and attitudes[0][0] <= now_ns:
            t_ns_own, angles = attitudes.popleft()
            yield now_ns, sender.message("ATTITUDE", **_attitude(t_ns_own, *angles))

        if kind == Kind.IMU:
            fields = _imu(t_ns, values, mag, baro)
            yield now_ns, sender.message("HIGHRES_IMU", **fields, fields_updated=updated)
            updated = _INERTIAL
        elif kind == Kind.MAG:
            mag, updated = (values[0], values[1], values[2]), updated | _MAGNETOMETER
        elif kind == Kind.BARO:
            baro, updated = values[0], updated | _BAROMETER
        elif kind == Kind.GNSS:
            yield now_ns, sender.message("GPS_RAW_INT", **_fix(t_ns, values), yaw=yaw_cdeg)
        elif kind == Kind.HEADING and values[2] == HeadingSource.GNSS:
            # Sent with the next fix; 0 means that there is none, so north is 36000
            yaw_cdeg = centidegrees(values[0]) or 36000
        elif kind == Kind.HEADING and recording.reference is None:
            # Any other heading can only be sent as the autopilot's own, whose tilt is not read
            yield now_ns, sender.message("ATTITUDE", **_attitude(t_ns, 0.0, 0.0, values[0]))
        elif kind == Kind.VEHICLE:
            armed = bool(values[0])
            landed = 0 if math.isnan(values[1]) else 1 if values[1] else 2


def _attitudes(recording: Recording, zero_ns: int) -> deque[tuple[int, list[float]]]:
    """Return the recorded autopilot's own attitude with its times, ns, in order of time."""
    reference = recording.reference
    if reference is None:
        return deque()
    stamps = (reference.att_t_ns - zero_ns).tolist()
    return deque(zip(stamps, so3.to_euler(reference.q_nb).tolist(), strict=True))


def _attitude(t_ns: int, roll: float, pitch: float, yaw: float) -> dict[str, float]:
    boot_ms = t_ns // 1_000_000 & 0xFFFFFFFF
    return {"time_boot_ms": boot_ms, "roll": roll, "pitch": pitch, "yaw": yaw}


def _status(autopilot: int, now_ns: int, armed: bool, landed: int) -> dict[str, dict[str, float]]:
    mode, status = (128, 4) if armed else (0, 3)
    return {
        "HEARTBEAT": {
            "type": 2,
            "autopilot": autopilot,
            "base_mode": mode,
            "system_status": status,
            "mavlink_version": 3,
        },
        "SYSTEM_TIME": {"time_boot_ms": now_ns // 1_000_000 & 0xFFFFFFFF},
        "EXTENDED_SYS_STATE": {"landed_state": landed},
    }


def _imu(
    t_ns: int, values: list[float], mag: tuple[float, float, float], baro: float
) -> dict[str, float]:
    names = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag")
    return {
        "time_usec": t_ns // 1000,
        **dict(zip(names, [*values[:6], *mag], strict=True)),
        "abs_pressure": pressure(baro),
        "pressure_alt": baro,
    }


def _fix(t_ns: int, values: list[float]) -> dict[str, float]:
    lat, lon, alt, north, east, _, std_h, std_v, std_vel = values[:9]
    has_velocity = math.isfinite(north) and math.isfinite(east)
    return {
        "time_usec": t_ns // 1000,
        "fix_type": 3,
        "lat": round(math.degrees(lat) * 1e7),
        "lon": round(math.degrees(lon) * 1e7),
        "alt": round(alt * 1e3),
        "eph": 65535,
        "epv": 65535,
        "vel": round(math.hypot(north, east) * 1e2) if has_velocity else 65535,
        "cog": centidegrees(math.atan2(east, north)) if has_velocity else 65535,
        "satellites_visible": 255,
        "h_acc": round(std_h * 1e3),
        "v_acc": round(std_v * 1e3),
        "vel_acc": round(std_vel * 1e3) if math.isfinite(std_vel) else 0,
    }
