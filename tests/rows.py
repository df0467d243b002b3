"""One simulated flight in every format of a log, with rows that are no measurement.

A test changes the columns and writes them in each format: what becomes of them must be the same.
"""

import struct
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np

from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import GnssSettings
from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import Kind
from ekf_companion.review.convert import estimate
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.events import events, truth
from sim_autopilot.flight import Flight
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_ulog import Writer as ULogWriter

RATE = 100.0
"""Hz, of the inertial samples."""
BOOT_NS = 5_000_000_000
"""The first stamp: of a log that begins soon after the boot."""
FORMATS = ("csv", "bin", "ulg", "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
"""Suffixes, and of a .tlog the inertial message."""
UTC_ZERO_US = 1_695_254_400_000_000
"""2023-09-21, when the clock of every log here was zero."""
CONFIG = Config(gnss=GnssSettings(delay=SimConfig().gnss.delay))


@dataclass(eq=False)
class Rows:
    """A flight as columns that a test may change."""

    imu_ns: Stamps
    imu: Array
    """Rate, rad/s, and specific force, m/s^2, shape (n, 6)."""
    fix_ns: Stamps
    fix: Array
    """Latitude, longitude, deg, height, velocity north, east, down, shape (n, 6)."""
    fix_type: Array
    heading: Array
    """Of each fix, deg; NaN: none."""
    utc_us: Stamps
    """Of each fix; 0: not known."""
    mag_ns: Stamps
    mag: Array
    baro_ns: Stamps
    baro: Array
    truth_ns: Stamps
    pos: Array
    """True position north and east of the first, m."""
    yaw: Array
    down_b: Array
    """True direction of gravity in the body, shape (n, 3)."""
    arrivals_ns: dict[Kind, Stamps]
    """When each row is written, whatever its stamp says."""
    scale: tuple[float, float]
    """m for each rad of latitude and longitude."""
    zero: Array
    """Of the first true position, m."""
    alt: Array
    """True altitude, m."""
    range_ns: Stamps = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    ranges: Array = field(default_factory=lambda: np.zeros(0))
    """Of a range finder that looks down, m."""

    @classmethod
    def plan(cls, scenario="figure-eight", duration=60.0, seed=4):
        flight = Flight.plan(
            scenario, SimConfig(imu=ImuConfig(rate=RATE)), duration=duration, seed=seed
        )
        found, exact = events(flight, has_vel_down=True), truth(flight)
        shift = BOOT_NS - int(found.t_ns[found.kind == Kind.IMU][0])

        def of(kind):
            some = found.take(found.kind == kind)
            return some.t_ns + shift, some.values

        (imu_ns, imu), (fix_ns, fix), (mag_ns, mag), (baro_ns, baro) = map(
            of, (Kind.IMU, Kind.GNSS, Kind.MAG, Kind.BARO)
        )
        scale = (6.37e6, 6.37e6 * np.cos(exact.lat[0]))
        pos = np.stack([exact.lat - exact.lat[0], exact.lon - exact.lon[0]], axis=1) * scale
        yaw = so3.to_euler(exact.q_nb)[:, 2]
        near = np.clip(np.searchsorted(exact.att_t_ns + shift, fix_ns), 0, len(yaw) - 1)
        noise = np.random.default_rng(seed).normal(0.0, 0.5, len(fix_ns))
        return cls(
            imu_ns=imu_ns,
            imu=imu[:, :6].copy(),
            fix_ns=fix_ns,
            fix=np.column_stack([np.rad2deg(fix[:, :2]), fix[:, 2:6]]),
            fix_type=np.full(len(fix), 3),
            heading=np.degrees(so3.wrap(yaw[near])) % 360.0 + noise,
            utc_us=UTC_ZERO_US + fix_ns // 1000,
            mag_ns=mag_ns,
            mag=mag[:, :3].copy(),
            baro_ns=baro_ns,
            baro=baro[:, 0].copy(),
            truth_ns=exact.att_t_ns + shift,
            pos=pos,
            yaw=yaw,
            down_b=so3.to_matrix(exact.q_nb)[:, 2, :],
            arrivals_ns={
                Kind.GNSS: fix_ns.copy(),
                Kind.MAG: mag_ns.copy(),
                Kind.BARO: baro_ns.copy(),
                Kind.IMU: imu_ns.copy(),
            },
            scale=scale,
            zero=np.array([exact.lat[0], exact.lon[0]]) * scale,
            alt=exact.alt,
        )

    def copy(self):
        """Return columns that may be changed."""
        return deepcopy(self)

    @property
    def since(self):
        """Time of each inertial sample from the first on, s."""
        return (self.imu_ns - BOOT_NS) * 1e-9

    @property
    def fix_since(self):
        """Likewise of each fix."""
        return (self.fix_ns - BOOT_NS) * 1e-9

    def keep_samples(self, mask):
        """Drop the other inertial samples."""
        self.imu_ns, self.imu = self.imu_ns[mask], self.imu[mask]
        self.arrivals_ns[Kind.IMU] = self.arrivals_ns[Kind.IMU][mask]

    def add_ranges(self, ground, rate=10.0, noise=0.05, seed=4):
        """Add the ranges of a sensor over ground at this altitude, m."""
        first, last = int(self.truth_ns[0]), int(self.truth_ns[-1])
        self.range_ns = np.arange(first, last, round(1e9 / rate), dtype=np.int64)
        at = np.searchsorted(self.truth_ns, self.range_ns)
        exact = (self.alt[at] - ground) / self.down_b[at, 2]
        noises = np.random.default_rng(seed).normal(0.0, noise, len(at))
        self.ranges = np.maximum(exact + noises, 0.1)
        self.arrivals_ns[Kind.RANGE] = self.range_ns.copy()

    def arrivals(self):
        """Yield (kind, index, time) in the order in which rows are written."""
        whole = [
            (t_ns, kind, index)
            for kind, times in self.arrivals_ns.items()
            for index, t_ns in enumerate(times.tolist())
        ]
        for t_ns, kind, index in sorted(whole, key=lambda one: one[0]):
            yield kind, index, t_ns


def write(rows, kind, folder, *, has_heading=False):
    """Write a flight in a format; return the file."""
    suffix = kind if kind in ("csv", "bin", "ulg") else "tlog"
    path = folder / f"{kind}.{suffix}"
    path.write_bytes(
        {"csv": _csv, "bin": _bin, "ulg": _ulg}.get(kind, _tlog)(rows, kind, has_heading)
    )
    return path


def _csv(rows, kind, has_heading):
    names = ["time_us"]
    names += [f"gyro_{axis}_rps" for axis in "xyz"] + [f"accel_{axis}_mps2" for axis in "xyz"]
    names += ["gps_lat_deg", "gps_lon_deg", "gps_alt_m", "gps_vn_mps", "gps_ve_mps", "gps_vd_mps"]
    names += ["gps_std_h_m", "gps_std_v_m", "gps_std_vel_mps", "heading_deg"]
    names += [f"mag_{axis}_gauss" for axis in "xyz"] + ["baro_alt_m"]
    names += ["range_m"] if len(rows.ranges) else []
    lines = [",".join(names)]

    def line(t_ns, imu=("",) * 6, fix=("",) * 9, heading="", mag=("",) * 3, baro="", range_m=""):
        cells = [t_ns // 1000, *imu, *fix, heading, *mag, baro, range_m][: len(names)]
        lines.append(",".join("" if one == "" or one != one else f"{one!r}" for one in cells))

    for what, i, _ in rows.arrivals():
        if what == Kind.IMU:
            line(int(rows.imu_ns[i]), imu=rows.imu[i].tolist())
        elif what == Kind.GNSS:
            fix = [*rows.fix[i].tolist(), 1.0, 1.5, 0.3] if rows.fix_type[i] >= 3 else [""] * 9
            heading = float(rows.heading[i]) if has_heading else ""
            line(int(rows.fix_ns[i]), fix=fix, heading=heading)
        elif what == Kind.MAG:
            line(int(rows.mag_ns[i]), mag=rows.mag[i].tolist())
        elif what == Kind.RANGE:
            line(int(rows.range_ns[i]), range_m=float(rows.ranges[i]))
        else:
            line(int(rows.baro_ns[i]), baro=float(rows.baro[i]))
    return ("\n".join(lines) + "\n").encode()


def _bin(rows, kind, has_heading):
    log = DataFlashWriter()
    log.data = bytearray(log.data)
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(
        2, "GPS", "QBBIHcLLeffff", "TimeUS,I,Status,GMS,GWk,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"
    )
    log.define(3, "GPA", "QBCCCBI", "TimeUS,I,HAcc,VAcc,SAcc,VV,SMS")
    log.define(4, "MAG", "QBhhhB", "TimeUS,I,MagX,MagY,MagZ,Health")
    log.define(5, "BARO", "QBf", "TimeUS,I,Alt")
    if len(rows.ranges):
        log.define(6, "RFND", "QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality")
    for what, i, _ in rows.arrivals():
        if what == Kind.IMU:
            log.row("IMU", int(rows.imu_ns[i]) // 1000, 0, *rows.imu[i].tolist())
        elif what == Kind.GNSS:
            us = int(rows.fix_ns[i]) // 1000
            lat, lon, alt, north, east, down = rows.fix[i].tolist()
            course = float(np.degrees(np.arctan2(east, north)) % 360.0)
            yaw = (
                float(rows.heading[i])
                if has_heading and rows.heading[i] == rows.heading[i]
                else 0.0
            )
            place = (round(lat * 1e7), round(lon * 1e7), round(alt * 100.0))
            status = int(rows.fix_type[i])
            speed = float(np.hypot(north, east))
            log.row(
                "GPS",
                us,
                0,
                status,
                *_gps_time(int(rows.utc_us[i])),
                100,
                *place,
                speed,
                course,
                down,
                yaw,
            )
            log.row("GPA", us, 0, 100, 150, 30, 1, us // 1000)
        elif what == Kind.MAG:
            field = [round(1e3 * one) for one in rows.mag[i].tolist()]
            log.row("MAG", int(rows.mag_ns[i]) // 1000, 0, *field, 1)
        elif what == Kind.RANGE:
            us, distance = int(rows.range_ns[i]) // 1000, float(rows.ranges[i])
            log.row("RFND", us, 0, distance, 4, 25, -1)
        else:
            log.row("BARO", int(rows.baro_ns[i]) // 1000, 0, float(rows.baro[i]))
    return bytes(log.data)


def _gps_time(utc_us):
    """Return GPS time of week, ms, and week: 18 leap seconds before UTC."""
    ms = utc_us // 1000 - (315_964_800 - 18) * 1000 if utc_us else 0
    return ms % 604_800_000, ms // 604_800_000


_VEL = [("float", f"vel_{axis}_m_s") for axis in "ned"]
_ULG = [
    (
        "sensor_combined",
        [("uint64_t", "timestamp"), ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")],
    ),
    (
        "sensor_gps",
        [
            ("uint64_t", "timestamp"),
            ("uint64_t", "time_utc_usec"),
            ("double", "latitude_deg"),
            ("double", "longitude_deg"),
            ("double", "altitude_msl_m"),
            *_VEL,
            ("float", "eph"),
            ("float", "epv"),
            ("float", "s_variance_m_s"),
            ("float", "heading"),
            ("uint8_t", "fix_type"),
        ],
    ),
    ("sensor_mag", [("uint64_t", "timestamp"), *(("float", axis) for axis in "xyz")]),
    ("vehicle_air_data", [("uint64_t", "timestamp"), ("float", "baro_alt_meter")]),
]
_RANGE = (
    "distance_sensor",
    [
        ("uint64_t", "timestamp"),
        ("float", "min_distance"),
        ("float", "max_distance"),
        ("float", "current_distance"),
        ("float", "variance"),
        ("int8_t", "signal_quality"),
        ("uint8_t", "orientation"),
    ],
)


def _ulg(rows, kind, has_heading):
    log = ULogWriter([*_ULG, _RANGE] if len(rows.ranges) else _ULG)
    log.data = bytearray(log.data)
    for what, i, _ in rows.arrivals():
        if what == Kind.IMU:
            log.row(0, int(rows.imu_ns[i]) // 1000, *rows.imu[i].tolist())
        elif what == Kind.GNSS:
            us = int(rows.fix_ns[i]) // 1000
            heading = np.radians(rows.heading[i]) if has_heading else np.nan
            fix = (*rows.fix[i].tolist(), 1.0, 1.5, 0.3, heading, int(rows.fix_type[i]))
            log.row(1, us, int(rows.utc_us[i]), *fix)
        elif what == Kind.MAG:
            log.row(2, int(rows.mag_ns[i]) // 1000, *rows.mag[i].tolist())
        elif what == Kind.RANGE:
            us, distance = int(rows.range_ns[i]) // 1000, float(rows.ranges[i])
            log.row(4, us, 0.05, 100.0, distance, 0.0025, -1, 25)
        else:
            log.row(3, int(rows.baro_ns[i]) // 1000, float(rows.baro[i]))
    return bytes(log.data)


def frames(rows, kind, has_heading):
    """Yield the time, ns, and the bytes of each frame of a telemetry log."""
    sender = Sender(1, 1)
    is_px4 = kind == "HIGHRES_IMU"
    field, beat_ns, t_ns = [0.0] * 3, 0, BOOT_NS
    is_new_field = pressure = 0

    def frame(name, **fields):
        return t_ns, sender.message(name, **fields)

    whole = np.rint(rows.imu * ([1e3] * 3 + [1e3 / STANDARD_GRAVITY] * 3)).astype(int)
    for what, i, t_ns in rows.arrivals():
        if t_ns >= beat_ns:
            beat_ns = t_ns + 1_000_000_000
            yield frame("HEARTBEAT", type=2, autopilot=12 if is_px4 else 3, system_status=4)
        if what == Kind.IMU:
            us = int(rows.imu_ns[i]) // 1000
            if is_px4:
                rates, forces = rows.imu[i, :3].tolist(), rows.imu[i, 3:].tolist()
                fields = {f"{axis}gyro": one for axis, one in zip("xyz", rates, strict=True)}
                fields |= {f"{axis}acc": one for axis, one in zip("xyz", forces, strict=True)}
                fields |= {f"{axis}mag": one for axis, one in zip("xyz", field, strict=True)}
                updated = 0x3F | 0x1C0 * is_new_field | 0x200 * bool(pressure)
                fields |= {"abs_pressure": float(pressure), "fields_updated": updated}
                yield frame("HIGHRES_IMU", time_usec=us, **fields)
            else:
                names = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc")
                fields = dict(zip(names, whole[i].tolist(), strict=True))
                milli = [round(1e3 * one) for one in field]
                fields |= dict(zip(("xmag", "ymag", "zmag"), milli, strict=True))
                is_raw = kind == "RAW_IMU"
                stamp = {"time_usec": us} if is_raw else {"time_boot_ms": us // 1000}
                yield frame(kind, **stamp, **fields)
            is_new_field = pressure = 0
        elif what == Kind.GNSS:
            lat, lon, alt, north, east, _ = rows.fix[i].tolist()
            course = np.degrees(np.arctan2(east, north)) % 360.0
            yaw = 0
            if has_heading and rows.heading[i] == rows.heading[i]:
                yaw = round(rows.heading[i] * 100.0) % 36000
                yaw = yaw or (36000 if rows.heading[i] else 0)
            yield frame(
                "GPS_RAW_INT",
                time_usec=int(rows.fix_ns[i]) // 1000,
                fix_type=int(rows.fix_type[i]),
                lat=round(lat * 1e7),
                lon=round(lon * 1e7),
                alt=round(alt * 1e3),
                vel=round(float(np.hypot(north, east)) * 100.0),
                cog=round(float(course) * 100.0),
                h_acc=1000,
                v_acc=1500,
                vel_acc=300,
                hdg_acc=round(5e5),
                yaw=yaw,
            )
        elif what == Kind.MAG:
            field, is_new_field = rows.mag[i].tolist(), 1
        elif what == Kind.RANGE:
            yield frame(
                "DISTANCE_SENSOR",
                time_boot_ms=int(rows.range_ns[i]) // 1_000_000,
                min_distance=5,
                max_distance=10000,
                current_distance=round(float(rows.ranges[i]) * 100.0),
                orientation=25,
                covariance=25,
            )
        else:
            ratio = 1.0 - float(rows.baro[i]) / (288.15 / 0.0065)
            pressure = 1013.25 * ratio ** (9.80665 / (0.0065 * 287.05287))
            if not is_px4:
                us = int(rows.baro_ns[i]) // 1000
                yield frame("SCALED_PRESSURE", time_boot_ms=us // 1000, press_abs=pressure)


def _tlog(rows, kind, has_heading):
    data = bytearray()
    for t_ns, frame in frames(rows, kind, has_heading):
        data += struct.pack(">Q", (UTC_ZERO_US + t_ns // 1000) & ~3) + frame
    return bytes(data)


@dataclass(eq=False)
class Found:
    """What an estimate of a flight is worth."""

    table: object
    report: object
    distance: Array
    """Horizontally, from the truth, m."""
    yaw: Array
    """Error, deg."""
    tilt: Array
    """deg."""
    since: Array
    """Of each estimate, s."""

    @property
    def notes(self):
        """All notes in one text."""
        return "\n".join(self.report.notes)


def convert(rows, kind, folder, config=CONFIG, *, has_heading=False):
    """Estimate a flight written in a format, and compare it with the truth."""
    table, report = estimate(write(rows, kind, folder, has_heading=has_heading), config)
    at = np.clip(np.searchsorted(rows.truth_ns, table.stamp_ns), 0, len(rows.yaw) - 1)
    lat, lon = (np.deg2rad(table.column(name)) for name in ("lat_deg", "lon_deg"))
    here = np.stack([lat, lon], axis=1) * rows.scale - rows.zero
    q_nb = np.stack([table.column(f"q_{one}") for one in "wxyz"], axis=1)
    down_b = so3.to_matrix(np.nan_to_num(q_nb, nan=0.5))[:, 2, :]
    cosine = np.clip((down_b * rows.down_b[at]).sum(axis=1), -1.0, 1.0)
    return Found(
        table=table,
        report=report,
        distance=np.linalg.norm(here - rows.pos[at], axis=1),
        yaw=np.abs(np.degrees(so3.wrap(table.column("yaw") - rows.yaw[at]))),
        tilt=np.degrees(np.arccos(cosine)),
        since=(table.stamp_ns - BOOT_NS) * 1e-9,
    )
