"""Reading of PX4's logs (.ulg) into a recording.

Both generations of names are read: position as
``lat, lon`` (1e-7 deg), ``alt`` (mm) and as ``latitude_deg, longitude_deg, altitude_msl_m``.
Logs of PX4 before 1.8 hold magnetometer and barometer within ``sensor_combined``.
Of several sensors the one in use is read, of other topics the first instance. Rows count as arrived
in the order in which they were published (``timestamp``).

Source: PX4-Autopilot msg/*.msg (fields, units, states), src/lib/geo/geo.cpp (projection).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import LogError
from ekf_companion.logs import aids, receiver_time, series
from ekf_companion.logs.inertial_units import STDS
from ekf_companion.logs.recording import (
    CUT,
    Damage,
    Recording,
    counted,
    cut_off,
    cut_short,
)
from ekf_companion.logs.series import FIX_3D, GNSS_HEADING_STD, HEADING_RATE, HEADING_STD
from ekf_companion.logs.ulog_instances import PLACE
from ekf_companion.logs.ulog_messages import Messages
from ekf_companion.logs.ulog_topics import (
    Stored,
    Topic,
    Topics,
    choose,
    columns_of,
    combined,
    load,
    rotations,
    sample_ns,
    stamps_of,
    vectors,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, known_rows
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.event_columns import (
    Arrivals,
    EventColumns,
    EventSource,
    MergedEvents,
    sources_of,
)
from ekf_companion.nav.measurements import GnssFlag, HeadingSource, Kind, VehicleType
from ekf_companion.nav.state import Trajectory

STREAMED = ("sensor_combined", "vehicle_magnetometer", "sensor_mag", "vehicle_air_data")
"""Topics whose rows are never in memory all at once."""
GNSS_STD_UNKNOWN = {"eph": 2.0, "epv": 3.0, "s_variance_m_s": 0.5}
"""m, m, m/s where the receiver gives no accuracy: a receiver in the open, rounded up."""
JAMMING_CRITICAL = 3
"""sensor_gps.jamming_state: 0 unknown, 1 ok, 2 warning (fix still good), 3 critical."""
SPOOFING_INDICATED = 2
"""sensor_gps.spoofing_state: 0 unknown, 1 none, 2 indicated, 3 multiple indications."""
ARMED = 2
"""vehicle_status.arming_state: 1 disarmed (standby), 2 armed."""
SAME_TIME = 0.005
"""Largest difference, s, of two stamps of the same time: PX4's driver and the topic made of it."""
_MOVES = np.array(
    [
        float(one)
        for one in (
            VehicleType.UNKNOWN,
            VehicleType.ROTARY,
            VehicleType.FIXED_WING,
            VehicleType.GROUND,
            VehicleType.OTHER,
        )
    ]
)
"""By vehicle_status.vehicle_type, which of one that can hover follows how it flies."""
FIRST_ULOG, FIRST_DEGREES = "2016-05", "2023-01"
"""Dates at which PX4 began to write such logs, and to write fixes in degrees (PX4 1.14)."""
EARTH_RADIUS = 6371000.0
"""m; of the sphere that PX4 projects on (CONSTANTS_RADIUS_OF_EARTH)."""


