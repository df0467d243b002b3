"""The frames that come most often, from bytes to rows (compiled): live one, of a log many.

Nearly all frames are inertial samples that plainly follow the last, attitudes, positions, and
messages that nobody reads. Those are read here, to the bit as the session and its decoder read
them. A frame that may change anybody's mind (a heartbeat, a command, a parameter, a stamp that
leaps, another sensor) is left to the session.

Few objects are touched: a processor that is idle between two samples has to fetch each of them
anew, and that takes longer than what is done with them.
"""

from __future__ import annotations

from collections.abc import Hashable

import cython
import numpy as np
import numpy.typing as npt
from cython.cimports.ekf_companion.mavlink.payload import fill
from fastcrc import crc16

from ekf_companion.mavlink.autopilot_estimate import KEPT
from ekf_companion.mavlink.decode.decoder import HELD
from ekf_companion.mavlink.frame import HEADER_SIZE, SIGNED, STX_2, Frame, Frames, parsed
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS
from ekf_companion.mavlink.payload import PayloadReader
from ekf_companion.mavlink.sequence import Sequence
from ekf_companion.mavlink.session import Session
from ekf_companion.mavlink.stamp import Stamp
from ekf_companion.mavlink.timebase import LAST_US
from ekf_companion.nav.arrays import Column
from ekf_companion.nav.buffer import EventBuffer
from ekf_companion.nav.measurements import Row

_BYTES, _ANYBODYS, _AUTOPILOTS, _READ, _PASSED = range(-1, 4)
_INERTIAL, _ATTITUDE, _TIMESYNC, _FIX, _POSITION = range(4, 9)
"""What is made of a message. Its bytes go to the session; the session takes it from anybody, or
from the autopilot only; the decoder reads it; nobody does; or it is one of those read here."""
HEARTBEAT_ID = cython.declare(cython.int, IDS["HEARTBEAT"])
ODOMETRY_ID = cython.declare(cython.int, IDS["ODOMETRY"])


def kinds_of(session: Session) -> npt.NDArray[np.int8]:
    """Return what is made of each message, by its id."""
    kinds = np.full(max(CRC_EXTRAS) + 1, _BYTES, dtype=np.int8)
    kinds[list(CRC_EXTRAS)] = _PASSED
    kinds[list(session.decoder.readers)] = _READ
    kinds[list(session.peer_routes)] = _AUTOPILOTS
    kinds[list(KEPT)] = np.maximum(kinds[list(KEPT)], _READ)  # what is asked of nobody may wait
    own = {"HIGHRES_IMU": _INERTIAL, "ATTITUDE": _ATTITUDE, "TIMESYNC": _TIMESYNC}
    own |= {"GPS_RAW_INT": _FIX, "GLOBAL_POSITION_INT": _POSITION}
    kinds[[IDS[name] for name in own]] = list(own.values())
    kinds[list(session.all_routes)] = _ANYBODYS
    kinds[IDS["SETUP_SIGNING"]] = _BYTES
    return kinds


