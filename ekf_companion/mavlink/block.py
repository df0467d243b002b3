"""The frames of a recording, many at once (compiled).

Of a flight's frames nearly all are inertial samples that plainly follow the last, attitudes,
positions, and messages that nobody reads. Those are read here, from columns, to the bit as the
session and its decoder read them. A frame that may change anybody's mind (a heartbeat, a command, a
parameter, a stamp that leaps, another sensor) is left to the session.
"""

from __future__ import annotations

import cython
import numpy as np
from cython.cimports.ekf_companion.mavlink.block_rows import radians
from cython.cimports.libc.math import isfinite, sqrt

from ekf_companion.mavlink.block_columns import Columns, Frames, kinds_of
from ekf_companion.mavlink.block_rows import RowWriter
from ekf_companion.mavlink.clock import FOREIGN
from ekf_companion.mavlink.decode.air import HIGHEST, LOWEST, STRONGEST, WEAKEST
from ekf_companion.mavlink.decode.decoder import HELD
from ekf_companion.mavlink.decode.heading import NORTH_CDEG, wrap
from ekf_companion.mavlink.decode.inertial import ACCEL_GYRO, MAG, PRESSURE
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.past_frames import SLACK_US
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.timebase import NEAR_US, SURE_US, UNIX_FROM_US
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.earth import is_place, pressure_altitude

BYTES = cython.declare(cython.int, -1)
ANYBODYS = cython.declare(cython.int, 0)
READ = cython.declare(cython.int, 2)
INERTIAL = cython.declare(cython.int, 4)
ATTITUDE = cython.declare(cython.int, 5)
TIMESYNC = cython.declare(cython.int, 6)
FIX = cython.declare(cython.int, 7)
POSITION = cython.declare(cython.int, 8)
"""As in :mod:`.block_columns`."""
HEARTBEAT_ID = cython.declare(cython.longlong, IDS["HEARTBEAT"])
ODOMETRY_ID = cython.declare(cython.longlong, IDS["ODOMETRY"])
TIMESYNC_ID = cython.declare(cython.longlong, IDS["TIMESYNC"])
LAST_MS = cython.declare(cython.longlong, 1 << 31)
"""Milliseconds of boot time beyond are left to the decoder: they wrap."""
SLACK = cython.declare(cython.longlong, SLACK_US)
NEAR = cython.declare(cython.longlong, NEAR_US)
SURE = cython.declare(cython.longlong, SURE_US)
UNIX = cython.declare(cython.longlong, UNIX_FROM_US)
HAS_SAMPLE = cython.declare(cython.longlong, ACCEL_GYRO)
HAS_FIELD = cython.declare(cython.longlong, MAG)
HAS_PRESSURE = cython.declare(cython.longlong, PRESSURE)
LEAST_FIELD = cython.declare(cython.double, WEAKEST)
LARGEST_FIELD = cython.declare(cython.double, STRONGEST)
LEAST_PRESSURE = cython.declare(cython.double, LOWEST)
LARGEST_PRESSURE = cython.declare(cython.double, HIGHEST)
LARGEST_HEADING = cython.declare(cython.double, NORTH_CDEG)


