"""Wire units to measurements, with the habits of the two autopilots taken off at the door.

Everything that a measurement needs is known from the messages alone, in their order: no time of
arrival enters. What is refused is counted under a reason and leaves nothing else behind.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from ekf_companion.mavlink.clock import LAST_US, TimeBase
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.layout import by_name
from ekf_companion.nav.atmosphere import pressure_altitude
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.nav.measurements import (
    BaroSample,
    GnssFix,
    GnssFlag,
    HeadingSample,
    HeadingSource,
    ImuSample,
    MagSample,
    Measurement,
    Restart,
    VehicleState,
)


class Family(str, Enum):
    """Whose habits apply."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderOptions:
    """How messages that leave something open are read."""

    imu_id: int = 0
    """The instance in HIGHRES_IMU.id that is used; others are counted and left."""
    derived_rate: float = 5.0
    """Fixes per second taken from the autopilot's own position at most."""
    heading_rate: float = 10.0
    """Headings per second taken from the autopilot at most."""
    heading_std: float = math.radians(5.0)
    """One sigma of the autopilot's heading, rad: a compass in a drone, after its calibration."""


_ACCEL_GYRO = 0x3F
_MAG = 0x1C0
_PRESSURE = 0x200
"""Bits of HIGHRES_IMU.fields_updated."""
_MILLI_G = STANDARD_GRAVITY * 1e-3
_SECOND_NS = 1_000_000_000
_ABSENT_NS = 3 * _SECOND_NS
"""So long the better source must be silent before the next one is used."""
_STRAY_NS = 30 * _SECOND_NS
"""A fix stamped further from the inertial samples is on no clock of this vehicle's."""

_UNKNOWN_16 = 65535
_FIX_3D = 3
_NORTH_CDEG = 36000
_ARMED = 128
_INVALID_AUTOPILOT = 8

_RANGE_ERROR = 1.5
"""Position error per unit of HDOP, m: L1 receiver with SBAS-like corrections, open sky."""
_STD_FLOOR = 0.5
"""No HDOP makes an unaided receiver better, m."""
_STD_UNKNOWN = 5.0
"""One sigma of a fix that says nothing of its error, m."""
_STD_VEL = 0.3
"""One sigma of the velocity where the receiver gives none, m/s: u-blox Doppler, open sky."""
_STD_YAW = math.radians(1.0)
"""One sigma of a dual-antenna heading that gives none, rad: 1 cm across half a metre."""
_STD_YAW_FLOOR = math.radians(0.1)
_DERIVED = 3.0
"""The autopilot's own position repeats the errors of the fixes in it: weigh nine of it as one."""
_DERIVED_STD_H = 3.0
_DERIVED_STD_V = 4.5
_DERIVED_STD_VEL = 0.9
"""Floors, m and m/s: three times a plain receiver's 1.0, 1.5 and 0.3."""


class Preference:
    """Of several sources of one thing, the best that has been heard in the last three seconds."""

    def __init__(self) -> None:
        self.rank = 0
        """Of the source in use: 0 is the best."""
        self._heard_ns: int | None = None

    def admit(self, rank: int, t_ns: int) -> bool:
        """Whether to use a source now, by its rank and its own stamp; the best is waited for."""
        if self._heard_ns is None:
            self._heard_ns = t_ns
        if rank > self.rank and t_ns - self._heard_ns <= _ABSENT_NS:
            return False
        self.rank, self._heard_ns = rank, t_ns
        return True


