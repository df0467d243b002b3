"""Measurements in SI, as objects (live) and as rows of one table (recorded).

A stamp is what the sensor's message carries, on the autopilot's clock. Its delay is calibrated, not
reported: the pipeline subtracts it in one place, so that a measurement counts at the time when it
was true.

One event is one row: stamp, kind and ``WIDTH`` numbers. The objects below and the rows hold the
same; ``row()`` is the only way from one to the other. In a row NaN means "not known".
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps

WIDTH = 13
"""Numbers in a row."""

Row = tuple[int, int, tuple[float, ...]]
"""Stamp (ns), kind, ``WIDTH`` values."""


GNSS_POSITION, GNSS_VELOCITY, GNSS_STD = slice(0, 3), slice(3, 6), slice(6, 9)
GNSS_DECLINATION, GNSS_FLAGS, GNSS_INCLINATION, GNSS_FIELD = 9, 10, 11, 12
"""Columns of the row of a :class:`GnssFix`."""

NULL_ISLAND = math.radians(1.0)
"""Latitude and longitude within which an autopilot's own position is none, rad. Before its first
fix ArduPilot's fallback dead reckons from 0, 0: by 30 km in a quarter of an hour at 30 m/s. The
nearest land is 570 km away. A receiver's own fix is refused at 0, 0 itself only."""


class Kind(IntEnum):
    """The kind of an event. At one time they are processed in this order, the inertial last."""

    RESTART = 0
    """The autopilot's clock restarted, or was set. Row: 1 if all else continues, or 0."""
    GNSS = 1
    HEADING = 2
    MAG = 3
    BARO = 4
    VEHICLE = 5
    RANGE = 6
    AIRSPEED = 7
    WHEEL = 8
    FLOW = 9
    ANCHOR = 10
    POSE = 11
    """Of another estimator, in a frame of its own."""
    VELOCITY = 12
    """Of another estimator."""
    IMU = 13


class HeadingSource(IntEnum):
    """The source of a heading; of several that are present, the lowest number is used."""

    GNSS = 0
    """Dual-antenna receiver."""
    MAGNETOMETER = 1
    """A compass that computes the heading itself (its field would be ``Kind.MAG``)."""
    AUTOPILOT = 2
    """The autopilot's own estimate: not independent of the sensors that are used here too."""


class VehicleType(IntEnum):
    """How a vehicle moves: what an aid may assume of it."""

    UNKNOWN = 0
    FIXED_WING = 1
    """It flies on its wings now, where the air comes from ahead."""
    ROTARY = 2
    GROUND = 3
    """It rolls on wheels or tracks, along its own axis."""
    OTHER = 4
    """A boat, a balloon, a vehicle between hover and flight."""


class GnssFlag(IntFlag):
    """Flags that a receiver, or the decoder, attaches to a fix."""

    NONE = 0
    DERIVED = 1
    """From the autopilot's fused output (GLOBAL_POSITION_INT): not an independent measurement."""
    SUSPECT = 2
    """The receiver reports jamming or spoofing."""
    SECOND = 4
    """From the second receiver (GPS2_RAW), which is the fallback of the first."""


def make_row(t_ns: int, kind: Kind, *values: float | None) -> Row:
    """Return a row of some numbers, of which None is not known."""
    filled = tuple(math.nan if value is None else float(value) for value in values)
    return t_ns, int(kind), filled + (0.0,) * (WIDTH - len(filled))


_IMU = int(Kind.IMU)
_REST_OF_SAMPLE = (0.0,) * (WIDTH - 11)


@dataclass(frozen=True, slots=True, kw_only=True)
class Restart:
    """The autopilot rebooted or its clock was set: all later stamps count on the new clock."""

    t_ns: int = 0
    """Not used."""
    goes_on: bool = False
    """Only the clock was set: the next inertial sample follows the last. False: no earlier stamp
    can be compared with a later one."""

    def row(self) -> Row:
        """Return the row [goes on]."""
        return make_row(self.t_ns, Kind.RESTART, float(self.goes_on))


