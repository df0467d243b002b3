"""Columns of the aids that declare themselves, in each kind of log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Mask, Stamps
from ekf_companion.nav.held_reading import held
from ekf_companion.nav.measurements import Kind

DOWN = 25
"""ROTATION_PITCH_270 (ArduPilot), ROTATION_DOWNWARD_FACING (PX4)."""
BEST = 255
"""Largest quality of optical flow; 0: nothing is seen."""
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
    late: Callable[[Table], Array] | None = None
    """Returns how long before its stamp each was true, s; None: at its stamp."""


class Logged(NamedTuple):
    """Where an aid stands in the logs."""

    csv: dict[str, str]
    """The unit of each quantity, in the order of the row; the first ones are the measurement."""
    dataflash: tuple[Columns, ...]
    """Each counts."""
    ulog: tuple[Columns, ...]
    """The first that holds a measurement counts."""
    measured: int = 1
    """How many of the quantities that are, which is nothing without them."""

    @property
    def hold(self) -> str:
        """As which a .csv may say that it holds the last value: its first quantity, or its name."""
        first = next(iter(self.csv))
        return first if self.measured == 1 else first.removesuffix("x").strip("_")


IN_BODY = 3
"""vehicle_odometry.velocity_frame: VELOCITY_FRAME_BODY_FRD."""
_POSITION, _ROTATION, _VELOCITY = (
    tuple(f"{name}[{axis}]" for axis in range(size))
    for name, size in (("position", 3), ("q", 4), ("velocity", 3))
)
DRIFT = ("xx", "yx", "yy", "zx", "zy", "zz")
"""Lower triangle of the Cholesky factor of a drift's covariance."""
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