class Pace:
    """Thins a stream to a rate by its own stamps."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(_SECOND_NS / rate * 0.99)  # stamps jitter
        self._last_ns: int | None = None

    def admit(self, t_ns: int) -> bool:
        """Whether a period has passed since the last that was admitted."""
        if self._last_ns is not None and 0 <= t_ns - self._last_ns < self._period_ns:
            return False
        self._last_ns = t_ns
        return True


class Decoder:
    """Turns one autopilot's frames into measurements."""

    def __init__(
        self, family: Family = Family.UNKNOWN, options: DecoderOptions | None = None
    ) -> None:
        self.family = family
        self.options = options or DecoderOptions()
        self.refused: Counter[str] = Counter()
        """How often, by reason: ``message: why``."""
        self._decoders: dict[int, Callable[[Frame], list[Measurement]]] = {
            by_name(name).message_id: function
            for name, function in {
                "HIGHRES_IMU": self._highres_imu,
                "RAW_IMU": self._raw_imu,
                "SCALED_IMU": self._scaled_imu,
                "SCALED_IMU2": self._scaled_imu,
                "SCALED_IMU3": self._scaled_imu,
                "SCALED_PRESSURE": self._scaled_pressure,
                "GPS_RAW_INT": self._gps_raw_int,
                "GLOBAL_POSITION_INT": self._global_position_int,
                "ATTITUDE": self._attitude,
                "VFR_HUD": self._vfr_hud,
                "HEARTBEAT": self._heartbeat,
                "EXTENDED_SYS_STATE": self._extended_sys_state,
                "SYSTEM_TIME": self._system_time,
            }.items()
        }
        self._highres = by_name("HIGHRES_IMU")
        self.clock = TimeBase()
        self._forget()

    def _forget(self) -> None:
        """Begin anew after a reboot; the clock has already taken the new time."""
        self._imu, self._mag, self._baro, self._heading = (Preference() for _ in range(4))
        self._imu_us = -1
        self._mag_last: tuple[float, ...] = ()
        self._pressure_last = 0.0
        self._heading_pace = Pace(self.options.heading_rate)
        self._derived_pace = Pace(self.options.derived_rate)
        self._fix_last: tuple[int, ...] = ()
        self._fixes = 0
        self._fix_std = (0.0, 0.0, 0.0)
        self._is_armed = False
        self._is_landed: bool | None = None

    @property
    def imu_source(self) -> str:
        """The message that inertial samples are taken from."""
        return ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")[
            self._imu.rank
        ]

    @property
    def ranks(self) -> tuple[int, int, int, int]:
        """Ranks of the sources in use: inertial, magnetometer, barometer, heading."""
        return self._imu.rank, self._mag.rank, self._baro.rank, self._heading.rank

    def prefer(self, imu: int, mag: int, baro: int, heading: int) -> None:
        """Take these ranks at once: it is known already that better sources are silent."""
        for preference, rank in zip(
            (self._imu, self._mag, self._baro, self._heading),
            (imu, mag, baro, heading),
            strict=True,
        ):
            preference.rank = rank

    @property
    def is_armed(self) -> bool:
        """Whether the autopilot's last heartbeat said that it is armed."""
        return self._is_armed

    def decode(self, frame: Frame) -> list[Measurement]:
        """Give what a frame of the autopilot says: nothing, one or several measurements."""
        function = self._decoders.get(frame.message_id)
        return function(frame) if function else []

    # Inertial

    def _highres_imu(self, frame: Frame) -> list[Measurement]:
        layout = self._highres
        (t_us, ax, ay, az, gx, gy, gz, mx, my, mz, pressure, _, _, _, updated, instance) = (
            layout.struct.unpack(frame.payload.ljust(layout.size, b"\0")[: layout.size])
        )
        if instance != self.options.imu_id:
            return self._refuse("HIGHRES_IMU: another instance")
        if t_us > LAST_US:
            return self._refuse("HIGHRES_IMU: no time")
        out = self._restarted_by(t_us)
        t_ns = t_us * 1000
        if updated & _ACCEL_GYRO != _ACCEL_GYRO:
            self._refuse("HIGHRES_IMU: accel or gyro not updated")
        else:
            self._add_imu(out, 0, t_us, gx, gy, gz, ax, ay, az)
        if updated & _MAG == _MAG:
            self._add_mag(out, 0, t_ns, mx, my, mz)
        if updated & _PRESSURE:
            self._add_pressure(out, 0, t_ns, pressure)
        return out

    def _raw_imu(self, frame: Frame) -> list[Measurement]:
        if self.family is not Family.ARDUPILOT:
            # Elsewhere the numbers have no unit
            return self._refuse("RAW_IMU: not ArduPilot")
        m = unpack(frame)
        if m.time_usec > LAST_US:
            return self._refuse("RAW_IMU: no time")
        out = self._restarted_by(m.time_usec)
        self._add_integers(out, 1, m.time_usec, m)
        return out

    def _scaled_imu(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        out = self._restarted_by_ms(m.time_boot_ms)
        t_ns = self.clock.from_boot_ms(m.time_boot_ms)
        if t_ns is None:
            return self._refuse("SCALED_IMU: time base unknown")
        self._add_integers(out, _SCALED_RANK[frame.message_id], t_ns // 1000, m)
        return out

    def _add_integers(self, out: list[Measurement], rank: int, t_us: int, m: Any) -> None:
        """Add what RAW_IMU and SCALED_IMU share: milli-g, mrad/s and milligauss."""
        xacc, yacc, zacc, xgyro, ygyro, zgyro, xmag, ymag, zmag = m[1:10]
        if not (xacc or yacc or zacc or xgyro or ygyro or zgyro):
            self._refuse("SCALED_IMU: no sensor behind it")
        else:
            self._add_imu(
                out,
                rank,
                t_us,
                xgyro * 1e-3,
                ygyro * 1e-3,
                zgyro * 1e-3,
                xacc * _MILLI_G,
                yacc * _MILLI_G,
                zacc * _MILLI_G,
            )
        self._add_mag(out, rank, t_us * 1000, xmag * 1e-3, ymag * 1e-3, zmag * 1e-3)

    def _add_imu(
        self,
        out: list[Measurement],
        rank: int,
        t_us: int,
        gx: float,
        gy: float,
        gz: float,
        ax: float,
        ay: float,
        az: float,
    ) -> None:
        if not math.isfinite(gx + gy + gz + ax + ay + az):
            self._refuse("IMU: not a number")
        elif t_us == 0:
            self._refuse("IMU: no time")
        elif not self._imu.admit(rank, t_us * 1000):
            self._refuse("IMU: a better source speaks")
        elif t_us == self._imu_us:
            self._refuse("IMU: stamp repeated")
        else:
            self._imu_us = t_us
            out.append(
                ImuSample(
                    t_ns=t_us * 1000,
                    gyro_x=gx,
                    gyro_y=gy,
                    gyro_z=gz,
                    accel_x=ax,
                    accel_y=ay,
                    accel_z=az,
                )
            )

    def _add_mag(
        self, out: list[Measurement], rank: int, t_ns: int, x: float, y: float, z: float
    ) -> None:
        if (x, y, z) == (0.0, 0.0, 0.0):
            return  # no magnetometer
        if not self._mag.admit(rank, t_ns) or (x, y, z) == self._mag_last:
            return
        self._mag_last = (x, y, z)
        norm = math.sqrt(x * x + y * y + z * z)
        if 1.5e5 <= norm <= 8e5:
            # ArduPilot before #32286
            self.refused["mag: unit corrected by 1e6"] += 1
            x, y, z, norm = x * 1e-6, y * 1e-6, z * 1e-6, norm * 1e-6
        if not 0.15 <= norm <= 0.8:
            self._refuse("mag: no field of the Earth")
            return
        out.append(MagSample(t_ns=t_ns, mag_x=x, mag_y=y, mag_z=z))

    # Height

    def _scaled_pressure(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        t_ns = self.clock.from_boot_ms(m.time_boot_ms)
        out: list[Measurement] = []
        if t_ns is None:
            return self._refuse("SCALED_PRESSURE: time base unknown")
        self._add_pressure(out, 1, t_ns, m.press_abs)
        return out

    def _add_pressure(self, out: list[Measurement], rank: int, t_ns: int, pressure: float) -> None:
        """Add a pressure in hPa, or in Pa where only that can be meant (PX4)."""
        if pressure == 0.0 or not self._baro.admit(rank, t_ns) or pressure == self._pressure_last:
            return
        self._pressure_last = pressure
        if 300.0 <= pressure <= 1200.0:
            pressure *= 100.0
        if not 30000.0 <= pressure <= 120000.0:
            self._refuse("baro: no pressure of the air")
            return
        out.append(BaroSample(t_ns=t_ns, alt=pressure_altitude(pressure)))

    # Position

    def _gps_raw_int(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        key = (m.time_usec,) if m.time_usec else (0, m.lat, m.lon, m.alt, m.vel, m.cog)
        if m.fix_type < _FIX_3D:
            self._fixes = 0
            return self._refuse("GPS_RAW_INT: no 3-D fix")
        if not _is_place(m.lat, m.lon):
            self._fixes = 0
            return self._refuse("GPS_RAW_INT: no position")
        if key == self._fix_last:
            return self._refuse("GPS_RAW_INT: repeated")
        self._fix_last = key
        if m.time_usec > LAST_US:
            return self._refuse("GPS_RAW_INT: no time")
        t_ns = self.clock.from_us(m.time_usec) if m.time_usec else self.clock.latest_ns
        if t_ns is None or self.clock.latest_ns is None:
            return self._refuse("GPS_RAW_INT: time base unknown")
        if abs(t_ns - self.clock.latest_ns) > _STRAY_NS:
            return self._refuse("GPS_RAW_INT: stamp far from the inertial samples")
        self._fixes += 1
        if self._fixes < 2:
            # The one message before the first fix can be 140 km off
            return self._refuse("GPS_RAW_INT: first after none")

        std_h = m.h_acc * 1e-3 or _dilution(m.eph) or _STD_UNKNOWN
        std_v = m.v_acc * 1e-3 or _dilution(m.epv) or 1.5 * std_h
        has_velocity = m.vel != _UNKNOWN_16 and m.cog <= _NORTH_CDEG
        speed, course = m.vel * 1e-2, math.radians(m.cog * 1e-2)
        std_vel = (m.vel_acc * 1e-3 or _STD_VEL) if has_velocity else None
        self._fix_std = (std_h, std_v, std_vel or 0.0)
        out: list[Measurement] = [
            GnssFix(
                t_ns=t_ns,
                lat=math.radians(m.lat * 1e-7),
                lon=math.radians(m.lon * 1e-7),
                alt=m.alt * 1e-3,
                vel_north=speed * math.cos(course) if has_velocity else None,
                vel_east=speed * math.sin(course) if has_velocity else None,
                std_h=std_h,
                std_v=std_v,
                std_vel=std_vel,
            )
        ]
        if 0 < m.yaw <= _NORTH_CDEG:
            out.append(
                HeadingSample(
                    t_ns=t_ns,
                    heading=_wrap(math.radians(m.yaw * 1e-2)),
                    std=_yaw_std(m.hdg_acc),
                    source=HeadingSource.GNSS,
                )
            )
        return out

    def _global_position_int(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        t_ns = self.clock.from_boot_ms(m.time_boot_ms)
        if t_ns is None:
            return self._refuse("GLOBAL_POSITION_INT: time base unknown")
        out: list[Measurement] = []
        if m.hdg <= _NORTH_CDEG:
            self._add_heading(out, 1, t_ns, math.radians(m.hdg * 1e-2))
        if not _is_place(m.lat, m.lon):
            self._refuse("GLOBAL_POSITION_INT: no position")
            return out
        if not self._derived_pace.admit(t_ns):
            return out
        std_h, std_v, std_vel = self._fix_std
        out.append(
            GnssFix(
                t_ns=t_ns,
                lat=math.radians(m.lat * 1e-7),
                lon=math.radians(m.lon * 1e-7),
                alt=m.alt * 1e-3,
                vel_north=m.vx * 1e-2,
                vel_east=m.vy * 1e-2,
                vel_down=m.vz * 1e-2,
                std_h=max(_DERIVED_STD_H, _DERIVED * std_h),
                std_v=max(_DERIVED_STD_V, _DERIVED * std_v),
                std_vel=max(_DERIVED_STD_VEL, _DERIVED * std_vel),
                flags=GnssFlag.DERIVED,
            )
        )
        return out

    # Heading

    def _attitude(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        out = self._restarted_by_ms(m.time_boot_ms)
        t_ns = self.clock.from_boot_ms(m.time_boot_ms)
        if t_ns is None:
            return self._refuse("ATTITUDE: time base unknown")
        self._add_heading(out, 0, t_ns, m.yaw)
        return out

    def _vfr_hud(self, frame: Frame) -> list[Measurement]:
        # No stamp of its own; whole degrees
        heading, t_ns = unpack(frame).heading, self.clock.latest_ns
        out: list[Measurement] = []
        if t_ns is not None and 0 <= heading <= 360:
            self._add_heading(out, 2, t_ns, math.radians(heading))
        return out

    def _add_heading(self, out: list[Measurement], rank: int, t_ns: int, heading: float) -> None:
        if not math.isfinite(heading):
            self._refuse("heading: not a number")
        elif self._heading.admit(rank, t_ns) and self._heading_pace.admit(t_ns):
            out.append(
                HeadingSample(
                    t_ns=t_ns,
                    heading=_wrap(heading),
                    std=self.options.heading_std,
                    source=HeadingSource.AUTOPILOT,
                )
            )

    # The vehicle and its clock

    def _heartbeat(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        if m.autopilot == _INVALID_AUTOPILOT:
            return []
        self._is_armed = bool(m.base_mode & _ARMED)
        return self._vehicle()

    def _extended_sys_state(self, frame: Frame) -> list[Measurement]:
        state = unpack(frame).landed_state
        is_landed = None if state == 0 else state == 1
        if is_landed is self._is_landed:
            return []
        self._is_landed = is_landed
        return self._vehicle()

    def _vehicle(self) -> list[Measurement]:
        t_ns = self.clock.latest_ns
        if t_ns is None:
            return []
        return [VehicleState(t_ns=t_ns, is_armed=self._is_armed, is_landed=self._is_landed)]

    def _system_time(self, frame: Frame) -> list[Measurement]:
        m = unpack(frame)
        if self.clock.relate(m.time_unix_usec, m.time_boot_ms):
            self._forget()
            return [Restart()]
        return []

    def _restarted_by(self, stamp_us: int) -> list[Measurement]:
        # 0 is no time, so it says nothing of a reboot
        if stamp_us == 0 or not self.clock.advance(stamp_us):
            return []
        self._forget()
        return [Restart()]

    def _restarted_by_ms(self, boot_ms: int) -> list[Measurement]:
        if boot_ms == 0 or not self.clock.advance_boot_ms(boot_ms):
            return []
        self._forget()
        return [Restart()]

    def _refuse(self, reason: str) -> list[Measurement]:
        self.refused[reason] += 1
        return []


_SCALED_RANK = {
    by_name("SCALED_IMU").message_id: 2,
    by_name("SCALED_IMU2").message_id: 3,
    by_name("SCALED_IMU3").message_id: 4,
}


def _is_place(lat_degE7: int, lon_degE7: int) -> bool:
    """Whether a latitude and longitude can be meant; 0, 0 is what is sent for none."""
    return (
        (lat_degE7 != 0 or lon_degE7 != 0)
        and abs(lat_degE7) <= 900_000_000
        and abs(lon_degE7) <= 1_800_000_000
    )


def _dilution(dop_100: int) -> float:
    """Give the one sigma, m, of a dilution of precision times 100; 0.0 where it says nothing."""
    if dop_100 in (0, 9999, _UNKNOWN_16):
        return 0.0
    return max(_RANGE_ERROR * dop_100 * 1e-2, _STD_FLOOR)


def _yaw_std(hdg_acc_degE5: int) -> float:
    """Give the one sigma, rad, of a dual-antenna heading."""
    if hdg_acc_degE5 == 0:
        return _STD_YAW
    return min(max(math.radians(hdg_acc_degE5 * 1e-5), _STD_YAW_FLOOR), math.pi)


def _wrap(angle: float) -> float:
    """Bring an angle into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