class ImuSample(NamedTuple):
    """Angular rate and specific force in the body frame. Row: the fields in this order."""

    t_ns: int
    gyro_x: float
    """rad/s, forward."""
    gyro_y: float
    """rad/s, right."""
    gyro_z: float
    """rad/s, down."""
    accel_x: float
    """m/s^2, forward."""
    accel_y: float
    """m/s^2, right."""
    accel_z: float
    """m/s^2, down: about -9.81 at rest and level."""
    gyro_std: float = 0.0
    """The first sample of another unit: one sigma of how its biases differ from those of the unit
    before, rad/s; 0: it is the same unit."""
    accel_std: float = 0.0
    """m/s^2."""
    turned: float = 0.0
    """By how much the unit before was wrong until then, rad."""
    gained: float = 0.0
    """m/s."""
    is_late: float = 0.0
    """1: others before it had later stamps, and the clock goes on; 0: the stamps alone tell."""

    def row(self) -> Row:
        """Return the row [gyro x y z, accel x y z, std of both, turned, gained, is late]."""
        return self.t_ns, _IMU, self[1:] + _REST_OF_SAMPLE


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssFix:
    """Position and, where the receiver gives it, velocity of the antenna."""

    t_ns: int
    lat: float
    """WGS-84 latitude, rad."""
    lon: float
    """WGS-84 longitude, rad, in [-pi, pi)."""
    alt: float
    """Above mean sea level, m."""
    vel_north: float | None = None
    """m/s; None: not known (east then too)."""
    vel_east: float | None = None
    """m/s."""
    vel_down: float | None = None
    """m/s; None: the source has no vertical velocity."""
    std_h: float
    """One sigma of the position per horizontal axis, m, > 0."""
    std_v: float
    """One sigma of the altitude, m, > 0."""
    std_vel: float | None = None
    """One sigma of the velocity per axis, m/s, > 0; None: not known."""
    declination: float | None = None
    """Magnetic declination here, rad, east positive; None: not known."""
    flags: GnssFlag = GnssFlag.NONE
    inclination: float | None = None
    """Dip of the magnetic field here, rad, down positive; None: not known."""
    field: float | None = None
    """Strength of the magnetic field here, gauss; None: not known."""

    def row(self) -> Row:
        """Return [lat lon alt, vel n e d, std h v vel, declination, flags, inclination, field]."""
        position = (self.lat, self.lon, self.alt)
        velocity = (self.vel_north, self.vel_east, self.vel_down)
        stds = (self.std_h, self.std_v, self.std_vel)
        field = (self.declination, float(self.flags), self.inclination, self.field)
        return make_row(self.t_ns, Kind.GNSS, *position, *velocity, *stds, *field)


@dataclass(frozen=True, slots=True, kw_only=True)
class HeadingSample:
    """Heading of the body's forward axis."""

    t_ns: int
    heading: float
    """From true north, clockwise, rad, in [-pi, pi)."""
    std: float
    """One sigma, rad, > 0."""
    source: HeadingSource

    def row(self) -> Row:
        """Return the row [heading, std, source]."""
        return make_row(self.t_ns, Kind.HEADING, self.heading, self.std, float(self.source))


@dataclass(frozen=True, slots=True, kw_only=True)
class MagSample:
    """Magnetic field in the body frame, as the autopilot calibrated it."""

    t_ns: int
    mag_x: float
    """gauss, forward."""
    mag_y: float
    """gauss, right."""
    mag_z: float
    """gauss, down."""
    compass: int = 0
    """Which one measured it; 0: the first."""

    def row(self) -> Row:
        """Return the row [mag x y z, compass]."""
        return make_row(self.t_ns, Kind.MAG, self.mag_x, self.mag_y, self.mag_z, self.compass)


@dataclass(frozen=True, slots=True, kw_only=True)
class BaroSample:
    """Pressure altitude: its differences count, its zero is unknown."""

    t_ns: int
    alt: float
    """Altitude of the standard atmosphere at this pressure, m, up."""

    def row(self) -> Row:
        """Return the row [alt]."""
        return make_row(self.t_ns, Kind.BARO, self.alt)


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeSample:
    """Distance to the ground along the body's down axis."""

    t_ns: int
    range: float
    """m, > 0."""
    std: float | None = None
    """One sigma, m, > 0; None: not known."""

    def row(self) -> Row:
        """Return the row [range, std]."""
        return make_row(self.t_ns, Kind.RANGE, self.range, self.std)