@np.errstate(invalid="ignore", over="ignore")  # damaged bytes make any number
def read(path: Path) -> Recording:
    """Read a log into events, EKF2's estimate and, from a simulator, the truth.

    A log may lack inertial or GNSS topics; its events then lack them too.

    Raises:
        LogError: The file is not a ULog, or holds none of the topics that are used.
    """
    log = load(path)
    notes = [*log.notes]
    if log.is_damaged:
        notes.append("the file is damaged: what could not be read is lost")
    if log.rest:
        notes.append(cut_off(log.rest, "message"))
    if lost := sum(log.dropouts):
        count = len(log.dropouts)
        dropouts = counted(count, "dropout")
        notes.append(f"{dropouts}, {lost:.1f} s in all, while the log was written")
    stored, extent_ns, misfit = choose(log, notes)
    topics = {name: columns_of(rows.all()) for name, rows in stored.items() if name not in STREAMED}
    gnss_delay, is_taken_off = _gnss_delay(log, _receiver(topics))
    if is_taken_off:
        _receiver(topics).pop("timestamp_sample")

    def streamed(name: str, take: Callable[[Topic], Arrivals]) -> Sequence[EventSource]:
        """Return the source of a topic's events, which arrive when they are published."""
        if (rows := stored.get(name)) is None:
            return ()

        @np.errstate(invalid="ignore", over="ignore")
        def read(first: int, end: int) -> Arrivals:
            return take(columns_of(rows.read(first, end)))

        return (EventSource(len(rows), read),)

    sources = [*streamed("sensor_combined", _imu)]
    sources += sources_of([*_gnss_heading(topics), *_attitude_heading(topics)])
    if (fused := combined(stored, "magnetometer", "magnetometer_ga[0]")) is not None:
        sources += sources_of(_magnetometer(fused))
    else:
        is_first = "vehicle_magnetometer" in stored
        sources += streamed("vehicle_magnetometer" if is_first else "sensor_mag", _magnetometer)
    if (fused := combined(stored, "baro", "baro_alt_meter")) is not None:
        sources += sources_of(_barometer(fused))
    else:
        sources += streamed("vehicle_air_data", _barometer)
    found: set[Kind] = set()
    for name, read_by in aids.ULOG.items():
        for kind, aid in read_by:
            topic = topics.get(name)
            if topic is None or kind in found or not {*aid.needed} <= {*topic}:
                continue
            valid, columns = aid.read(topic)
            late = 0.0 if aid.late is None else aid.late(topic)
            sources += sources_of(_events(topic, kind, valid, *columns, late=late))
            found |= {kind} if valid.any() else set()
    sources += sources_of([*_vehicle(topics), *_gnss(topics, notes)])
    events = MergedEvents(sources)
    if not len(events) and not log.subscriptions:
        raise cut_short(path, path.stat().st_size)
    if not len(events):
        raise LogError(
            f"{path}: a ULog without sensor_combined, GPS, magnetometer, barometer and attitude "
            "topics; log with the default or estimator replay profile (SDLOG_PROFILE)"
        )
    zero_ns = _utc_zero_ns(topics, notes)
    return Recording(
        family="px4",
        events=events,
        reference=_trajectory(topics, "", "EKF2"),
        truth=_trajectory(topics, "_groundtruth", "simulator"),
        gnss_delay=gnss_delay,
        notes=tuple(notes),
        damage=_damage(log, stored).beside(misfit),
        lost_share=misfit.share,
        extent_ns=extent_ns,
        onboard=log.onboard(),
        began_s=_began_s(stored, zero_ns),
        utc_zero_ns=zero_ns,
    )


def _gnss_delay(log: Messages, topic: Topic) -> tuple[float | None, bool]:
    """Return the receiver's delay, s, and whether it has been subtracted in ``timestamp_sample``.

    PX4 1.18 subtracts SENS_GPS0_DELAY (before: EKF2_GPS_DELAY, in its filter only) from the time of
    publication, unless the receiver itself reports the time of a fix: then there is no delay.

    Source: PX4 1.18, ``VehicleGPSPosition.cpp``.
    """
    said = log.parameters.get("SENS_GPS0_DELAY", log.parameters.get("EKF2_GPS_DELAY", -1.0))
    delay = float(said) * 1e-3 if 0.0 <= said <= 1000.0 else None
    if not len(topic.get("timestamp_sample", ())):
        return delay, False
    earlier = float(np.median(topic["t_ns"] - sample_ns(topic))) * 1e-9
    if earlier < SAME_TIME:
        return delay, False
    is_taken_off = delay is not None and abs(earlier - delay) < SAME_TIME
    return (delay, True) if is_taken_off else (0.0, False)


