"""The frames of a piece of a recording as columns: their headers, and the fields of a few messages.

Only messages that come often are decoded here: their layout is known, and most of them change
nothing but the measurements. What is made of each message is decided once for a session.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.mavlink.frame import SIGNED, STX_2, Frame
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS
from ekf_companion.mavlink.session import Session
from ekf_companion.nav.arrays import Stamps

BYTES, ANYBODYS, AUTOPILOTS, READ, PASSED = range(-1, 4)
INERTIAL, ATTITUDE, TIMESYNC, FIX, POSITION = range(4, 9)
"""What is made of a message. Its bytes go to the session; the session takes it from anybody, or
from the autopilot only; the decoder reads it; nobody does; or it is one of those decoded here."""
LATEST_US = 1 << 52
"""Stamps beyond are left to the session: in ns they would not fit."""
_NUMBERS = ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "xmag", "ymag", "zmag")
_POSITION = ("lat", "lon", "alt", "vx", "vy", "vz", "hdg")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frames:
    """Whole frames with right checksums, in order; arrays of one length."""

    data: bytes
    """The piece of the recording that they lie in."""
    stamp_us: Stamps
    """The recorder's clock."""
    start: Stamps
    """Place in the data."""
    end: Stamps
    """Place behind the frame."""
    message_id: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.start)

    def raw(self, i: int) -> bytes:
        """Return the bytes of a frame."""
        return self.data[self.start[i] : self.end[i]]

    def frame(self, i: int) -> Frame:
        """Return a frame as a session takes it."""
        raw, number = self.raw(i), int(self.message_id[i])
        if raw[0] == STX_2:
            return Frame(number, raw[5], raw[6], raw[4], raw[10 : 10 + raw[1]], raw, 2)
        return Frame(number, raw[3], raw[4], raw[2], raw[6 : 6 + raw[1]], raw, 1)


def kinds_of(session: Session) -> npt.NDArray[np.int8]:
    """Return what is made of each message, by its id."""
    kinds = np.full(max(CRC_EXTRAS) + 1, BYTES, dtype=np.int8)
    kinds[list(CRC_EXTRAS)] = PASSED
    kinds[list(session.decoder.readers)] = READ
    kinds[IDS["HIGHRES_IMU"]] = INERTIAL
    kinds[IDS["ATTITUDE"]] = ATTITUDE
    kinds[list(session.peer_routes)] = AUTOPILOTS
    kinds[IDS["TIMESYNC"]] = TIMESYNC
    kinds[IDS["GPS_RAW_INT"]] = FIX
    kinds[IDS["GLOBAL_POSITION_INT"]] = POSITION
    kinds[list(session.all_routes)] = ANYBODYS
    kinds[IDS["SETUP_SIGNING"]] = BYTES
    return kinds


class Columns:
    """Frames as columns; ``row`` is where each stands among those of its message."""

    def __init__(self, frames: Frames, kinds: npt.NDArray[np.int8]) -> None:
        """Read the headers and the messages; ``kinds`` is of :func:`kinds_of`."""
        self._raw = np.frombuffer(frames.data, dtype=np.uint8)
        start, message_id = frames.start, frames.message_id
        is_second = self._raw[start] == STX_2
        head = start + np.where(is_second, 4, 2)
        self.sequence, self.system, self.component = (self._raw[head + i] for i in range(3))
        is_odd = (message_id >= len(kinds)) | (is_second & (self._raw[start + 2] > SIGNED))
        is_odd |= (frames.stamp_us > LATEST_US) | (frames.stamp_us < 0)
        self.kind = np.where(is_odd, np.int8(BYTES), kinds[np.where(is_odd, 0, message_id)])
        self.message_id = np.where(is_odd, 0, message_id).astype(np.int64)
        self.stamp_us = np.ascontiguousarray(frames.stamp_us)
        self.size = np.ascontiguousarray(frames.end - start)
        self.row = np.zeros(len(frames), dtype=np.int64)
        self._payload = start + np.where(is_second, 10, 6)
        self._length = self._raw[start + 1]

        table = self._table("HIGHRES_IMU", INERTIAL)
        self.t_us = table["time_usec"].astype(np.int64)
        self.samples = np.empty((len(table), 10))
        """rad/s, m/s^2, gauss, hPa."""
        for index, name in enumerate((*_NUMBERS, "abs_pressure")):
            self.samples[:, index] = table[name]
        self.updated = table["fields_updated"].astype(np.int64)
        self.instance = table["id"].astype(np.int64)
        table = self._table("ATTITUDE", ATTITUDE)
        self.boot_ms = table["time_boot_ms"].astype(np.int64)
        self.yaw = table["yaw"].astype(np.float64)
        table = self._table("GLOBAL_POSITION_INT", POSITION)
        self.position_ms = table["time_boot_ms"].astype(np.int64)
        self.positions = np.empty((len(table), len(_POSITION)))
        """degE7, mm, cm/s, cdeg."""
        for index, name in enumerate(_POSITION):
            self.positions[:, index] = table[name]
        table = self._table("TIMESYNC", TIMESYNC)
        self.is_answer = (table["tc1"] != 0).astype(np.uint8)
        self.target_system = np.ascontiguousarray(table["target_system"])
        self.target_component = np.ascontiguousarray(table["target_component"])

    def _table(self, name: str, kind: int) -> npt.NDArray[Any]:
        """Return the payloads of a message as a table, zeros where they are cut short."""
        chosen = np.flatnonzero(self.kind == kind)
        self.row[chosen] = np.arange(len(chosen))
        dtype = LAYOUTS[IDS[name]].dtype
        rows = np.zeros((len(chosen), dtype.itemsize), dtype=np.uint8)
        length, payload = self._length[chosen], self._payload[chosen]
        for size in np.flatnonzero(np.bincount(length)).tolist():
            same = np.flatnonzero(length == size)
            if used := min(size, dtype.itemsize):
                windows = np.lib.stride_tricks.sliding_window_view(self._raw, used)
                rows[same, :used] = windows[payload[same]]
        return rows.view(dtype)[:, 0]