def _of(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the flow of OF, whose quality of 0 is that of nothing seen.

    Source: ArduPilot, ``AP_OpticalFlow::Log_Write_Optflow``.
    """
    columns = [np.asarray(table[name], dtype=float) for name in _OF[1:]]
    t_ns = next(
        np.asarray(table[name]).astype(np.int64) * unit
        for name, unit in (("TimeUS", 1000), ("TimeMS", 1_000_000))
        if name in table
    )
    return _flow(t_ns, np.asarray(table["Qual"]), *columns)


def _optical_flow(topic: Table, flow: str, gyro: str, span: str) -> tuple[Mask, tuple[Array, ...]]:
    """Return the flow that a topic holds as integrals over an interval."""
    seconds = np.asarray(topic[span], dtype=float) * 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        columns = [
            np.asarray(topic[name.format(axis=axis, number=number)], dtype=float) / seconds
            for name in (flow, gyro)
            for number, axis in enumerate("xy")
        ]
    us = topic["timestamp"] if "timestamp" in topic else topic["t_ns"] // 1000
    t_ns = np.asarray(us).astype(np.int64) * 1000
    return _flow(t_ns, np.asarray(topic["quality"]), *columns)


def _flow(
    t_ns: Stamps, quality: Array, x: Array, y: Array, gyro_x: Array, gyro_y: Array
) -> tuple[Mask, tuple[Array, ...]]:
    good = (quality > 0) & np.isfinite(x) & np.isfinite(y) & ~held(t_ns, x, y)
    unknown = ~(np.isfinite(gyro_x) & np.isfinite(gyro_y))
    gyro = (np.where(unknown, np.nan, one) for one in (gyro_x, gyro_y))
    return good, (x, y, *gyro, quality / BEST, np.full(len(x), np.nan))


def _topic(name: str, flow: str, gyro: str, span: str) -> Columns:
    """Return where the flow stands in a topic: names of its fields by axis and its number."""
    fields = [
        one.format(axis=axis, number=n) for one in (flow, gyro) for n, axis in enumerate("xy")
    ]

    def half(topic: Table) -> Array:
        return np.asarray(topic[span], dtype=float) * 0.5e-6

    def read(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
        return _optical_flow(topic, flow, gyro, span)

    return Columns(name, (*fields, span, "quality"), read, half)


def _beacon(number: int) -> Columns:
    """Return where the range to a beacon stands in BCN; the log has the places of none.

    Source: ArduPilot, ``AP_Beacon/LogStructure.h``: 0 is no range.
    """
    name = f"D{number}"

    def read(table: Table) -> tuple[Mask, tuple[Array, ...]]:
        found = np.asarray(table[name], dtype=float)
        count, health = np.asarray(table["Cnt"]), np.asarray(table["Health"])
        unknown = np.full(len(found), np.nan)
        good = (found > 0.0) & (count > number) & (health > 0)
        return good, (found, np.full(len(found), float(number)), *(unknown,) * 5)

    return Columns("BCN", ("Health", "Cnt", *(f"D{n}" for n in range(4))), read)


_OF = ("Qual", "flowX", "flowY", "bodyX", "bodyY")
_FLOW_TOPICS = (
    _topic(
        "vehicle_optical_flow",
        "pixel_flow[{number}]",
        "delta_angle[{number}]",
        "integration_timespan_us",
    ),
    _topic(
        "optical_flow",
        "pixel_flow_{axis}_integral",
        "gyro_{axis}_rate_integral",
        "integration_timespan",
    ),
)
"""PX4, ``VehicleOpticalFlow.msg``, before 1.14 ``optical_flow.msg``: by the axes of the body."""


def _visp(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the poses of VISP that were not ignored, by their north, east, down.

    Source: ArduPilot, ``AP_VisualOdom/LogStructure.h``: angles in degrees. What it calls the error
    is no sigma. Yaw is Y in newer logs, Yaw in older ones, the counter Rst or RstCnt; the oldest do
    not say whether a pose was ignored.
    """
    place = [np.asarray(table[name], dtype=float) for name in ("PX", "PY", "PZ")]
    unknown = np.full(len(place[0]), np.nan)
    yaw = np.asarray(table.get("Y", table.get("Yaw", unknown)), dtype=float)
    good = np.isfinite(sum(place)) & _is_used(table, len(yaw))
    counter = _counter(table, "Rst" if "Rst" in table else "RstCnt", unknown)
    return good, (*place, so3.wrap(np.radians(yaw)), unknown, unknown, counter)


def _visv(table: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the velocities of VISV that were not ignored, north, east, down of its frame."""
    speed = [np.asarray(table[name], dtype=float) for name in ("VX", "VY", "VZ")]
    good = np.isfinite(sum(speed)) & _is_used(table, len(speed[0]))
    return good, (*speed, np.full(len(good), np.nan), np.ones(len(good)))


def _is_used(table: Table, size: int) -> Mask:
    ignored = np.asarray(table.get("Ign", np.zeros(size)))
    return np.asarray((ignored == 0) & (np.asarray(table.get("Q", np.zeros(size))) >= 0))


def _counter(table: Table, name: str, unknown: Array) -> Array:
    return np.asarray(table.get(name, unknown), dtype=float)


def _place(topic: Table, names: Sequence[str]) -> list[Array]:
    return [np.asarray(topic[name], dtype=float) for name in names]


def _visual_pose(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return the poses of vehicle_visual_odometry, whose frames are all north or forward, down."""
    place, q = _place(topic, _POSITION), np.stack(_place(topic, _ROTATION), axis=-1)
    known = np.abs(np.linalg.norm(q, axis=-1) - 1.0) < 0.05
    yaw = np.full(len(q), np.nan)
    yaw[known] = so3.to_euler(q[known] / np.linalg.norm(q[known], axis=-1)[:, None])[:, 2]
    unknown = np.full(len(yaw), np.nan)
    std = _mean_std(topic, "position_variance", unknown)
    quality = np.asarray(topic.get("quality", np.zeros(len(yaw))))
    good = np.isfinite(sum(place)) & (quality >= 0)
    counter = _counter(topic, "reset_counter", unknown)
    return good, (*place, yaw, std, unknown, counter)


def _visual_velocity(topic: Table) -> tuple[Mask, tuple[Array, ...]]:
    """Return its velocities, in the body where it says so."""
    speed = _place(topic, _VELOCITY)
    frame = np.asarray(topic["velocity_frame"])
    quality = np.asarray(topic.get("quality", np.zeros(len(frame))))
    good = np.isfinite(sum(speed)) & (frame > 0) & (quality >= 0)
    std = _mean_std(topic, "velocity_variance", np.full(len(frame), np.nan))
    return good, (*speed, std, (frame != IN_BODY).astype(float))


def _mean_std(topic: Table, name: str, unknown: Array) -> Array:
    names = [f"{name}[{axis}]" for axis in range(3)]
    if not {*names} <= {*topic}:
        return unknown
    variance = np.mean(_place(topic, names), axis=0)
    return np.sqrt(np.where(variance > 0.0, variance, np.nan))


LOGGED = {
    Kind.RANGE: Logged(
        {"range": "m", "range_std": "m"},
        (Columns("RFND", (), _rfnd),),
        (Columns("distance_sensor", _FIELDS, _distance_sensor),),
    ),
    Kind.AIRSPEED: Logged(
        {"airspeed": "m/s", "airspeed_std": "m/s"},
        (Columns("ARSP", ("Airspeed",), _arsp),),
        (
            Columns("airspeed_validated", ("true_airspeed_m_s",), _airspeed_validated),
            Columns("airspeed", ("true_airspeed_m_s",), _airspeed),
        ),
    ),
    Kind.WHEEL: Logged(
        {"wheel_speed": "m/s", "wheel_speed_std": "m/s"},
        (Columns("WENC", ("Dist0", "Dist1"), _wenc),),
        (),
    ),
    Kind.FLOW: Logged(
        {
            "flow_x": "rad/s",
            "flow_y": "rad/s",
            "flow_gyro_x": "rad/s",
            "flow_gyro_y": "rad/s",
            "flow_quality": "1",
            "flow_std": "rad/s",
        },
        (Columns("OF", _OF, _of),),
        _FLOW_TOPICS,
    ),
    Kind.ANCHOR: Logged(
        {
            "anchor_range": "m",
            "anchor": "1",
            "anchor_north": "m",
            "anchor_east": "m",
            "anchor_down": "m",
            "anchor_is_geodetic": "1",
            "anchor_std": "m",
        },
        tuple(_beacon(number) for number in range(4)),
        (),
    ),
    Kind.POSE: Logged(
        {
            **dict.fromkeys(("odometry_x", "odometry_y", "odometry_z"), "m"),
            "odometry_yaw": "rad",
            "odometry_std": "m",
            "odometry_yaw_drift": "rad",
            "odometry_counter": "1",
            **dict.fromkeys((f"odometry_drift_{one}" for one in DRIFT), "m"),
        },
        (Columns("VISP", ("PX", "PY", "PZ"), _visp),),
        (Columns("vehicle_visual_odometry", (*_POSITION, *_ROTATION), _visual_pose),),
        measured=3,
    ),
    Kind.VELOCITY: Logged(
        {
            **dict.fromkeys(("odometry_vx", "odometry_vy", "odometry_vz"), "m/s"),
            "odometry_v_std": "m/s",
            "odometry_v_is_level": "1",
        },
        (Columns("VISV", ("VX", "VY", "VZ"), _visv),),
        (Columns("vehicle_visual_odometry", (*_VELOCITY, "velocity_frame"), _visual_velocity),),
        measured=3,
    ),
}
"""By kind."""
DATAFLASH = tuple((kind, columns) for kind, one in LOGGED.items() for columns in one.dataflash)
"""Where each stands, by kind."""
_TOPICS = [(kind, topic) for kind, one in LOGGED.items() for topic in one.ulog]
ULOG = {
    name: [one for one in _TOPICS if one[1].name == name]
    for name in dict.fromkeys(topic.name for _, topic in _TOPICS)
}
"""By topic; of those of a kind the first that holds a measurement counts."""
CSV = LOGGED
"""By kind."""