@dataclass(frozen=True, slots=True, kw_only=True)
class AirspeedSample:
    """Speed through the air, of a pitot tube."""

    t_ns: int
    airspeed: float
    """m/s; below a few m/s it is noise, and may be negative."""
    std: float | None = None
    """One sigma, m/s, > 0; None: not known."""
    is_indicated: bool = False
    """It is indicated or calibrated airspeed, which is less in thin air; else the true one."""

    def row(self) -> Row:
        """Return the row [airspeed, std, whether it is indicated]."""
        return make_row(self.t_ns, Kind.AIRSPEED, self.airspeed, self.std, float(self.is_indicated))


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSample:
    """Speed along the vehicle's axis by its wheels."""

    t_ns: int
    speed: float
    """m/s; backwards it is negative."""
    std: float | None = None
    """One sigma, m/s, > 0; None: not known."""

    def row(self) -> Row:
        """Return the row [speed, std]."""
        return make_row(self.t_ns, Kind.WHEEL, self.speed, self.std)


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowSample:
    """Angular rates of the ground across the image of a camera that looks down.

    By the axes of the sensor: a right-hand rotation of the sensor about an axis over a fixed scene
    gives a positive rate about it, as OPTICAL_FLOW_RAD has it. So motion forward over the ground
    gives a positive rate about y, motion to the right a negative one about x.
    """

    t_ns: int
    """Middle of the interval over which the rates are means."""
    flow_x: float
    """rad/s."""
    flow_y: float
    """rad/s."""
    gyro_x: float | None = None
    """Mean rate of the sensor's own gyro over the same interval, rad/s; None: not known."""
    gyro_y: float | None = None
    """rad/s."""
    quality: float | None = None
    """From 0, nothing seen, to 1; None: not known."""
    std: float | None = None
    """One sigma of a rate, rad/s, > 0; None: not known."""

    def row(self) -> Row:
        """Return the row [flow x y, gyro x y, quality, std]."""
        values = (self.flow_x, self.flow_y, self.gyro_x, self.gyro_y, self.quality, self.std)
        return make_row(self.t_ns, Kind.FLOW, *values)


@dataclass(frozen=True, slots=True, kw_only=True)
class AnchorSample:
    """Range between the vehicle's tag and an anchor whose position is known."""

    t_ns: int
    range: float
    """m, > 0."""
    anchor: int
    """Its number in the configuration."""
    std: float | None = None
    """One sigma, m, > 0; None: not known."""
    place: tuple[float, float, float] | None = None
    """Latitude and longitude, rad, and altitude above mean sea level, m, of the anchor; None: as it
    is in the configuration."""

    def row(self) -> Row:
        """Return [range, anchor, position of the anchor, whether that is geodetic, std].

        The position is filled in by the configuration where it is not known.
        """
        place = (None,) * 4 if self.place is None else (*self.place, 1.0)
        return make_row(self.t_ns, Kind.ANCHOR, self.range, float(self.anchor), *place, self.std)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSample:
    """Position and yaw of another estimator, in a frame of its own whose z points down."""

    t_ns: int
    x: float
    """m; x, y, z are right-handed."""
    y: float
    z: float
    yaw: float | None = None
    """Of the body's forward axis from x towards y, rad; None: not known."""
    std: float | None = None
    """One sigma of the position, m, > 0, as the source states it; None: not known."""
    counter: int | None = None
    """Moves when the source begins a new frame; None: it does not say."""
    yaw_drift: float | None = None
    """One sigma by which yaw has drifted since the pose before, rad; None: not stated."""
    drift: tuple[float, float, float, float, float, float] | None = None
    """How far it may have drifted since the pose before, in its frame: the Cholesky factor of that
    covariance, m, its lower triangle row by row; None: not stated."""

    def row(self) -> Row:
        """Return the row [x y z, yaw, std, yaw drift, counter, drift xx yx yy zx zy zz]."""
        pose = (self.x, self.y, self.z, self.yaw)
        drift = self.drift or (None,) * 6
        stated = (self.std, self.yaw_drift, self.counter, *drift)
        return make_row(self.t_ns, Kind.POSE, *pose, *stated)


@dataclass(frozen=True, slots=True, kw_only=True)
class VelocitySample:
    """Velocity of another estimator, in the body or in a level frame of its own."""

    t_ns: int
    x: float
    """m/s: forward, right, down of the body; or of the frame, whose z points down."""
    y: float
    z: float
    std: float | None = None
    """One sigma per axis, m/s, > 0; None: not known."""
    is_level: bool = False
    """Whether it is in a level frame; else in the body."""

    def row(self) -> Row:
        """Return the row [x y z, std, is level]."""
        level = float(self.is_level)
        return make_row(self.t_ns, Kind.VELOCITY, self.x, self.y, self.z, self.std, level)


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleState:
    """Armed and landed as the autopilot reports them: no rest is assumed against them.

    Also the delay that the autopilot assumes for the receiver's fixes, which the filter starts
    from.
    """

    t_ns: int
    is_armed: bool
    is_landed: bool | None = None
    """None: not known."""
    gnss_delay: float | None = None
    """Delay of a fix behind its stamp, s; None: not reported."""
    type: VehicleType = VehicleType.UNKNOWN

    def row(self) -> Row:
        """Return [armed, landed, whether the delay is reported, delay, type]; NaN: not known."""
        landed = None if self.is_landed is None else float(self.is_landed)
        is_reported = self.gnss_delay is not None
        delay = self.gnss_delay or 0.0
        known = float(self.is_armed), landed, float(is_reported), delay, float(self.type)
        return make_row(self.t_ns, Kind.VEHICLE, *known)


