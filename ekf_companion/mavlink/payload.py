"""The messages that come most often, from their payloads to rows (compiled).

Each is read where it plainly follows the last of its kind, to the bit as the decoder reads it. One
that may change anybody's mind (a stamp that leaps, another sensor, a field that is not the Earth's)
is not: nothing has changed then.
"""

from __future__ import annotations

import math

import cython
import numpy as np
import numpy.typing as npt
from cython.cimports.ekf_companion.mavlink.decode.fix import Fixes, is_place
from cython.cimports.libc.math import isfinite, sqrt

from ekf_companion.mavlink import record
from ekf_companion.mavlink.clock import FOREIGN
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.decode.air import HIGHEST, LOWEST, STRONGEST, WEAKEST
from ekf_companion.mavlink.decode.context import Context, Measurements
from ekf_companion.mavlink.decode.decoder import Decoder
from ekf_companion.mavlink.decode.heading import NORTH_CDEG, Heading, wrap
from ekf_companion.mavlink.decode.inertial import ACCEL_GYRO, MAG, PRESSURE, Inertial
from ekf_companion.mavlink.decode.state import FieldState, PressureState
from ekf_companion.mavlink.decode.trim import Trim
from ekf_companion.mavlink.frame import parsed
from ekf_companion.mavlink.messages import IDS, by_name
from ekf_companion.mavlink.past_frames import SLACK_US
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import Stamp
from ekf_companion.mavlink.timebase import LAST_US, SURE_US, UNIX_FROM_US, TimeBase
from ekf_companion.nav.arrays import Column, Table
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.earth import pressure_altitude
from ekf_companion.nav.lanes import CHANGED
from ekf_companion.nav.measurements import WIDTH, HeadingSource, Kind, Row
from ekf_companion.nav.stamps import NEAR_US

FIX_ID = IDS["GPS_RAW_INT"]
_ROOM = 64
"""Bytes of the longest payload that is read here."""
_BOOT_US = (1 << 31) * 1000
"""Times since boot beyond are left to the decoder: they wrap."""
_DEGREE = math.pi / 180.0
OF_AUTOPILOT = cython.declare(cython.double, HeadingSource.AUTOPILOT)
IMU_ROW = cython.declare(cython.longlong, Kind.IMU)
MAG_ROW = cython.declare(cython.longlong, Kind.MAG)
BARO_ROW = cython.declare(cython.longlong, Kind.BARO)
HEADING_ROW = cython.declare(cython.longlong, Kind.HEADING)