def _damage(log: Messages, stored: Stored) -> Damage:
    """Return what was not read, or not written, and its share of the log's time."""
    words, share = (["the file is damaged"], 1.0) if log.is_damaged else ([], 0.0)
    if lost := sum(log.dropouts):
        count = len(log.dropouts)
        words.append(f"{counted(count, 'dropout')} ({lost:.1f} s)")
        limits = [
            (
                min(part.min() for part in stamps_of(rows)),
                max(part.max() for part in stamps_of(rows)),
            )
            for rows in stored.values()
        ]
        spans = [(last - first) * 1e-9 for first, last in limits]
        share = max(share, lost / max(lost, *spans, 1.0))
    words += [CUT] if log.rest else []
    return Damage(", ".join(words), share)


def _began_s(stored: Stored, zero_ns: int | None) -> float | None:
    """Return the time at which the log began, s since 1970, UTC."""
    if zero_ns is None:
        return None
    firsts = [series.nanoseconds(rows.read(0, 1)["timestamp"]) for rows in stored.values()]
    return (zero_ns + min(int(t_ns[0]) for t_ns in firsts)) * 1e-9


def _utc_zero_ns(topics: Topics, notes: list[str]) -> int | None:
    """Return the UTC at which the clock was zero, by the receiver."""
    topic = _receiver(topics)
    if "time_utc_usec" not in topic:
        return None
    earliest = FIRST_DEGREES if "latitude_deg" in topic else FIRST_ULOG
    is_fix = np.asarray(topic["fix_type"] >= FIX_3D)
    utc_ns = series.nanoseconds(topic["time_utc_usec"])
    return receiver_time.utc_zero_ns(utc_ns, topic["t_ns"], is_fix, earliest, notes)


def _events(
    topic: Topic, kind: Kind, mask: Mask, *columns: Any, late: Array | float = 0.0
) -> Arrivals:
    """Build events stamped by the topic's sample time, or where absent its publication.

    They were true ``late`` seconds before.
    """
    if not mask.any():
        return []
    t_ns = sample_ns(topic) - np.rint(np.asarray(late) * 1e9).astype(np.int64)
    events = EventColumns(t_ns, kind, *columns)
    return [(events.take(mask), topic["t_ns"] if mask.all() else topic["t_ns"][mask])]


def _imu(topic: Topic) -> Arrivals:
    names = [f"{name}[{axis}]" for name in ("gyro_rad", "accelerometer_m_s2") for axis in range(3)]
    names += STDS if STDS[0] in topic else ()
    columns = [topic[name] for name in names]
    known = np.ones(len(topic["t_ns"]), dtype=bool)
    for column in columns:
        known &= np.isfinite(column)
    return _events(topic, Kind.IMU, known, *columns)


def _receiver(topics: Topics) -> Topic:
    """Return the topic that EKF2 uses, or the receiver's own."""
    return topics.get("vehicle_gps_position") or topics.get("sensor_gps") or {}


def _gnss(topics: Topics, notes: list[str]) -> Arrivals:
    topic = _receiver(topics)
    if {"latitude_deg", "longitude_deg", "altitude_msl_m"} <= topic.keys():
        lat_deg, lon_deg = topic["latitude_deg"], topic["longitude_deg"]
        alt = np.asarray(topic["altitude_msl_m"], dtype=float)
    elif {"lat", "lon", "alt"} <= topic.keys():
        lat_deg, lon_deg = topic["lat"] * 1e-7, topic["lon"] * 1e-7
        alt = topic["alt"] * 1e-3
    else:
        return []
    n = len(alt)
    is_fix = (topic["fix_type"] >= FIX_3D) & is_place(lat_deg, lon_deg) & np.isfinite(alt)
    velocity = [np.asarray(topic[f"vel_{axis}_m_s"], dtype=float) for axis in "ned"]
    has_vel = np.isfinite(velocity).all(axis=0)
    if "vel_ned_valid" in topic:
        has_vel &= topic["vel_ned_valid"] != 0
    unknown = np.zeros(n)
    suspect = topic.get("jamming_state", unknown) >= JAMMING_CRITICAL
    suspect |= topic.get("spoofing_state", unknown) >= SPOOFING_INDICATED
    if not is_fix.all():
        notes.append(f"{n - int(is_fix.sum())} GPS rows without a 3-D fix were left out")
    if doubted := int((is_fix & suspect).sum()):
        notes.append(f"the receiver reports jamming or spoofing in {doubted} fixes")
    std_h, std_v, std_vel = (
        series.accuracy(topic.get(field, unknown), otherwise)
        for field, otherwise in GNSS_STD_UNKNOWN.items()
    )
    return _events(
        topic,
        Kind.GNSS,
        is_fix,
        np.deg2rad(np.where(is_fix, lat_deg, 0.0)),
        so3.wrap(np.deg2rad(np.where(is_fix, lon_deg, 0.0))),
        alt,
        *(np.where(has_vel, axis, np.nan) for axis in velocity),
        std_h,
        std_v,
        np.where(has_vel, std_vel, np.nan),
        np.nan,
        np.where(suspect, float(GnssFlag.SUSPECT), float(GnssFlag.NONE))
        + np.where(topic.get(PLACE, unknown) > 0, float(GnssFlag.SECOND), 0.0),
    )