Measurement = (
    Restart
    | ImuSample
    | GnssFix
    | HeadingSample
    | MagSample
    | BaroSample
    | RangeSample
    | AirspeedSample
    | WheelSample
    | FlowSample
    | AnchorSample
    | PoseSample
    | VelocitySample
    | VehicleState
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Events:
    """A table of events in the order of their arrival."""

    t_ns: Stamps
    """Stamps, shape (n,)."""
    kind: Indices
    """``Kind``, shape (n,)."""
    values: Array
    """Rows in the layout of the measurements' ``row()``, shape (n, WIDTH)."""

    def __len__(self) -> int:
        return len(self.t_ns)

    def __repr__(self) -> str:
        """Return how many there are of each kind, and over which time."""
        counts = zip(*np.unique(self.kind, return_counts=True), strict=True)
        kinds = [f"{Kind(kind).name.lower()} {count}" for kind, count in counts]
        seconds = float(np.ptp(self.t_ns)) * 1e-9 if len(self) else 0.0
        return f"<Events: {len(self)} in {seconds:.1f} s; {', '.join(kinds)}>"

    @classmethod
    def from_rows(cls, rows: list[Row]) -> Events:
        """Collect rows in their order."""
        return cls(
            t_ns=np.array([row[0] for row in rows], dtype=np.int64),
            kind=np.array([row[1] for row in rows], dtype=np.int64),
            values=np.array([row[2] for row in rows], dtype=np.float64).reshape(-1, WIDTH),
        )

    @classmethod
    def from_columns(cls, t_ns: Stamps, kind: Kind, *columns: npt.ArrayLike) -> Events:
        """Build events of one kind from columns in the order of its ``row()``."""
        values = np.zeros((len(t_ns), WIDTH))
        for index, column in enumerate(columns):
            values[:, index] = column
        return cls(
            t_ns=np.asarray(t_ns, dtype=np.int64),
            kind=np.full(len(t_ns), int(kind), dtype=np.int64),
            values=values,
        )

    def take(self, index: npt.NDArray[np.integer] | Mask) -> Events:
        """Return the events of an index or a mask, in its order."""
        if index.dtype == np.bool_ and index.all():
            return self
        return Events(t_ns=self.t_ns[index], kind=self.kind[index], values=self.values[index])


SILENT_NS = 2_000_000_000
"""After so long without a fix of the first receiver, those of the second are used."""


def of_receiver(events: Events) -> Mask:
    """Return which events are fixes of the receiver in use, not the autopilot's own position.

    Fixes of the second receiver count where the first has none within two seconds.
    """
    is_fix = events.kind == Kind.GNSS
    flags = np.where(is_fix, events.values[:, GNSS_FLAGS], 0.0)
    is_first = is_fix & (flags != GnssFlag.DERIVED) & (flags < GnssFlag.SECOND)
    is_second = is_fix & (flags >= GnssFlag.SECOND)
    if not is_second.any():
        return np.asarray(is_first)
    first_ns = np.sort(events.t_ns[is_first])
    if len(first_ns):
        t_ns = events.t_ns[is_second]
        after = np.searchsorted(first_ns, t_ns)
        before_ns = first_ns[np.maximum(after - 1, 0)]
        after_ns = first_ns[np.minimum(after, len(first_ns) - 1)]
        apart_ns = np.minimum(np.abs(t_ns - before_ns), np.abs(after_ns - t_ns))
        is_second[is_second] = apart_ns > SILENT_NS
    return np.asarray(is_first | is_second)


def is_derived(events: Events) -> Mask:
    """Return which events are positions of the autopilot's own estimate."""
    flags = events.values[:, GNSS_FLAGS]
    return np.asarray((events.kind == Kind.GNSS) & (flags == GnssFlag.DERIVED))


def is_reboot(events: Events) -> Mask:
    """Return which events are restarts of the autopilot, and no clock that was only set."""
    return np.asarray((events.kind == Kind.RESTART) & (events.values[:, 0] == 0.0))


def merge(*tables: Events, arrival_ns: list[Stamps] | None = None) -> Events:
    """Merge tables into one by arrival; without arrival times, by stamp. Ties keep their order."""
    stamps = [table.t_ns for table in tables]
    order = np.argsort(np.concatenate(stamps if arrival_ns is None else arrival_ns), kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    merged = Events(
        t_ns=np.empty(len(order), dtype=np.int64),
        kind=np.empty(len(order), dtype=np.int64),
        values=np.empty((len(order), WIDTH)),
    )
    first = 0
    for table in tables:
        rows = place[first : first + len(table)]
        first += len(table)
        merged.t_ns[rows], merged.kind[rows] = table.t_ns, table.kind
        merged.values[rows] = table.values
    return merged
