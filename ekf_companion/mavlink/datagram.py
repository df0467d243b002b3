"""The datagrams that come most often, live: plain samples, and messages that nobody reads.

They are taken to the bit as the session and its decoder take them, while few objects are touched:
a processor that is idle between two samples has to fetch each of them anew, and that takes longer
than what is done with them. Any other datagram is left to the session.
"""

from __future__ import annotations

from collections.abc import Hashable

import cython
import numpy as np

from ekf_companion.mavlink.autopilot_estimate import KEPT
from ekf_companion.mavlink.block import BlockReader
from ekf_companion.mavlink.block_columns import INERTIAL, LATEST_US, PASSED, READ, TIMESYNC
from ekf_companion.mavlink.frame import HEADER_SIZE, STX_2, Frame
from ekf_companion.mavlink.messages import CRC_EXTRAS, by_name
from ekf_companion.mavlink.session import Session
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.measurements import WIDTH, Row

SAMPLE = cython.declare(cython.int, INERTIAL)
READ_LATER = cython.declare(cython.int, READ)
ANSWERED = cython.declare(cython.int, TIMESYNC)
UNREAD = cython.declare(cython.int, PASSED)
COLUMNS = cython.declare(cython.Py_ssize_t, WIDTH)
LAST_US = cython.declare(cython.longlong, LATEST_US)
START = cython.declare(cython.int, STX_2)
AROUND = cython.declare(cython.Py_ssize_t, HEADER_SIZE)
STAMP_SIZE = cython.declare(cython.Py_ssize_t, 8)


class DatagramReader(BlockReader):
    """Reads datagrams of one frame for one session, as far as it can."""

    def __init__(self, session: Session) -> None:
        """Begin with nothing read."""
        super().__init__(session)
        self.layout = by_name("HIGHRES_IMU")
        self.changes, self.is_open = -1, False
        kinds = np.array(self.kinds)
        kinds[list(KEPT)] = READ
        self.kind_of = kinds
        self.extra_of = np.zeros(len(kinds), dtype=np.uint8)
        for number, extra in CRC_EXTRAS.items():
            self.extra_of[number] = extra[0]
        self.is_recording = session.options.is_recording
        # One row, which each datagram overwrites
        self.t_us, self.updated, self.instance = np.zeros((3, 1), dtype=np.int64)
        self.samples = np.zeros((1, 10))
        self.row_buffer = EventBuffer(1)

    def read_datagram(self, data: bytes, now_ns: int, sender: Hashable) -> list[Row] | None:
        """Return the rows of a datagram that was read now; None: it is left to the session.

        What it says is counted, and recorded, as the session would.
        """
        end = len(data) - 2
        number = self.message_of(data)
        if number < 0 or data[2] != 0:
            return None
        kind = self.kind_of[number]
        if kind != SAMPLE and kind != UNREAD:
            return None
        if self.session.changes != self.changes:
            self.look_up()
        if not self.is_open or sender != self.sender:
            return None
        if data[5] != self.peer_system or data[6] != self.peer_component:
            return None
        if checksum(data, end, self.extra_of[number]) != data[end] | data[end + 1] << 8:
            return None
        self.n = 0
        if kind == SAMPLE:
            self.fill(data[10:end])
            if self.t_us[0] > LAST_US or not self.read_inertial(0):
                return None
        elif self.clock.is_behind:
            return None
        self.numbers.count(data[4], now_ns)
        self.session.note_frame(number, end + 2)
        self.session.past.keep(Frame(number, data[5], data[6], data[4], data[10:end], data, 2))
        if self.is_recording:
            self.session.outbox.record(data, now_ns)
        return self.take_rows()

    def may_wait(self, data: bytes, due_ns: int) -> bool:
        """Return whether bytes may as well be received a moment later, with those after them.

        They may if they are one frame that says what the autopilot measures or estimates, which
        nobody answers; a sample, if its stamp is before a time at which something is due.
        """
        number = self.message_of(data)
        if number < 0:
            return False
        kind = self.kind_of[number]
        if kind == SAMPLE:
            stamp_us = int.from_bytes(data[10 : 10 + STAMP_SIZE], "little")
            return stamp_us * 1000 < due_ns
        return bool(kind >= READ_LATER and kind != ANSWERED)

    def message_of(self, data: bytes) -> int:
        """Return the id of the message of a datagram of one frame; -1: it is none that is known."""
        size = len(data)
        if size < AROUND or data[0] != START or data[1] + AROUND != size:
            return -1
        number: int = data[7] | data[8] << 8 | data[9] << 16
        return number if number < self.kind_of.shape[0] else -1

    def look_up(self) -> None:
        """Look up where the session stands, after it has done something else."""
        session = self.session
        self.changes = session.changes
        self.sender = session.autopilot_sender
        self.is_open = (
            self.sender == session.splitter.sender
            and not session.decoder.held
            and session.on_frame is None
            and not session.admission.is_selective
            and self.load(self.row_buffer)
            and (self.peer_system, self.peer_component) != (self.our_system, self.our_component)
        )

    def fill(self, payload: bytes) -> None:
        """Read the fields, which end where only zeros would follow."""
        (t_us, ax, ay, az, gx, gy, gz, mx, my, mz, pressure, _, _, _, updated, instance) = (
            self.layout.unpack(payload)
        )
        self.t_us[0] = min(t_us, LATEST_US + 1)
        self.updated[0], self.instance[0] = updated, instance
        row = self.samples[0]
        row[0], row[1], row[2] = gx, gy, gz
        row[3], row[4], row[5] = ax, ay, az
        row[6], row[7], row[8] = mx, my, mz
        row[9] = pressure

    def take_rows(self) -> list[Row]:
        """Return the rows of the buffer, and leave it empty."""
        rows = []
        for i in range(self.n):
            values = tuple([self.out[i, j] for j in range(COLUMNS)])
            rows.append((self.out_t[i], self.out_kind[i], values))
        return rows


def checksum(data: bytes, end: int, extra: int) -> int:
    """Return the checksum (CRC-16/MCRF4XX) of a frame up to a place, and of its message's byte."""
    crc = 0xFFFF
    for i in range(1, end + 1):
        mixed = (data[i] if i < end else extra) ^ (crc & 0xFF)
        mixed = (mixed ^ mixed << 4) & 0xFF
        crc = crc >> 8 ^ mixed << 8 ^ mixed << 3 ^ mixed >> 4
    return crc