def _gnss_heading(topics: Topics) -> Arrivals:
    topic = _receiver(topics)
    if "heading" not in topic:
        return []
    heading = np.asarray(topic["heading"], dtype=float)
    valid = np.isfinite(heading) & (topic["fix_type"] >= FIX_3D)
    std = series.accuracy(topic.get("heading_accuracy", 0.0 * heading), GNSS_HEADING_STD)
    heading = so3.wrap(np.where(valid, heading, 0.0))
    return _events(topic, Kind.HEADING, valid, heading, std, float(HeadingSource.GNSS))


def _attitude_heading(topics: Topics) -> Arrivals:
    if (topic := topics.get("vehicle_attitude")) is None:
        return []
    stride = series.thinned(topic["t_ns"], HEADING_RATE)
    topic = {field: column[stride] for field, column in topic.items()}
    valid, q_nb = rotations(topic)
    yaw, source = so3.wrap(so3.to_euler(q_nb)[:, 2]), float(HeadingSource.AUTOPILOT)
    return _events(topic, Kind.HEADING, valid, yaw, HEADING_STD, source)


def _magnetometer(topic: Topic) -> Arrivals:
    is_array = "magnetometer_ga[0]" in topic
    field = vectors(topic, "magnetometer_ga") if is_array else series.stack(topic, *"xyz")
    valid = known_rows(field)
    if PLACE not in topic:
        return _events(topic, Kind.MAG, valid, *field.T)
    return _events(topic, Kind.MAG, valid, *field.T, topic[PLACE].astype(float))


def _barometer(topic: Topic) -> Arrivals:
    alt = np.asarray(topic["baro_alt_meter"], dtype=float)
    return _events(topic, Kind.BARO, np.asarray(np.isfinite(alt)), alt)


def _vehicle(topics: Topics) -> Arrivals:
    """Return armed and landed, and how the vehicle moves, at each change of one of them."""
    if (topic := topics.get("vehicle_status")) is None:
        return []
    t_ns, armed = topic["t_ns"], topic["arming_state"] == ARMED
    number = np.asarray(topic.get("vehicle_type", np.zeros(len(t_ns))), dtype=int)
    moves = _MOVES[np.clip(number, 0, len(_MOVES) - 1)]
    landed = np.full(len(t_ns), np.nan)
    if (other := topics.get("vehicle_land_detected")) is not None:
        union = np.unique(np.concatenate([t_ns, other["t_ns"]]))
        now = np.clip(np.searchsorted(t_ns, union, side="right") - 1, 0, None)
        armed, moves = armed[now], moves[now]
        before = np.searchsorted(other["t_ns"], union, side="right") - 1
        landed = np.where(before < 0, np.nan, other["landed"][np.clip(before, 0, None)] != 0)
        t_ns = union
    news = series.changed(armed, landed, moves)
    events = EventColumns(t_ns, Kind.VEHICLE, armed, landed, 0.0, 0.0, moves)
    return [(events.take(news), t_ns[news])]


