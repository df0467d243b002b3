"""Telemetry logs (.tlog): stamped MAVLink frames, found in damaged files too.

A record is 8 bytes of microseconds, big-endian, by the recorder's clock (the low two bits are the
link's number; they are kept), and one frame, MAVLink 1 or 2. A frame is valid where its checksum is
right. Where none is, the search goes on byte by byte for a stamp near the last good one, followed
by a frame with a right checksum. The checksum of a frame of an unknown id cannot be tested: it is
valid where another record follows at its end.

:mod:`ekf_companion.mavlink` decodes the frames of a .tlog into events, as it does live ones. This
module finds the frames, and reads columns of their fields.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from struct import Struct

import numpy as np
import numpy.typing as npt
from fastcrc import crc16

from ekf_companion.errors import LogError
from ekf_companion.logs.source import read_bytes
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS
from ekf_companion.nav.arrays import Stamps

Column = npt.NDArray[np.void]

KIND = "telemetry log (.tlog)"
STAMP, ORDER, COMPONENT = "@stamp_us", "@order", "@component"
"""Columns before a message's own: the recorder's stamp, the record's number, the component."""
DAY_US = 86_400_000_000
PLAUSIBLE_US = 3 * DAY_US
"""Largest plausible difference of a stamp from the last good one, us."""
_FAMILIES = {3: "ardupilot", 12: "px4"}
"""MAV_AUTOPILOT."""
_NO_AUTOPILOT = 8
_STAMP = Struct(">Q")
_START = re.compile(rb"[\xfd\xfe]")
_crc = crc16.mcrf4xx


