"""Who sends, and which bytes are not frames."""

from __future__ import annotations

from collections import Counter

from ekf_companion.doctor.evidence import Source
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import JUNK, SIGNED, STX_1, STX_2, Frame
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS
from ekf_companion.mavlink.second_source import POSES

_SOURCES = 64
"""Senders told apart; further ones are not counted."""
_SAMPLE = 2048
_STARTS = (STX_1, STX_2)
_HEARTBEAT = IDS["HEARTBEAT"]
_REQUEST_DATA_STREAM = IDS["REQUEST_DATA_STREAM"]


class Traffic:
    """Counts all frames, whoever sent them, and the bytes between them."""

    def __init__(self) -> None:
        self.first_version = 0
        """Frames of MAVLink 1."""
        self.stream_requests = 0
        """REQUEST_DATA_STREAM, by which a ground station sets rates."""
        self.mismatched: Counter[str] = Counter()
        """Frames that are whole but for their checksum, by message."""
        self.sample = b""
        """The first bytes that were not a frame."""
        self.sources: dict[tuple[int, int], Source] = {}
        """The senders by system and component id, in the order of their first frames."""

    def add(self, frame: Frame) -> None:
        """Count a frame, or keep and examine what is not one."""
        if frame.message_id == JUNK:
            self._add_junk(frame.raw)
            return
        self.first_version += frame.version == 1
        self.stream_requests += frame.message_id == _REQUEST_DATA_STREAM
        ids = frame.system_id, frame.component_id
        if ids not in self.sources and len(self.sources) == _SOURCES:
            return
        source = self.sources.setdefault(ids, Source(system_id=ids[0], component_id=ids[1]))
        source.frames += 1
        source.signed += frame.is_signed
        if frame.message_id in POSES:
            source.poses[frame.message_id] += 1
        if frame.message_id == _HEARTBEAT:
            heartbeat = unpack(frame)
            source.heartbeats += 1
            source.autopilot, source.type = heartbeat.autopilot, heartbeat.type

    def _add_junk(self, raw: bytes) -> None:
        """Keep a sample, and count the frames in it that are whole but for their checksum."""
        if len(self.sample) < _SAMPLE:
            self.sample += raw[: _SAMPLE - len(self.sample)]
        start = 0
        while len(raw) - start >= 12 and raw[start] in _STARTS:
            if raw[start] == STX_2:
                message_id = int.from_bytes(raw[start + 7 : start + 10], "little")
                end = start + raw[start + 1] + (25 if raw[start + 2] & SIGNED else 12)
            else:
                message_id, end = raw[start + 5], start + raw[start + 1] + 8
            if end != len(raw) and (end > len(raw) or raw[end] not in _STARTS):
                return
            if message_id in CRC_EXTRAS:
                self.mismatched[LAYOUTS[message_id].name] += 1
            start = end