class BlockReader(RowWriter):
    """Reads the frames of a recording for one session, as far as it can."""

    def __init__(self, session: Session) -> None:
        """Begin without frames."""
        self.session = session
        self.kinds = kinds_of(session)
        self.heard_by_id = np.zeros(len(self.kinds), dtype=np.int64)
        self.pending: list[int] = []
        self.decoder = decoder = session.decoder
        super().__init__(decoder.trim)
        self.context, self.imu, self.mag = decoder.context, decoder.inertial, decoder.mag
        self.baro, self.heading, self.position = decoder.baro, decoder.heading, decoder.position
        self.numbers = session.sequence
        options, admission = session.options, session.admission
        self.imu_id, self.heading_std = options.decoder.imu_id, options.decoder.heading_std
        self.is_usable = not (admission.is_selective or options.is_recording)
        self.is_usable &= session.on_frame is None

    def open(self, frames: Frames) -> None:
        """Take the next frames; all before have been read."""
        self.close()
        columns = Columns(frames, self.kinds)
        self.frames = frames
        self.kind, self.message_id, self.row = columns.kind, columns.message_id, columns.row
        self.sequence, self.size_of = columns.sequence, columns.size
        self.system, self.component = columns.system, columns.component
        self.stamp_us = columns.stamp_us
        self.t_us, self.samples = columns.t_us, columns.samples
        self.updated, self.instance = columns.updated, columns.instance
        self.boot_ms, self.yaw = columns.boot_ms, columns.yaw
        self.position_ms, self.positions = columns.position_ms, columns.positions
        self.is_answer = columns.is_answer
        self.target_system = columns.target_system
        self.target_component = columns.target_component

    def close(self) -> None:
        """Leave all that is known to the session."""
        self.settle()
        counts = np.asarray(self.heard_by_id)
        for number in np.flatnonzero(counts).tolist():
            self.session.received[number] += int(counts[number])
        counts[:] = 0

    def settle(self) -> None:
        """Hand the frames that wait to the decoder: the session goes on from here."""
        for i in self.pending:
            self.session.decoder.held.append((self.frames.frame(i), []))
        self.pending.clear()

    def is_whole(self, i: int) -> bool:
        """Return whether the session may take a frame as a whole, and needs not see its bytes."""
        return self.kind[i] != BYTES and self.session.splitter.is_empty

    def read(self, i: int, buffer: EventBuffer) -> int:
        """Read frames from one on; return the first that is left to the session, or their number.

        It also ends where the buffer is full.
        """
        if not self.is_usable or not self.load(buffer):
            return i
        end = self.read_on(i)
        self.store()
        if end > i:
            self.session.past.keep_run(self.frames, i, end)
        return end

    def load(self, buffer: EventBuffer) -> bool:
        """Look up where the session stands; return whether anything can be read here."""
        session = self.session
        peer = session.discovery.peer
        if peer is None or session.guard.is_waiting:
            return False
        if not session.splitter.is_empty:
            return False
        self.peer_system, self.peer_component = peer
        self.our_system, self.our_component = session.outbox.ids
        self.is_yielding = session.clash.is_yielding
        self.is_idle = session.timesync.is_idle
        self.clock = self.context.clock
        self.main = self.clock.main
        self.is_position_plain = session.options.guard is None or session.origin.is_shown
        self.has_held = bool(self.decoder.held) or bool(self.pending)
        self.heard = self.believed = self.echoes = self.strangers = self.count = self.volume = 0
        self.use(buffer)
        return True

    def store(self) -> None:
        """Store in the session what was counted and changed."""
        self.buffer.size = self.n
        if self.count:
            self.session.pass_over(
                self.count, self.volume, self.heard, self.believed, self.strangers, self.echoes
            )

    def read_on(self, i: int) -> int:
        """Do the work of :meth:`read`."""
        while i < self.kind.shape[0] and self.n < self.limit:
            kind = self.kind[i]
            number = self.message_id[i]
            if kind == BYTES:
                break
            if self.system[i] == self.our_system and self.component[i] == self.our_component:
                if number == HEARTBEAT_ID or (number == ODOMETRY_ID and self.is_yielding):
                    break
                self.echoes += 1
            elif kind == ANYBODYS:
                break
            elif self.system[i] == self.peer_system and self.component[i] == self.peer_component:
                if kind <= READ or not self.read_message(kind, i):
                    break
                self.numbers.count(self.sequence[i], self.stamp_us[i] * 1000)
                self.heard_by_id[number] += 1
                self.heard += 1
                self.believed += 1
                # A frame behind the clock waits with those held; the next that is not frees them
                if self.clock.is_behind:
                    self.hold(i)
                elif self.has_held:
                    self.free()
            else:
                self.strangers += 1
                self.believed += 1
            self.count += 1
            self.volume += self.size_of[i]
            i += 1
        return i

    def read_message(self, kind: int, i: int) -> bool:
        """Read a frame of a message; return whether it could be read here."""
        if kind == INERTIAL:
            return self.read_inertial(self.row[i])
        if kind == ATTITUDE:
            return self.read_attitude(i)
        if kind == TIMESYNC:
            return self.read_timesync(self.row[i])
        if kind == POSITION:
            return self.read_position(i)
        if kind == FIX:
            return self.read_fix(i)
        return True

    def hold(self, i: int) -> None:
        """Let a frame without measurements wait until it is known what the clock did."""
        if len(self.decoder.held) + len(self.pending) < HELD:
            self.pending.append(i)
            self.has_held = True

    def free(self) -> None:
        """Write the rows of the frames that waited."""
        self.has_held = False
        self.pending.clear()
        held, self.decoder.held = self.decoder.held, []
        for _, measurements in held:
            self.put_rows(measurements)

    def read_timesync(self, k: int) -> bool:
        """Count an answer to somebody else, or a request; without requests of ours all are."""
        if not self.is_idle:
            return False
        if self.is_answer[k]:
            self.session.timesync.refused[FOREIGN] += 1
            return True
        is_system = self.target_system[k] == 0 or self.target_system[k] == self.our_system
        component = self.target_component[k]
        if not is_system or not (component == 0 or component == self.our_component):
            self.session.misaddressed[TIMESYNC_ID] += 1
        return True

    def read_attitude(self, i: int) -> bool:
        """Follow the stamp of an attitude, and write its heading if that is due."""
        k = self.row[i]
        stamp = self.boot_ms[k] * 1000
        if self.context.is_yaw_ours or not self.is_near(stamp):
            return False
        is_late = stamp < self.main.latest_us
        if is_late and self.main.behind_us is not None and stamp - self.main.behind_us >= SURE:
            return False
        is_due = self.heading.pace.is_due(stamp * 1000)
        is_taken = isfinite(self.yaw[k]) and self.heading.sources.rank == 0
        if not is_taken or (is_due and is_late):
            return False
        self.clock.now_us = self.stamp_us[i] // 4 * 4
        self.clock.advance_boot_ms(self.boot_ms[k])
        self.heading.sources.admit(0, stamp * 1000)
        if is_due:
            self.write_heading(stamp * 1000, self.yaw[k])
        return True

    def is_near(self, stamp: int) -> bool:
        """Return whether a time since boot, us, is near that of the inertial samples."""
        if self.main.latest_us is None or self.main.leap_us is not None:
            return False
        latest = cython.declare(cython.longlong, self.main.latest_us)
        if latest > UNIX or latest // 1000 > LAST_MS or stamp == 0:
            return False
        # One that is further behind may have been heard before
        return -SLACK <= stamp - latest <= NEAR

    def read_position(self, i: int) -> bool:
        """Follow the stamp of an autopilot's own position, and write what of it is due."""
        k = self.row[i]
        stamp = self.position_ms[k] * 1000
        place = self.positions[k]
        if not self.is_position_plain or self.context.is_ours or self.context.is_yaw_ours:
            return False
        if not self.is_near(stamp) or not self.position.is_settled:
            return False
        if stamp < self.main.latest_us or not is_place(1e-7 * place[0], 1e-7 * place[1]):
            return False
        self.clock.now_us = self.stamp_us[i] // 4 * 4
        self.clock.advance_boot_ms(self.position_ms[k])
        t_ns = stamp * 1000
        is_taken = place[6] <= LARGEST_HEADING and self.heading.sources.admit(1, t_ns)
        if is_taken and self.heading.pace.is_due(t_ns):
            self.write_heading(t_ns, radians(place[6] * 1e-2))
        if self.position.derived_pace.admit(t_ns):
            if self.has_held:
                self.free()
            self.put_position(t_ns, place, self.position.derived_std)
        return True

    def read_fix(self, i: int) -> bool:
        """Let the decoder read a fix of the receiver, which says nothing of the clock."""
        frame = self.frames.frame(i)
        if self.clock.is_behind or self.session.past.is_behind(frame, self.clock):
            return False
        measurements = self.position.gps_raw_int(frame)
        if self.decoder.notes:
            self.session.emit_notes()
        if self.has_held:
            self.free()
        self.put_rows(measurements)
        return True

    def write_heading(self, t_ns: int, yaw: float) -> None:
        """Write a heading of the autopilot's."""
        if self.has_held:
            self.free()
        self.heading.pace.admit(t_ns)
        self.put_heading(t_ns, wrap(yaw), self.heading_std)

    def read_inertial(self, k: int) -> bool:
        """Read a sample that plainly follows the last, with what came with it."""
        t_us = self.t_us[k]
        rank = 0 if self.instance[k] == self.imu_id else self.instance[k] + 1
        if rank != self.imu.instances.rank or self.imu.sources.rank != 0:
            return False
        if self.trim.first_ns is None or self.updated[k] & HAS_SAMPLE != HAS_SAMPLE:
            return False
        if t_us <= 0 or t_us <= self.imu.last_us:
            return False
        row = self.samples[k]
        if not isfinite(row[0] + row[1] + row[2] + row[3] + row[4] + row[5]):
            return False
        has_field = self.updated[k] & HAS_FIELD == HAS_FIELD
        is_zero = has_field and row[6] == 0.0 and row[7] == 0.0 and row[8] == 0.0
        has_field = has_field and not is_zero
        has_pressure = self.updated[k] & HAS_PRESSURE != 0 and row[9] != 0.0
        if has_field and not self.can_read_field(row):
            return False
        if has_pressure and not self.can_read_pressure(row[9]):
            return False
        if not self.clock.follow(t_us):
            return False
        if self.has_held:
            self.free()
        t_ns = t_us * 1000
        if rank != self.imu.instances.sole:
            self.imu.instances.admit(rank, t_ns)
        why = self.imu.repetition.judge_axes(t_us, row[0], row[1], row[2], row[3], row[4], row[5])
        self.imu.last_us = t_us
        if why is not None:
            is_refused = self.decoder.inertial.is_refused(why)
            self.session.emit_notes()
            if is_refused:
                return True
        if self.imu.sources.sole != 0:
            self.imu.sources.admit(0, t_ns)
        t_ns = self.write_sample(t_us, row)
        if has_field:
            self.write_field(t_ns, row)
        elif is_zero and self.mag.last:
            self.decoder.refused["mag: of zeros"] += 1
        if has_pressure:
            self.write_pressure(t_ns, row[9])
        return True

    def can_read_field(self, row: np.ndarray) -> bool:
        """Return whether a magnetic field is the last one again, or the Earth's."""
        if self.mag.sources.rank != 0:
            return False
        norm = sqrt(row[6] * row[6] + row[7] * row[7] + row[8] * row[8])
        return self.is_known(row) or LEAST_FIELD <= norm <= LARGEST_FIELD

    def is_known(self, row: np.ndarray) -> bool:
        """Return whether a magnetic field is the last one again."""
        if not self.mag.last:
            return False
        x, y, z = self.mag.last
        return row[6] == x and row[7] == y and row[8] == z

    def can_read_pressure(self, pressure: float) -> bool:
        """Return whether a pressure is the last one again, or in hPa that of the air."""
        if self.baro.sources.rank != 0:
            return False
        if pressure == self.baro.last:
            return True
        if self.context.is_submarine or LEAST_PRESSURE <= pressure <= LARGEST_PRESSURE:
            return False
        return LEAST_PRESSURE <= pressure * 100.0 <= LARGEST_PRESSURE

    def write_sample(self, t_us: int, row: np.ndarray) -> int:
        """Write a sample, unless it came out of order; return the time of what came with it, ns."""
        t_ns = t_us * 1000
        if self.imu.dejitter is not None:
            sampled = self.imu.dejitter.smooth(t_us)
            if sampled is None:
                self.decoder.refused["IMU: out of order"] += 1
                return t_ns
            t_ns = sampled
        self.put_sample(t_ns, row)
        return t_ns

    def write_field(self, t_ns: int, row: np.ndarray) -> None:
        """Write a magnetic field that is not the last one again."""
        if self.mag.sources.sole != 0:
            self.mag.sources.admit(0, t_ns)
        if self.is_known(row):
            return
        self.mag.last, self.mag.strange = (row[6], row[7], row[8]), 0
        self.put_field(t_ns, row)

    def write_pressure(self, t_ns: int, pressure: float) -> None:
        """Write the height of a pressure that is not the last one again."""
        if self.baro.sources.sole != 0:
            self.baro.sources.admit(0, t_ns)
        if pressure == self.baro.last:
            return
        self.baro.last = pressure
        self.put_height(t_ns, pressure_altitude(pressure * 100.0))
