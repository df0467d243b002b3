"""Fixes of the GNSS receivers, from their messages to measurements (compiled).

GPS_RAW_INT is the first receiver, GPS2_RAW one that stands by. The compiled reader of a stream and
the decoder of single frames read them here both: a fix has one way.
"""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.mavlink import record
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.heading import NORTH_CDEG, wrap
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.messages import by_name
from ekf_companion.mavlink.stamp import Stamp
from ekf_companion.mavlink.timebase import LAST_US
from ekf_companion.nav.arrays import Column
from ekf_companion.nav.held_heading import HeldHeading
from ekf_companion.nav.held_velocity import SINGLE, HeldVelocities
from ekf_companion.nav.measurements import (
    SILENT_NS,
    GnssFix,
    GnssFlag,
    HeadingSample,
    HeadingSource,
)

_UNKNOWN_16 = 65535
_NO_GPS, _FIX_3D = 0, 3
_STRAY_NS = 30_000_000_000
"""A fix stamped further from the inertial samples is on another clock."""
_UNRELATED_NS = 5_000_000_000
"""Where nothing relates the stamps of fixes to the inertial ones for so long, nothing will."""
_GEOID = 120.0
"""m; nowhere is the sea level further from the ellipsoid: -107 to +86 m (EGM96)."""

_RANGE_ERROR = 1.5
"""Position error per unit of HDOP, m: L1 receiver with SBAS-like corrections, open sky."""
_STD_FLOOR = 0.5
"""Least one sigma of an unaided receiver, whatever its HDOP, m."""
_STD_UNKNOWN = 5.0
"""One sigma of a fix that does not state its error, m."""
_STD_VEL = 0.3
"""One sigma of the velocity where the receiver gives none, m/s: u-blox Doppler, open sky."""
_STD_YAW = math.radians(1.0)
"""One sigma of a dual-antenna heading that gives none, rad: 1 cm across half a metre."""
_STD_YAW_FLOOR = math.radians(0.1)


class _Receiver:
    """What is known of one receiver."""

    def __init__(self, message: str, flags: GnssFlag) -> None:
        self.message, self.flags = message, flags
        self.last: list[int] = []
        self.fixes = 0
        """That were new, in a row."""
        self.is_good = False
        """Whether the last message held a fix."""
        self.is_heard = False
        self.has_fix = False
        """Whether there was one at all."""
        self.newest_ns: int | None = None
        """Time of the last new fix that was passed on."""
        self.velocities = HeldVelocities()
        self.yaw = HeldHeading()