def _unproject(x: Array, y: Array, ref_lat: Array, ref_lon: Array) -> tuple[Array, Array]:
    """Return latitude and longitude, rad, of metres north and east of a reference, rad.

    Source: Snyder 1987, "Map projections: a working manual", (20-14), (20-15), azimuthal
    equidistant on a sphere, as PX4's MapProjection::reproject has it.
    """
    c = np.hypot(x, y) / EARTH_RADIUS
    scale = np.sinc(c / np.pi) / EARTH_RADIUS  # numpy's sinc(x) is sin(pi x) / (pi x)
    north, east = x * scale, y * scale
    lat = np.arcsin(np.clip(np.cos(c) * np.sin(ref_lat) + north * np.cos(ref_lat), -1.0, 1.0))
    dlon = np.arctan2(east, np.cos(ref_lat) * np.cos(c) - north * np.sin(ref_lat))
    return lat, so3.wrap(ref_lon + dlon)


def _trajectory(topics: Topics, suffix: str, name: str) -> Trajectory | None:
    """Return the trajectory in the topics with a suffix: EKF2's estimate, or the truth."""
    attitude = topics.get(f"vehicle_attitude{suffix}", {})
    local = topics.get(f"vehicle_local_position{suffix}", {})
    if not attitude and not local:
        return None
    parts: dict[str, npt.NDArray[Any]] = {}
    if attitude:
        valid, q_nb = rotations(attitude)
        att_t_ns = sample_ns(attitude)
        valid &= series.ascending(att_t_ns)
        parts |= {"att_t_ns": att_t_ns[valid], "q_nb": q_nb[valid]}
    if "vx" in local:
        vel_n = series.stack(local, "vx", "vy", "vz")
        for valid_field, axes in (("v_xy_valid", slice(0, 2)), ("v_z_valid", slice(2, 3))):
            if valid_field in local:
                vel_n[local[valid_field] == 0, axes] = np.nan
        vel_t_ns = sample_ns(local)
        known = np.isfinite(vel_n).any(axis=1) & series.ascending(vel_t_ns)
        parts |= {"vel_t_ns": vel_t_ns[known], "vel_n": vel_n[known]}
    parts |= _positions(local, topics.get(f"vehicle_global_position{suffix}", {}))
    words = f"vehicle_attitude{suffix}, vehicle_local_position{suffix}"
    return Trajectory(name=f"{name} ({words})", **parts)


def _positions(local: Topic, world: Topic) -> dict[str, npt.NDArray[Any]]:
    """Return the position fields of a trajectory, preferably of the local topic: it is faster."""
    if "ref_lat" in local:
        x, y, z = (np.asarray(local[axis], dtype=float) for axis in "xyz")
        ref_lat, ref_lon = np.deg2rad(local["ref_lat"]), np.deg2rad(local["ref_lon"])
        valid = np.isfinite([x, y, ref_lat, ref_lon]).all(axis=0)
        for field in ("xy_valid", "xy_global"):
            valid &= local[field] != 0 if field in local else True
        t_ns = sample_ns(local)
        valid &= series.ascending(t_ns) & (np.hypot(np.nan_to_num(x), np.nan_to_num(y)) < 1e7)
        if valid.any():
            alt = np.asarray(local["ref_alt"], dtype=float) - z
            if "z_valid" in local:
                alt = np.where(local["z_valid"] != 0, alt, np.nan)
            lat, lon = _unproject(x[valid], y[valid], ref_lat[valid], ref_lon[valid])
            return {"pos_t_ns": t_ns[valid], "lat": lat, "lon": lon, "alt": alt[valid]}
    if "lat" in world:
        t_ns = sample_ns(world)
        lat, lon = np.deg2rad(world["lat"]), np.deg2rad(world["lon"])
        alt = np.asarray(world["alt"], dtype=float)
        valid = np.isfinite(lat) & np.isfinite(lon) & series.ascending(t_ns)
        lat, lon, alt = lat[valid], so3.wrap(lon[valid]), alt[valid]
        return {"pos_t_ns": t_ns[valid], "lat": lat, "lon": lon, "alt": alt}
    return {}
