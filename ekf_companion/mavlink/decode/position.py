"""Fixes of the GNSS receiver, and the autopilot's own position."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.context import Context, Family, Measurements
from ekf_companion.mavlink.decode.heading import NORTH_CDEG, Heading, wrap
from ekf_companion.mavlink.decode.preference import ABSENT_NS, Pace
from ekf_companion.mavlink.decode.state import PositionState
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.timebase import LAST_US
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.held_heading import HeldHeading
from ekf_companion.nav.held_velocity import REPEATED, HeldVelocities
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
_DERIVED = 3.0
"""The autopilot's own position repeats the errors of its fixes: nine count as one."""
_DERIVED_STD_H = 3.0
_DERIVED_STD_V = 4.5
_DERIVED_STD_VEL = 0.9
"""Floors, m and m/s: three times a plain receiver's 1.0, 1.5 and 0.3."""
_ALONE_NS = ABSENT_NS
"""The autopilot's own position waits for so long for a receiver that speaks."""


class _Receiver:
    """What is known of one receiver."""

    def __init__(self, message: str, flags: GnssFlag) -> None:
        self.message, self.flags = message, flags
        self.last: tuple[int, ...] = ()
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


class Position(PositionState):
    """Reads the position of each receiver, and of the autopilot's own estimate."""

    def __init__(self, context: Context, heading: Heading) -> None:
        self._context, self._heading = context, heading
        self.forget()

    def forget(self) -> None:
        """Forget everything after a reboot."""
        self.derived_pace = Pace(self._context.options.derived_rate)
        """Of the autopilot's own positions."""
        self._first = _Receiver("GPS_RAW_INT", GnssFlag.NONE)
        self._second = _Receiver("GPS2_RAW", GnssFlag.SECOND)
        self._unrelated_ns: int | None = None
        self._derived_ns: int | None = None
        """When the autopilot's own position came first."""
        self.is_settled = False
        """Whether it is known whether a receiver speaks, and one that does has had a fix."""
        self._derived_std = (_DERIVED_STD_H, _DERIVED_STD_V, _DERIVED_STD_VEL)

    def gps_raw_int(self, frame: Frame) -> Measurements:
        """Read GPS_RAW_INT."""
        m = unpack(frame)
        out = self._read(self._first, m)
        return self._with_heading(self._first, out, m)

    def gps2_raw(self, frame: Frame) -> Measurements:
        """Read GPS2_RAW: a receiver that stands by, for the filter to go to.

        Its heading is used while the first has no fix, or has had no new one for a while.
        """
        m = unpack(frame)
        out = self._read(self._second, m)
        newest_ns = self._first.newest_ns if self._first.is_good else None
        if out and newest_ns is not None and out[0].t_ns - newest_ns <= SILENT_NS:
            return out
        return self._with_heading(self._second, out, m)

    def _with_heading(self, receiver: _Receiver, fixes: Measurements, m: Any) -> Measurements:
        """Return the fix of a message, if there is one, with the heading of its antennas.

        One that is the last again is left out; at rest it counts once in a second all the same.
        """
        if not fixes or not 0 < m.yaw <= NORTH_CDEG:
            return fixes
        t_ns, heading = fixes[0].t_ns, wrap(math.radians(m.yaw * 1e-2))
        is_still = m.vel != _UNKNOWN_16 and m.vel * 1e-2 < _STD_VEL
        if heading and (why := receiver.yaw.judge(t_ns, heading, is_still=is_still)):
            self._context.refuse(f"{receiver.message}: yaw {why}")
            return fixes
        std = _yaw_std(m.hdg_acc)
        sample = HeadingSample(t_ns=t_ns, heading=heading, std=std, source=HeadingSource.GNSS)
        return [*fixes, sample]

    def _read(self, receiver: _Receiver, m: Any) -> Measurements:
        """Return the new fix of a receiver, if there is one."""
        if (refusal := self._refusal(receiver, m)) is not None:
            return self._context.refuse(f"{receiver.message}: {refusal}")
        t_ns = self._time(receiver.message, m.time_usec)
        if isinstance(t_ns, str):
            return self._context.refuse(f"{receiver.message}: {t_ns}")
        receiver.fixes += 1
        if receiver.fixes < 2:
            # The one message before the first fix can be 140 km off
            return self._context.refuse(f"{receiver.message}: first after none")
        self._compare_heights(receiver.message, m)
        receiver.newest_ns = t_ns
        return [self._with_velocity(receiver, self._fix(m, t_ns, receiver.flags))]

    def _with_velocity(self, receiver: _Receiver, fix: GnssFix) -> GnssFix:
        """Return a fix without its velocity, if that is none."""
        vel = fix.vel_north, fix.vel_east, None
        place = fix.lat, fix.lon, fix.alt
        why, _ = receiver.velocities.judge(fix.t_ns, place, vel, fix.std_h, fix.std_v)
        if why is None:
            return fix
        self._context.refused[f"{receiver.message}: {why}"] += 1
        if why != REPEATED:
            self._context.note_once(
                f"{receiver.message}: the velocity says the same again and again while the "
                "positions move otherwise, so it is not used; check the receiver's settings"
            )
        return replace(fix, vel_north=None, vel_east=None, std_vel=None)

    def _refusal(self, receiver: _Receiver, m: Any) -> str | None:
        """Return why a message holds no new fix; None if it does."""
        key = (m.time_usec,) if m.time_usec else (0, m.lat, m.lon, m.alt, m.vel, m.cog)
        receiver.is_heard |= m.fix_type != _NO_GPS or not self._may_lack_receiver
        if m.fix_type < _FIX_3D or not is_place(1e-7 * m.lat, 1e-7 * m.lon):
            receiver.fixes, receiver.is_good = 0, False
            self.is_settled &= self._is_alone or self._has_fix
            return "no 3-D fix" if m.fix_type < _FIX_3D else "no position"
        if receiver.is_good:
            receiver.has_fix = self.is_settled = True
        receiver.is_good = True
        if key == receiver.last:
            return "repeated"
        receiver.last = key
        return None

    @property
    def _has_fix(self) -> bool:
        """Whether any receiver has had a fix."""
        return self._first.has_fix or self._second.has_fix

    @property
    def _is_alone(self) -> bool:
        """Whether no receiver has been heard."""
        return not (self._first.is_heard or self._second.is_heard)

    @property
    def _may_lack_receiver(self) -> bool:
        """Whether GPS_RAW_INT comes without a receiver too, and an own position is a position.

        PX4 sends no GLOBAL_POSITION_INT before it knows where it is.
        """
        return self._context.family is Family.PX4

    def _time(self, message: str, stamp_us: int) -> int | str:
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

    def _compare_heights(self, message: str, m: Any) -> None:
        """Note where the height above the sea can only be some other height."""
        if m.alt_ellipsoid != 0 and abs(m.alt - m.alt_ellipsoid) * 1e-3 > _GEOID:
            self._context.refused[f"{message}: height above the sea in doubt"] += 1
            self._context.note_once(
                f"{message}: the height above the sea and that above the ellipsoid are further "
                "apart than anywhere on Earth; the first is used: check the receiver's driver"
            )

    def _fix(self, m: Any, t_ns: int, flags: GnssFlag) -> GnssFix:
        std_h = m.h_acc * 1e-3 or _dilution(m.eph) or _STD_UNKNOWN
        std_v = m.v_acc * 1e-3 or _dilution(m.epv) or 1.5 * std_h
        has_velocity = m.vel != _UNKNOWN_16 and m.cog <= NORTH_CDEG
        speed, course = m.vel * 1e-2, math.radians(m.cog * 1e-2)
        std_vel = (m.vel_acc * 1e-3 or _STD_VEL) if has_velocity else None
        if not flags:
            self._derived_std = (
                max(_DERIVED_STD_H, _DERIVED * std_h),
                max(_DERIVED_STD_V, _DERIVED * std_v),
                max(_DERIVED_STD_VEL, _DERIVED * (std_vel or 0.0)),
            )
        return GnssFix(
            t_ns=t_ns,
            lat=math.radians(m.lat * 1e-7),
            lon=math.radians(m.lon * 1e-7),
            alt=m.alt * 1e-3,
            vel_north=speed * math.cos(course) if has_velocity else None,
            vel_east=speed * math.sin(course) if has_velocity else None,
            std_h=std_h,
            std_v=std_v,
            std_vel=std_vel,
            flags=flags,
        )

    def global_position_int(self, frame: Frame) -> Measurements:
        """Read GLOBAL_POSITION_INT, marked as derived: the filter uses it only if configured to."""
        m = unpack(frame)
        out, t_ns = self._context.follow_ms(m.time_boot_ms, "GLOBAL_POSITION_INT")
        if t_ns is None:
            return out
        if m.hdg <= NORTH_CDEG:
            self._heading.add(out, 1, t_ns, math.radians(m.hdg * 1e-2))
        if not is_place(1e-7 * m.lat, 1e-7 * m.lon):
            self._context.refuse("GLOBAL_POSITION_INT: no position")
            return out
        if self._context.is_ours:
            self._context.refuse("GLOBAL_POSITION_INT: made of our own")
            return out
        if (refusal := self._derived_refusal(t_ns)) is not None:
            self._context.refuse(f"GLOBAL_POSITION_INT: {refusal}")
            return out
        if not self.derived_pace.admit(t_ns):
            return out
        out.append(self.derived(m, t_ns))
        return out

    def derived(self, m: Any, t_ns: int) -> GnssFix:
        """Return what a GLOBAL_POSITION_INT says as a fix."""
        std_h, std_v, std_vel = self._derived_std
        return GnssFix(
            t_ns=t_ns,
            lat=math.radians(m.lat * 1e-7),
            lon=math.radians(m.lon * 1e-7),
            alt=m.alt * 1e-3,
            vel_north=m.vx * 1e-2,
            vel_east=m.vy * 1e-2,
            vel_down=m.vz * 1e-2,
            std_h=std_h,
            std_v=std_v,
            std_vel=std_vel,
            flags=GnssFlag.DERIVED,
        )

    def _derived_refusal(self, t_ns: int) -> str | None:
        """Return why the autopilot's own position is none yet; None if it may be one.

        Before the first fix of its receiver ArduPilot sends where its dead reckoning began, moved
        by wind that it assumes.
        """
        if self._derived_ns is None or t_ns < self._derived_ns:
            self._derived_ns = t_ns
        if self._has_fix:
            return None
        if not self._is_alone:
            return "the receiver has no fix yet"
        if t_ns - self._derived_ns < _ALONE_NS:
            return "a receiver may still speak"
        self.is_settled = True
        return None


def _dilution(dop_100: int) -> float:
    """Return the one sigma, m, of a dilution of precision times 100; 0.0 where it is unknown."""
    if dop_100 in (0, 9999, _UNKNOWN_16):
        return 0.0
    return max(_RANGE_ERROR * dop_100 * 1e-2, _STD_FLOOR)


def _yaw_std(hdg_acc_degE5: int) -> float:
    """Return the one sigma, rad, of a dual-antenna heading."""
    if hdg_acc_degE5 == 0:
        return _STD_YAW
    return min(max(math.radians(hdg_acc_degE5 * 1e-5), _STD_YAW_FLOOR), math.pi)
