"""Bytes to frames and back, MAVLink 1 and 2.

Only a right checksum makes a frame. After a wrong one the search continues at the byte after the
start byte, so that a false start or a damaged frame costs nothing but itself: every good frame
that does not begin inside another frame is found, however the bytes were cut into pieces.

The checksum of a frame of unknown id cannot be tested. Directly behind another frame, while the
framing holds, it is one where a header of the same sender, or of a message that is known, follows
at its end: newer firmware sends messages that no packaged definition has. Anywhere else its bytes
are searched like any others, and are junk.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from dataclasses import dataclass
from struct import Struct
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from fastcrc import crc16

from ekf_companion.mavlink.messages import CRC_EXTRAS, LAYOUTS
from ekf_companion.nav.arrays import Stamps

STX_1 = 0xFE
STX_2 = 0xFD
JUNK, UNKNOWN = -1, -2
"""Message ids of a run of bytes that is no frame, and of a frame whose message is not known. Those
of messages are not negative."""
SIGNED = 0x01
"""The only known incompatibility flag: 13 bytes of signature follow."""
HEADER_SIZE = 12
"""Bytes of a MAVLink 2 frame around its payload: ten before, and the checksum."""
SIGNATURE_SIZE = 13
SENDERS = 16
"""Streams whose unfinished frames are kept; beyond, the one unused for longest is dropped."""
LARGEST_FRAME = HEADER_SIZE + 255 + SIGNATURE_SIZE
"""Bytes."""
LARGEST_REST = LARGEST_FRAME + 9
"""Bytes that may wait for the rest of a frame, or for the header behind one."""

_STARTS = (STX_1, STX_2)
_START = re.compile(rb"[\xfd\xfe]")


def _known_start() -> re.Pattern[bytes]:
    """Return what the first bytes of a frame of known id match."""
    low: dict[bytes, bytes] = {}  # the lowest bytes of ids, by the two higher ones
    for number in sorted(CRC_EXTRAS):
        high = re.escape((number >> 8).to_bytes(2, "little"))
        low[high] = low.get(high, b"") + re.escape(bytes([number & 0xFF]))
    ids = b"|".join(b"[%b]%b" % (each, high) for high, each in low.items())
    first = low[re.escape(bytes(2))]
    return re.compile(rb"\xfd.{6}(?:%b)|\xfe.{4}[%b]" % (ids, first), re.DOTALL)


_KNOWN_START = _known_start()
_header = Struct("<xBBxBBBHB").unpack_from
_crc = crc16.mcrf4xx


class Frame(NamedTuple):
    """One message as it was on the wire, or (id ``JUNK``) bytes that are no message.

    Of a message that is not known (id ``UNKNOWN``) nobody has tested the checksum.
    """

    message_id: int
    system_id: int
    component_id: int
    sequence: int
    payload: bytes
    """As sent: MAVLink 2 omits zeros at the end."""
    raw: bytes
    """The whole frame."""
    version: int
    """1 or 2."""

    @property
    def is_signed(self) -> bool:
        """Whether a signature follows; nobody has verified it."""
        return self.version == 2 and bool(self.raw[2] & SIGNED)


def id_of(raw: bytes) -> int:
    """Return the message id of a whole frame."""
    return raw[5] if raw[0] == STX_1 else int.from_bytes(raw[7:10], "little")


def parsed(message_id: int, raw: bytes) -> Frame:
    """Return a whole frame with a right checksum by its parts."""
    if raw[0] == STX_2:
        return Frame(message_id, raw[5], raw[6], raw[4], raw[10 : 10 + raw[1]], raw, 2)
    return Frame(message_id, raw[3], raw[4], raw[2], raw[6 : 6 + raw[1]], raw, 1)


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
        return parsed(int(self.message_id[i]), self.raw(i))


class Splitter:
    """Cuts streams of bytes into frames: one stream, or one for each of several senders."""

    def __init__(self) -> None:
        self.frames = 0
        self.bad_crc = 0
        """Starts with a known id whose checksum was wrong: damaged frames and false starts."""
        self.incompatible = 0
        """Frames with a right checksum and an unknown incompatibility flag."""
        self.unknown_id = 0
        """Frames whose message is not known."""
        self.junk_bytes = 0
        """Bytes that belonged to no frame."""
        self._rest = b""
        self.is_framed = True
        """Whether a frame should begin where what waits ends."""
        self.sender: Hashable = None
        """Whose stream was cut last."""
        self._others: dict[Hashable, tuple[bytes, bool]] = {}  # of those who do not speak now

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits for the rest of a frame."""
        return not self._rest

    def pass_over(self, count: int) -> None:
        """Count whole frames of known messages that did not come by here, and nothing waits."""
        self.frames += count
        self.is_framed = True

    def feed(self, data: bytes, sender: Hashable = None) -> list[Frame]:
        """Return the frames that the bytes complete, and junk, in order; every byte comes out once.

        At most ``LARGEST_REST`` bytes wait for more from the same sender.
        """
        if sender != self.sender:
            self._switch_to(sender)
        buffer = self._rest + data if self._rest else bytes(data)
        found: list[Frame] = []
        start, junk, end = 0, 0, len(buffer)  # junk: first byte not handed out yet
        while start < end:
            stx = buffer[start]
            if stx == STX_2:
                if end - start < 10:
                    break
                size, flags, number, system, component, low, high = _header(buffer, start)
                message_id, header = low | high << 16, 10
                total = size + 25 if flags & SIGNED else size + 12
            elif stx == STX_1:
                if end - start < 6:
                    break
                size, number, system, component, message_id = buffer[start + 1 : start + 6]
                flags, header, total = 0, 6, size + 8
            else:
                match = _START.search(buffer, start)
                start = match.start() if match else end
                self.is_framed = False
                continue

            tail = start + header + size
            if (extra := CRC_EXTRAS.get(message_id)) is None:
                if self.is_framed and flags <= SIGNED:
                    if (
                        is_whole := _is_followed(buffer, start + total, (system, component))
                    ) is None:
                        break
                    if is_whole:
                        raw, version = buffer[start : start + total], 2 if stx == STX_2 else 1
                        ids = UNKNOWN, system, component, number
                        found.append(Frame(*ids, buffer[start + header : tail], raw, version))
                        self.unknown_id += 1
                        start = junk = start + total
                        continue
                self.is_framed = False
                # Only a frame of known id matters now, or one whose id is not here yet
                match = _KNOWN_START.search(buffer, start + 1)
                start = max(start + 1, min(match.start() if match else end, end - 9))
                continue
            if end - start < total:
                break
            if _crc(buffer[start + 1 : tail] + extra) != buffer[tail] | buffer[tail + 1] << 8:
                self.bad_crc += 1
                self.is_framed = False
                start += 1
                continue
            if flags > SIGNED:
                self.incompatible += 1
                start += total
                continue

            if junk < start:
                found.append(self._junk(buffer, junk, start))
            raw = buffer[start : start + total]
            payload, version = raw[header : header + size], 2 if stx == STX_2 else 1
            found.append(Frame(message_id, system, component, number, payload, raw, version))
            self.frames += 1
            start = junk = start + total
            self.is_framed = True

        if junk < start:
            found.append(self._junk(buffer, junk, start))
        self._rest = buffer[start:]
        return found

    def _switch_to(self, sender: Hashable) -> None:
        """Set one sender's stream aside and resume another's, so that neither cuts the other."""
        if self._rest or not self.is_framed:
            self._others[self.sender] = (self._rest, self.is_framed)
        self.sender = sender
        self._rest, self.is_framed = self._others.pop(sender, (b"", True))
        if len(self._others) > SENDERS:
            rest, _ = self._others.pop(next(iter(self._others)))
            self.junk_bytes += len(rest)

    def _junk(self, buffer: bytes, start: int, end: int) -> Frame:
        self.junk_bytes += end - start
        return Frame(JUNK, 0, 0, 0, b"", buffer[start:end], 0)


def _is_followed(buffer: bytes, place: int, sender: tuple[int, int]) -> bool | None:
    """Whether a header of the same sender, or of a known message, is at a place; None: not yet."""
    if place >= len(buffer):
        return None
    stx, rest = buffer[place], len(buffer) - place
    if stx == STX_2:
        if rest < 10:
            return None
        size, flags, _, system, component, low, high = _header(buffer, place)
        message_id = low | high << 16
    elif stx == STX_1:
        if rest < 6:
            return None
        size, _, system, component, message_id = buffer[place + 1 : place + 6]
        flags = 0
    else:
        return False
    is_known = message_id in CRC_EXTRAS and size <= LAYOUTS[message_id].size
    return flags <= SIGNED and (is_known or (system, component) == sender)