class PayloadReader:
    """Reads payloads for one session, and writes rows into the arrays of a buffer."""

    def __init__(self, session: Session) -> None:
        """Begin with a buffer for the rows of one frame."""
        self.session = session
        self.decoder: Decoder = session.decoder
        decoder, options = session.decoder, session.options.decoder
        self.context: Context = decoder.context
        self.trim: Trim = decoder.trim
        self.imu: Inertial = decoder.inertial
        self.mag: FieldState = decoder.mag
        self.baro: PressureState = decoder.baro
        self.heading: Heading = decoder.heading
        self.fixes: Fixes = decoder.fixes
        self.position = decoder.position
        self.newest: dict[int, int] = session.past.newest
        self.imu_id: int = options.imu_id
        self.heading_std: float = options.heading_std
        self.clock: TimeBase = decoder.clock
        self.is_idle = False
        self.our_system: int = session.outbox.ids[0]
        self.our_component: int = session.outbox.ids[1]
        # One payload, which each message overlays
        self.payload = payload = np.zeros(_ROOM, dtype=np.uint8)
        self.sample: Column[record.HighresImu] = _overlay(payload, "HIGHRES_IMU")
        self.attitude: Column[record.Attitude] = _overlay(payload, "ATTITUDE")
        self.fix: Column[record.GpsRawInt] = _overlay(payload, "GPS_RAW_INT")
        self.place: Column[record.GlobalPositionInt] = _overlay(payload, "GLOBAL_POSITION_INT")
        self.timesync: Column[record.Timesync] = _overlay(payload, "TIMESYNC")
        self.own = EventBuffer(1)
        self._use(self.own)

    def _use(self, buffer: EventBuffer) -> None:
        """Write rows into a buffer."""
        self.buffer = buffer
        self.n: int = buffer.size
        self.limit: int = buffer.limit
        self.out_t: Column[np.int64] = buffer.t_ns
        self.out_kind: Column[np.int64] = buffer.kind
        self.out: Table[np.float64] = buffer.values

    def _begin_row(self, t_ns: int, kind: int) -> int:
        """Begin a row of zeros; return its number."""
        if self.n == self.out_t.shape[0]:
            self._grow()
        i = self.n
        self.out_t[i], self.out_kind[i] = t_ns, kind
        for j in range(self.out.shape[1]):
            self.out[i, j] = 0.0
        self.n += 1
        return i

    def _grow(self) -> None:
        """Make room for more rows: frames that waited are written with the one that frees them."""
        self.buffer.size = self.n
        self.buffer.grow()
        self._use(self.buffer)

    def _put_rows(self, measurements: Measurements) -> None:
        """Write the rows of measurements that the decoder has made."""
        for measurement in measurements:
            t_ns, kind, values = measurement.row()
            i = self._begin_row(t_ns, kind)
            for j in range(WIDTH):
                self.out[i, j] = values[j]

    def _put_vector(self, i: int, first: int, x: float, y: float, z: float) -> None:
        """Write a vector of the board into a row, in the vehicle's axes."""
        if self.trim.rows is not None:
            x, y, z = self.trim.to_vehicle(x, y, z)
        self.out[i, first], self.out[i, first + 1], self.out[i, first + 2] = x, y, z

    def _put_heading(self, t_ns: int, heading: float) -> None:
        """Write a heading of the autopilot's, rad."""
        self.heading.pace.admit(t_ns)
        i = self._begin_row(t_ns, HEADING_ROW)
        self.out[i, 0], self.out[i, 1] = wrap(heading), self.heading_std
        self.out[i, 2] = OF_AUTOPILOT

    def _take_rows(self) -> list[Row]:
        """Return the rows of the buffer."""
        rows = []
        for i in range(self.n):
            values = tuple([self.out[i, j] for j in range(WIDTH)])
            rows.append((self.out_t[i], self.out_kind[i], values))
        return rows

    def _free(self) -> None:
        """Write the rows of the frames that waited."""
        if self.decoder.held:
            self._put_rows(self.decoder.free())

    def _read_timesync(self) -> bool:
        """Count an answer to somebody else, or a request; without requests of ours all are."""
        m = self.timesync[0]
        if not self.is_idle:
            return False
        if m.tc1 != 0:
            self.session.timesync.refused[FOREIGN] += 1
            return True
        is_system = m.target_system == 0 or m.target_system == self.our_system
        is_component = m.target_component == 0 or m.target_component == self.our_component
        if not (is_system and is_component):
            self.session.misaddressed[IDS["TIMESYNC"]] += 1
        return True

    def _is_near(self, stamp: int) -> bool:
        """Return whether a time since boot, us, is near that of the inertial samples."""
        main = self.clock.main
        if main.latest_us is None or main.leap_us is not None:
            return False
        latest = cython.declare(cython.longlong, main.latest_us)
        if latest > UNIX_FROM_US or latest > _BOOT_US or stamp == 0:
            return False
        # One that is further behind may have been heard before
        return -SLACK_US <= stamp - latest <= NEAR_US

    def _advance(self, stamp: int, now_ns: Stamp) -> None:
        """Advance the clock to a time since boot, us, that arrived now, and free what waited."""
        self.clock.now_us = now_ns // 4000 * 4
        self.clock.advance_boot_ms(stamp // 1000)
        if not self.clock.is_behind:
            self._free()

    def _read_attitude(self, now_ns: Stamp) -> bool:
        """Follow the stamp of an attitude, and write its heading if that is due."""
        m, main = self.attitude[0], self.clock.main
        stamp = cython.cast(cython.longlong, m.time_boot_ms) * 1000
        if self.context.is_yaw_ours or not self._is_near(stamp):
            return False
        is_late = stamp < main.latest_us
        if is_late and main.behind_us is not None and stamp - main.behind_us >= SURE_US:
            return False
        is_due = self.heading.pace.is_due(stamp * 1000)
        if not isfinite(m.yaw) or self.heading.sources.rank != 0 or (is_due and is_late):
            return False
        self._advance(stamp, now_ns)
        self.heading.sources.admit(0, stamp * 1000)
        if is_due:
            self._put_heading(stamp * 1000, m.yaw)
        return True

    def _read_position(self, raw: bytes, now_ns: Stamp) -> bool:
        """Follow the stamp of an autopilot's own position, and write what of it is due."""
        m = self.place[0]
        stamp = cython.cast(cython.longlong, m.time_boot_ms) * 1000
        if self.context.is_ours or self.context.is_yaw_ours or not self._is_near(stamp):
            return False
        if not self.fixes.is_settled:
            return False
        if self.session.options.guard is not None and not self.session.origin.is_shown:
            return False
        if stamp < self.clock.main.latest_us or not is_place(m.lat, m.lon):
            return False
        self._advance(stamp, now_ns)
        t_ns = stamp * 1000
        is_taken = m.hdg <= NORTH_CDEG and self.heading.sources.admit(1, t_ns)
        if is_taken and self.heading.pace.is_due(t_ns):
            self._put_heading(t_ns, m.hdg * 1e-2 * _DEGREE)
        if self.position.derived_pace.admit(t_ns):
            said = unpack(parsed(IDS["GLOBAL_POSITION_INT"], raw))
            self._put_rows([self.position.derived(said, t_ns)])
        return True

    def _read_fix(self) -> bool:
        """Write the fix of the receiver; its stamp says nothing of the clock."""
        m = self.fix[0]
        if self.clock.is_behind or 0 < m.time_usec < self.newest.get(FIX_ID, 0):
            return False
        if m.time_usec != 0:
            self.newest[FIX_ID] = m.time_usec
        measurements = self.fixes.read_first(m)
        if self.decoder.notes:
            self.session.emit_notes()
        self._free()
        self._put_rows(measurements)
        return True

    def _read_inertial(self) -> bool:
        """Read a sample that plainly follows the last, with what came with it."""
        m = self.sample[0]
        rank = 0 if m.id == self.imu_id else m.id + 1
        if rank != self.imu.instances.rank or self.imu.sources.rank != 0:
            return False
        if self.trim.first_ns is None or m.fields_updated & ACCEL_GYRO != ACCEL_GYRO:
            return False
        t_us = cython.cast(cython.longlong, m.time_usec)
        if not 0 < t_us <= LAST_US or t_us <= self.imu.last_us:
            return False
        is_watched: bool = self.imu.is_watching
        if is_watched and (t_us >= self.imu.look_us or not self.imu.lanes.is_plain()):
            return False
        gx, gy, gz = float(m.xgyro), float(m.ygyro), float(m.zgyro)
        ax, ay, az = float(m.xacc), float(m.yacc), float(m.zacc)
        mx, my, mz = float(m.xmag), float(m.ymag), float(m.zmag)
        pressure = float(m.abs_pressure)
        if not isfinite(gx + gy + gz + ax + ay + az):
            return False
        has_field = m.fields_updated & MAG == MAG
        is_zero = mx == 0.0 and my == 0.0 and mz == 0.0
        has_pressure = m.fields_updated & PRESSURE != 0 and pressure != 0.0
        if has_field and not is_zero and not self._can_read_field(mx, my, mz):
            return False
        if has_pressure and not self._can_read_pressure(pressure):
            return False
        if not self.clock.follow(t_us):
            return False
        self._free()
        t_ns: int = t_us * 1000
        if is_watched and self.imu.lanes.add(m.id, t_ns, gx, gy, gz, ax, ay, az) == CHANGED:
            measurements: Measurements = []
            self.decoder.inertial.change(measurements)
            self.session.emit_notes()
            self._put_rows(measurements)
            return True
        if rank != self.imu.instances.sole:
            self.imu.instances.admit(rank, t_ns)
        if has_field and not is_zero:
            self.imu.repetition.see(mx, my, mz)
        why = self.imu.repetition.judge_axes(t_us, gx, gy, gz, ax, ay, az)
        self.imu.last_us = t_us
        if why is not None:
            is_refused = self.decoder.inertial.is_refused(why)
            self.session.emit_notes()
            if is_refused:
                return True
        if self.imu.sources.sole != 0:
            self.imu.sources.admit(0, t_ns)
        if self.imu.dejitter is not None:
            t_ns = self.imu.dejitter.smooth(t_us)
        i = self._begin_row(t_ns, IMU_ROW)
        self._put_vector(i, 0, gx, gy, gz)
        self._put_vector(i, 3, ax, ay, az)
        if has_field and not is_zero:
            self._read_field(t_ns, mx, my, mz)
        elif has_field and self.mag.last:
            self.decoder.refused["mag: of zeros"] += 1
        if has_pressure:
            self._read_pressure(t_ns, pressure)
        return True

    def _is_last(self, x: float, y: float, z: float) -> bool:
        """Return whether a magnetic field is the last one again."""
        if not self.mag.last:
            return False
        was_x, was_y, was_z = self.mag.last
        return x == float(was_x) and y == float(was_y) and z == float(was_z)

    def _can_read_field(self, x: float, y: float, z: float) -> bool:
        """Return whether a magnetic field, gauss, is the last one again, or the Earth's."""
        if self.mag.sources.rank != 0:
            return False
        return WEAKEST <= sqrt(x * x + y * y + z * z) <= STRONGEST or self._is_last(x, y, z)

    def _read_field(self, t_ns: int, x: float, y: float, z: float) -> None:
        """Write a magnetic field that is not the last one again."""
        if self.mag.sources.sole != 0:
            self.mag.sources.admit(0, t_ns)
        if not self._is_last(x, y, z):
            self.mag.last, self.mag.strange = (x, y, z), 0
            self._put_vector(self._begin_row(t_ns, MAG_ROW), 0, x, y, z)

    def _can_read_pressure(self, pressure: float) -> bool:
        """Return whether a pressure is the last one again, or in hPa that of the air."""
        if self.baro.sources.rank != 0:
            return False
        if pressure == self.baro.last:
            return True
        if self.context.is_submarine or LOWEST <= pressure <= HIGHEST:
            return False
        return LOWEST <= pressure * 100.0 <= HIGHEST

    def _read_pressure(self, t_ns: int, pressure: float) -> None:
        """Write the height of a pressure, hPa, that is not the last one again."""
        if self.baro.sources.sole != 0:
            self.baro.sources.admit(0, t_ns)
        if pressure != self.baro.last:
            self.baro.last = pressure
            self.out[self._begin_row(t_ns, BARO_ROW), 0] = pressure_altitude(pressure * 100.0)


def _overlay(payload: npt.NDArray[np.uint8], message: str) -> npt.NDArray[np.void]:
    """Return a payload as the one record of a message that lies in it."""
    layout = by_name(message)
    return payload[: layout.size].view(layout.dtype).view(np.recarray)


def fill(payload: Column[np.uint8], data: cython.p_const_uchar, begin: int, size: int) -> None:
    """Copy a payload, and the zeros that it lacks at its end."""
    size = min(size, _ROOM)
    for i in range(size):
        payload[i] = data[begin + i]
    for i in range(size, _ROOM):
        payload[i] = 0