class Fixes:
    """Reads the fixes of each receiver."""

    def __init__(self, context: Context) -> None:
        self._context = context
        layout = by_name("GPS_RAW_INT")
        self._names: tuple[str, ...] = layout.names
        self._record = np.zeros(1, dtype=layout.dtype).view(np.recarray)
        self._said: Column[record.GpsRawInt] = self._record
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self._first = _Receiver("GPS_RAW_INT", GnssFlag.NONE)
        self._second = _Receiver("GPS2_RAW", GnssFlag.SECOND)
        self._unrelated_ns: int | None = None
        self.is_settled = False
        """Whether it is known whether a receiver speaks, and one that does has had a fix."""
        self.std = (0.0, 0.0, 0.0)
        """One sigma of the first receiver's last fix: horizontal, vertical (m), velocity (m/s); 0:
        not known."""

    @property
    def has_fix(self) -> bool:
        """Whether any receiver has had a fix."""
        return self._first.has_fix or self._second.has_fix

    @property
    def is_alone(self) -> bool:
        """Whether no receiver has been heard."""
        return not (self._first.is_heard or self._second.is_heard)

    def gps_raw_int(self, frame: Frame) -> Measurements:
        """Read GPS_RAW_INT."""
        return self.read_first(self._content(frame))

    def read_first(self, m: record.GpsRawInt) -> Measurements:
        """Return what a GPS_RAW_INT says: a fix, if it is new, and a heading."""
        return self._with_heading(self._first, self._read(self._first, m), m)

    def gps2_raw(self, frame: Frame) -> Measurements:
        """Read GPS2_RAW: a receiver that stands by, for the filter to go to.

        Its heading is used while the first has no fix, or has had no new one for a while.
        """
        m = self._content(frame)
        out = self._read(self._second, m)
        newest_ns = self._first.newest_ns if self._first.is_good else None
        if out and newest_ns is not None and out[0].t_ns - newest_ns <= SILENT_NS:
            return out
        return self._with_heading(self._second, out, m)

    def _content(self, frame: Frame) -> record.GpsRawInt:
        """Return what a message of either receiver says, as GPS_RAW_INT says it."""
        m = unpack(frame)
        self._record[0] = tuple([getattr(m, name) for name in self._names])
        return self._said[0]

    def _read(self, receiver: _Receiver, m: record.GpsRawInt) -> Measurements:
        """Return the new fix of a receiver, if there is one."""
        if (refusal := self._refusal(receiver, m)) is not None:
            return self._refuse(receiver, refusal)
        t_ns = self._time(receiver.message, int(m.time_usec))
        if isinstance(t_ns, str):
            return self._refuse(receiver, t_ns)
        receiver.fixes += 1
        if receiver.fixes < 2:
            # The one message before the first fix can be 140 km off
            return self._refuse(receiver, "first after none")
        self._compare_heights(receiver.message, m)
        receiver.newest_ns = t_ns
        return [self._fix(receiver, m, t_ns)]

    def _refuse(self, receiver: _Receiver, why: str) -> Measurements:
        """Count a refusal; return no measurements."""
        return self._context.refuse(f"{receiver.message}: {why}")

    def _refusal(self, receiver: _Receiver, m: record.GpsRawInt) -> str | None:
        """Return why a message holds no new fix; None if it does."""
        receiver.is_heard |= m.fix_type != _NO_GPS or not self._may_lack_receiver
        if m.fix_type < _FIX_3D or not is_place(m.lat, m.lon):
            receiver.fixes, receiver.is_good = 0, False
            self.is_settled &= self.is_alone or self.has_fix
            return "no 3-D fix" if m.fix_type < _FIX_3D else "no position"
        if receiver.is_good:
            receiver.has_fix = self.is_settled = True
        receiver.is_good = True
        key = [m.time_usec] if m.time_usec else [0, m.lat, m.lon, m.alt, m.vel, m.cog]
        if key == receiver.last:
            return "repeated"
        receiver.last = key
        return None

    @property
    def _may_lack_receiver(self) -> bool:
        """Whether GPS_RAW_INT comes without a receiver too, and an own position is a position.

        PX4 sends no GLOBAL_POSITION_INT before it knows where it is.
        """
        return self._context.family is Family.PX4

    def _time(self, message: str, stamp_us: Stamp) -> int | str:
        """Return the time of a fix, ns, or why there is none.

        A stamp of 0 means now. So does one on the other base where SYSTEM_TIME, which would relate
        the two, has been missing or without unix time for long.
        """
        clock = self._context.clock
        if stamp_us > LAST_US:
            return "no time"
        if not stamp_us and clock.is_in_doubt:
            return "stamp leaps"
        now_ns = clock.latest_ns
        t_ns = clock.from_us(stamp_us) if stamp_us else now_ns
        if now_ns is None:
            return "time base unknown"
        if t_ns is None:
            if self._unrelated_ns is None:
                self._unrelated_ns = now_ns
            if now_ns - self._unrelated_ns < _UNRELATED_NS or clock.is_in_doubt:
                return "time base unknown"
            self._context.refused[f"{message}: stamp replaced by the time of arrival"] += 1
            self._context.note_once(
                f"{message} and the inertial samples are stamped by different clocks, and no "
                "SYSTEM_TIME relates them: fixes count as of the newest inertial sample"
            )
            return now_ns
        if abs(t_ns - now_ns) > _STRAY_NS:
            return "stamp far from the inertial samples"
        return t_ns

    def _compare_heights(self, message: str, m: record.GpsRawInt) -> None:
        """Note where the height above the sea can only be some other height."""
        if m.alt_ellipsoid != 0 and abs(float(m.alt) - m.alt_ellipsoid) * 1e-3 > _GEOID:
            self._context.refused[f"{message}: height above the sea in doubt"] += 1
            self._context.note_once(
                f"{message}: the height above the sea and that above the ellipsoid are further "
                "apart than anywhere on Earth; the first is used: check the receiver's driver"
            )

    def _fix(self, receiver: _Receiver, m: record.GpsRawInt, t_ns: Stamp) -> GnssFix:
        """Return a fix, without its velocity where that was not measured."""
        place = math.radians(m.lat * 1e-7), math.radians(m.lon * 1e-7), m.alt * 1e-3
        std_h = m.h_acc * 1e-3 or dilution(m.eph) or _STD_UNKNOWN
        std_v = m.v_acc * 1e-3 or dilution(m.epv) or 1.5 * std_h
        vel_north = vel_east = std_vel = None
        if m.vel != _UNKNOWN_16 and m.cog <= NORTH_CDEG:
            speed, course = m.vel * 1e-2, math.radians(m.cog * 1e-2)
            vel_north, vel_east = speed * math.cos(course), speed * math.sin(course)
            std_vel = m.vel_acc * 1e-3 or _STD_VEL
        if not receiver.flags:
            self.std = std_h, std_v, std_vel or 0.0
        vel = vel_north, vel_east, None
        why, _ = receiver.velocities.judge(t_ns, place, vel, std_h, std_v)
        if why is not None:
            self._note_velocity(receiver.message, why)
            vel_north = vel_east = std_vel = None
        return GnssFix(
            t_ns=t_ns,
            lat=place[0],
            lon=place[1],
            alt=place[2],
            vel_north=vel_north,
            vel_east=vel_east,
            std_h=std_h,
            std_v=std_v,
            std_vel=std_vel,
            flags=receiver.flags,
        )

    def _note_velocity(self, message: str, why: str) -> None:
        """Count a velocity that was not measured, and tell a human where there may be none."""
        self._context.refused[f"{message}: {why}"] += 1
        if why not in SINGLE:
            self._context.note_once(
                f"{message}: the velocity says the same again and again while the "
                "positions move otherwise, so it is not used; check the receiver's settings"
            )

    def _with_heading(
        self, receiver: _Receiver, fixes: Measurements, m: record.GpsRawInt
    ) -> Measurements:
        """Return the fix of a message, if there is one, with the heading of its antennas.

        One that is the last again is left out; at rest it counts once in a second all the same.
        """
        if not fixes or not 0 < m.yaw <= NORTH_CDEG:
            return fixes
        t_ns, heading = fixes[0].t_ns, wrap(math.radians(m.yaw * 1e-2))
        is_still = m.vel != _UNKNOWN_16 and m.vel * 1e-2 < _STD_VEL
        # In a message a yaw of 0 is none, and 360 deg is north
        if why := receiver.yaw.judge(t_ns, heading, is_still=is_still, is_north=True):
            self._refuse(receiver, f"yaw {why}")
            return fixes
        std = yaw_std(m.hdg_acc)
        sample = HeadingSample(t_ns=t_ns, heading=heading, std=std, source=HeadingSource.GNSS)
        return [*fixes, sample]


def is_place(lat_degE7: int, lon_degE7: int) -> bool:
    """Return whether a latitude and a longitude can be a position, as ``nav.earth`` does."""
    is_within = abs(lat_degE7 * 1e-7) <= 90.0 and abs(lon_degE7 * 1e-7) <= 180.0
    return is_within and (lat_degE7 != 0 or lon_degE7 != 0)


def dilution(dop_100: int) -> float:
    """Return the one sigma, m, of a dilution of precision times 100; 0.0 where it is unknown."""
    if dop_100 in (0, 9999, _UNKNOWN_16):
        return 0.0
    return max(_RANGE_ERROR * dop_100 * 1e-2, _STD_FLOOR)


def yaw_std(hdg_acc_degE5: int) -> float:
    """Return the one sigma, rad, of a dual-antenna heading."""
    if hdg_acc_degE5 == 0:
        return _STD_YAW
    return min(max(math.radians(hdg_acc_degE5 * 1e-5), _STD_YAW_FLOOR), math.pi)