@dataclass(frozen=True, slots=True)
class Autopilot:
    """The source of the telemetry, by the first heartbeat of an autopilot."""

    system_id: int
    component_id: int
    family: str
    """``px4``, ``ardupilot`` or ``unknown``."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Tlog:
    """The records of a log; each array has one element per record, in file order."""

    data: bytes
    """The whole file."""
    stamp_us: Stamps
    """The recorder's clock, as recorded."""
    place: Stamps
    """Position of the frame in the file, bytes."""
    size: Stamps
    """Bytes of the frame."""
    message_id: Stamps
    damaged: int
    """Number of runs of bytes that are no record."""
    autopilot: Autopilot | None
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.place)

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Yield each record's stamp (us, the recorder's clock) and raw frame, in file order."""
        arrays = (self.stamp_us, self.place, self.size)
        for stamp, place, size in zip(*(one.tolist() for one in arrays), strict=True):
            yield stamp, self.data[place : place + size]

    def columns(
        self, names: Sequence[str], system_id: int, component_id: int | None = None
    ) -> dict[str, Column]:
        """Return the fields of messages as one table each, in file order; skip absent messages.

        The names are in capitals; without a component id, messages of all components count.

        Returns:
            Tables by name: ``STAMP``, ``ORDER``, ``COMPONENT`` and the message's own fields in
            wire order and wire units. Fields that a short MAVLink payload omits are 0.
        """
        raw = np.frombuffer(self.data, dtype=np.uint8)
        tables: dict[str, Column] = {}
        for name in names:
            order = np.flatnonzero(self.message_id == IDS[name])
            place = self.place[order]
            second = raw[place] == 0xFD  # MAVLink 2
            system, component = (
                raw[place + np.where(second, later, sooner)] for later, sooner in ((5, 3), (6, 4))
            )
            ours = system == system_id
            if component_id is not None:
                ours &= component == component_id
            if ours.any():
                order, place, second = order[ours], place[ours], second[ours]
                payload = place + np.where(second, 10, 6)
                table = _payloads(raw, payload, raw[place + 1], IDS[name])
                table[STAMP], table[ORDER] = self.stamp_us[order], order
                table[COMPONENT] = component[ours]
                tables[name] = table
        return tables


def _payloads(
    raw: npt.NDArray[np.uint8], place: Stamps, size: npt.NDArray[np.uint8], message_id: int
) -> Column:
    """Return payloads as a table of one message, zeros where they are cut short."""
    dtype = LAYOUTS[message_id].dtype
    rows = np.zeros((len(place), dtype.itemsize), dtype=np.uint8)
    for length in np.unique(size):
        same = np.flatnonzero(size == length)
        used = min(int(length), dtype.itemsize)  # newer definitions add fields at the end
        if used:
            windows = np.lib.stride_tricks.sliding_window_view(raw, used)
            rows[same, :used] = windows[place[same]]
    wire = rows.view(dtype)[:, 0]
    head = [(STAMP, "<i8"), (ORDER, "<i8"), (COMPONENT, "u1")]
    table = np.zeros(len(place), dtype=np.dtype([*head, *dtype.descr]))
    for name in dtype.names or ():
        table[name] = wire[name]
    return table


def read(path: Path) -> Tlog:
    """Find the records of a log.

    Raises:
        LogError: The file is missing, empty, or holds no MAVLink frame.
    """
    data = read_bytes(path, KIND)
    records, damaged = _find_records(data)
    if not records:
        raise LogError(
            f"{path}: holds no stamped MAVLink frame, so it is not a {KIND}; "
            "a raw stream of MAVLink without stamps cannot be read"
        )
    stamp_us, place, size, message_id = np.frombuffer(records, dtype=np.int64).reshape(-1, 4).T
    return Tlog(
        data=data,
        stamp_us=stamp_us,
        place=place,
        size=size,
        message_id=message_id,
        damaged=damaged,
        autopilot=_find_autopilot(data, place[message_id == IDS["HEARTBEAT"]]),
        notes=tuple(_left_out(data, place - 8, place + size)),
    )


def _left_out(data: bytes, starts: Stamps, ends: Stamps) -> Iterator[str]:
    """Describe the bytes that are in no record."""
    gaps = np.diff(np.concatenate([[0], np.column_stack([starts, ends]).ravel()]))[::2]
    if runs := np.count_nonzero(gaps):
        yield f"{runs} runs of damaged bytes, {int(gaps.sum())} bytes in all, were left out"
    if rest := data[int(ends[-1]) :]:
        what = "no whole record" if any(rest) else "zeros"
        yield f"the last {len(rest)} bytes are {what}: the recording was cut off there"


def _find_records(data: bytes) -> tuple[array[int], int]:
    """Return stamp, position, size, message id of each record, and the number of bad runs."""
    records = array("q")
    damaged = 0
    last: int | None = None
    start = 0  # of the record: its stamp
    while start + 16 <= len(data):  # the shortest frame has 8 bytes
        place = start + 8
        message_id, tail, after = _frame(data, place)
        (stamp,) = _STAMP.unpack_from(data, start)
        if tail == 0 or after > len(data):
            good = False
        elif message_id in CRC_EXTRAS:
            good = _is_whole(data, place, tail, message_id)
            good = good and _is_plausible(data, stamp, after, last)
        else:
            # No checksum can be tested: damage must not swallow the records after it
            good = _continues(data, after, stamp) and _resume(data, start + 1, last) >= after
        if good:
            last = stamp & 0x7FFF_FFFF_FFFF_FFFF
            records.extend((last, place, after - place, message_id))
            start = after
        else:
            damaged += 1
            start = _resume(data, start + 1, last)
    return records, damaged


def _frame(data: bytes, place: int) -> tuple[int, int, int]:
    """Return the message id of a frame, the ends of its payload and its own; zeros if it is none.

    It may end beyond the data.
    """
    if data[place] == 0xFE:
        tail = place + 6 + data[place + 1]
        return data[place + 5], tail, tail + 2
    if data[place] == 0xFD and place + 12 <= len(data):
        tail = place + 10 + data[place + 1]
        message_id = data[place + 7] | data[place + 8] << 8 | data[place + 9] << 16
        return message_id, tail, tail + (15 if data[place + 2] & 1 else 2)
    return 0, 0, 0


def _is_whole(data: bytes, place: int, tail: int, message_id: int) -> bool:
    """Return whether the checksum behind the payload is right, of a known message."""
    expected = _crc(data[place + 1 : tail] + CRC_EXTRAS[message_id])
    return bool(expected == data[tail] | data[tail + 1] << 8)


def _continues(data: bytes, start: int, stamp: int) -> bool:
    """Return whether a record with a stamp near this one begins here, or the file ends."""
    if start == len(data):
        return True
    if start + 16 > len(data) or data[start + 8] not in (0xFD, 0xFE):
        return False
    return abs(int(_STAMP.unpack_from(data, start)[0]) - stamp) < PLAUSIBLE_US


def _is_plausible(data: bytes, stamp: int, after: int, last: int | None) -> bool:
    """Return whether a stamp is near the last one, or else the record after it is near it."""
    if last is None or abs(stamp - last) < PLAUSIBLE_US:
        return True
    return _continues(data, after, stamp)


def _resume(data: bytes, start: int, last: int | None) -> int:
    """Return the next position of a plausible stamp and a frame with a right checksum."""
    for match in _START.finditer(data, start + 8):
        place = match.start()
        if place + 8 > len(data):
            break
        message_id, tail, after = _frame(data, place)
        if tail == 0 or tail + 2 > len(data) or message_id not in CRC_EXTRAS:
            continue
        if _is_whole(data, place, tail, message_id):
            (stamp,) = _STAMP.unpack_from(data, place - 8)
            if _is_plausible(data, stamp, after, last):
                return place - 8
    return len(data)


def _find_autopilot(data: bytes, heartbeats: Stamps) -> Autopilot | None:
    for place in heartbeats.tolist():
        ids, payload = (place + 5, place + 10) if data[place] == 0xFD else (place + 3, place + 6)
        # Behind custom_mode and type; 0 if the payload is cut short
        autopilot = data[payload + 5] if data[place + 1] > 5 else 0
        if autopilot != _NO_AUTOPILOT:
            return Autopilot(data[ids], data[ids + 1], _FAMILIES.get(autopilot, "unknown"))
    return None