class Reader(PayloadReader):
    """Reads frames for one session, as far as it can."""

    peer_system: int
    peer_component: int

    def __init__(self, session: Session) -> None:
        """Begin without frames."""
        super().__init__(session)
        self.numbers: Sequence = session.sequence
        self.kinds: Column[np.int8] = kinds_of(session)
        self.changes = -1
        self.is_others: Column[np.int8] = np.zeros(len(self.kinds), dtype=np.int8)
        np.asarray(self.is_others)[list(session.decoder.external.readers)] = 1
        self.received = np.zeros(len(self.kinds), dtype=np.int64)

    # A log: many frames, as many rows as the buffer takes

    def open(self, frames: Frames) -> None:
        """Take the next frames; all before have been read."""
        self.close()
        self.frames = frames
        self.start: Column[np.int64] = frames.start
        self.end: Column[np.int64] = frames.end
        self.message_id: Column[np.int32] = frames.message_id
        self.stamp_us: Column[np.int64] = frames.stamp_us

    def close(self) -> None:
        """Leave all that is known to the session."""
        counts = np.asarray(self.received)
        for number in np.flatnonzero(counts).tolist():
            self.session.received[number] += int(counts[number])
        counts[:] = 0

    def is_whole(self, i: int) -> bool:
        """Return whether the session may take a frame as a whole, and needs not see its bytes."""
        self._look_at(self.frames.data)
        return self._kind_of(i) != _BYTES and self.session.splitter.is_empty

    def read(self, i: int, buffer: EventBuffer) -> int:
        """Read frames from one on; return the first that is left to the session, or their number.

        It also ends where the buffer is full.
        """
        self._look_up()
        if not self.is_open or self.session.options.is_recording:
            return i
        self._look_at(self.frames.data)
        self._use(buffer)
        end = self._read_on(i)
        buffer.size = self.n
        if end > i:
            self.session.past.keep_run(self.frames, i, end)
        return end

    def _read_on(self, i: int) -> int:
        """Do the work of :meth:`read`."""
        count = size = heard = echoes = 0
        while i < self.start.shape[0] and self.n < self.limit:
            kind, number, place = self._kind_of(i), self.message_id[i], self.start[i]
            head = place + 5 if self.data[place] == STX_2 else place + 3
            if kind == _BYTES:
                break
            if self._is_from(head, self.our_system, self.our_component):
                if number == HEARTBEAT_ID or (number == ODOMETRY_ID and self.is_yielding):
                    break
                echoes += 1
            elif kind == _ANYBODYS:
                break
            elif self._is_from(head, self.peer_system, self.peer_component):
                if not self._read_frame(kind, place, self.end[i], number, self.stamp_us[i] * 1000):
                    break
                self.received[number] += 1
                heard += 1
            elif self.is_others[number]:
                break
            count += 1
            size += self.end[i] - place
            i += 1
        if count:
            self.session.pass_over(count, size, heard, echoes)
        return i

    def _kind_of(self, i: int) -> int:
        """Return what is made of a frame."""
        number, place, stamp = self.message_id[i], self.start[i], self.stamp_us[i]
        if number >= self.kinds.shape[0] or not 0 <= stamp <= LAST_US:
            return _BYTES
        if self.data[place] == STX_2 and self.data[place + 2] > SIGNED:
            return _BYTES
        return self.kinds[number]

    def _look_at(self, piece: bytes) -> None:
        """Read the frames that lie in these bytes."""
        self.piece: bytes = piece
        self.data: cython.p_const_uchar = piece

    def _is_from(self, place: int, system: int, component: int) -> bool:
        """Return whether these ids stand at a place."""
        return self.data[place] == system and self.data[place + 1] == component

    # Live: one frame, and its rows

    def read_datagram(self, data: bytes, now_ns: Stamp, sender: Hashable) -> list[Row] | None:
        """Return the rows of a datagram that was read now; None: it is left to the session.

        What it says is counted, and recorded, as the session would.
        """
        number = self._message_of(data)
        if number < 0 or data[2] != 0:
            return None
        kind = self.kinds[number]
        if kind <= _READ or kind == _TIMESYNC:
            return None
        if self.session.changes != self.changes:
            self._look_up()
        if not self.is_open or sender != self.sender:
            return None
        size = len(data)
        self._look_at(data)
        if not self._is_from(5, self.peer_system, self.peer_component):
            return None
        if (
            crc16.mcrf4xx(data[1 : size - 2] + CRC_EXTRAS[number])
            != data[size - 2] | data[size - 1] << 8
        ):
            return None
        if self.buffer is not self.own:
            self._use(self.own)
        self.n = 0
        if not self._read_frame(kind, 0, size, number, now_ns):
            return None
        parts = data[5], data[6], data[4], data[10 : size - 2]
        self.session.note_frame(Frame(number, *parts, data, 2), now_ns)
        return self._take_rows()

    def may_wait(self, data: bytes, due_ns: Stamp) -> bool:
        """Return whether bytes may as well be received a moment later, with those after them.

        They may if they are one frame that says what the autopilot measures or estimates, which
        nobody answers; a sample, if its stamp is before a time at which something is due.
        """
        number = self._message_of(data)
        if number < 0:
            return False
        kind = self.kinds[number]
        if kind == _INERTIAL:
            stamp_us = int.from_bytes(data[10:18], "little")
            return stamp_us * 1000 < due_ns
        return bool(kind >= _READ and kind != _TIMESYNC)

    def _message_of(self, data: bytes) -> int:
        """Return the id of the message of a datagram of one frame; -1: it is none that is known."""
        size = len(data)
        if size < HEADER_SIZE or data[0] != STX_2 or data[1] + HEADER_SIZE != size:
            return -1
        number: int = data[7] | data[8] << 8 | data[9] << 16
        return number if number < self.kinds.shape[0] else -1

    # Both

    def _look_up(self) -> None:
        """Look up where the session stands, after it has done something else."""
        session = self.session
        self.changes, self.sender = session.changes, session.autopilot_sender
        self.clock, self.is_idle = self.context.clock, session.timesync.is_idle
        self.is_yielding: bool = session.clash.is_yielding
        peer, ours = session.discovery.peer, session.outbox.ids
        self.peer_system, self.peer_component = peer or (-1, -1)
        self.our_system, self.our_component = ours
        self.is_open: bool = (
            peer is not None
            and peer != ours
            and session.splitter.is_empty
            and session.splitter.sender == self.sender
            and not session.guard.is_waiting
            and not session.admission.is_selective
            and session.on_frame is None
        )

    def _read_frame(self, kind: int, place: int, end: int, number: int, now_ns: Stamp) -> bool:
        """Read a frame of the autopilot that arrived now; return whether it could be read here."""
        is_second = self.data[place] == STX_2
        if kind <= _READ:
            return False
        if kind != _PASSED:
            begin = place + (10 if is_second else 6)
            fill(self.payload, self.data, begin, self.data[place + 1])
        if kind == _INERTIAL:
            is_read = self._read_inertial()
        elif kind == _ATTITUDE:
            is_read = self._read_attitude(now_ns)
        elif kind == _TIMESYNC:
            is_read = self._read_timesync()
        elif kind == _POSITION:
            is_read = self._read_position(self.piece[place:end], now_ns)
        elif kind == _FIX:
            is_read = self._read_fix()
        else:
            is_read = True
        if not is_read:
            return False
        self.numbers.count(self.data[place + (4 if is_second else 2)], now_ns)
        # A frame behind the clock waits with those held; the next that is not frees them
        if not self.clock.is_behind:
            self._free()
        elif len(self.decoder.held) < HELD:
            self.decoder.held.append((parsed(number, self.piece[place:end]), []))
        return True
