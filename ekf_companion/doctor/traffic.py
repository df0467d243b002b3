"""Who speaks, and what of the bytes is no frame."""

from __future__ import annotations

from collections import Counter

from ekf_companion.doctor.evidence import Source
from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.frame import SIGNED, STX_1, STX_2, Frame
from ekf_companion.mavlink.messages import CRC_EXTRAS, IDS, LAYOUTS

_SOURCES = 64
"""More who speak are not told apart."""
_SAMPLE = 2048
_STARTS = (STX_1, STX_2)
_HEARTBEAT = IDS["HEARTBEAT"]
_REQUEST_DATA_STREAM = IDS["REQUEST_DATA_STREAM"]


class _Speaker:
    """The counts of one source."""

    def __init__(self) -> None:
        self.frames = self.heartbeats = self.type = self.signed = 0
        self.autopilot = 8


class Traffic:
    """All frames, whoever sent them, and the bytes between them."""

    def __init__(self) -> None:
        self.first_version = 0
        """Frames of MAVLink 1."""
        self.stream_requests = 0
        """REQUEST_DATA_STREAM: a ground station sets rates."""
        self.mismatched: Counter[str] = Counter()
        """Frames whole but for their checksum, by message."""
        self.sample = b""
        """The first bytes that were no frame."""
        self._speakers: dict[tuple[int, int], _Speaker] = {}

    def sources(self) -> tuple[Source, ...]:
        """Give who speaks, in the order in which they were heard first."""
        return tuple(
            Source(
                system_id=system_id,
                component_id=component_id,
                frames=speaker.frames,
                heartbeats=speaker.heartbeats,
                autopilot=speaker.autopilot,
                type=speaker.type,
                signed=speaker.signed,
            )
            for (system_id, component_id), speaker in self._speakers.items()
        )

    def take(self, frame: Frame) -> None:
        """Count a frame."""
        self.first_version += frame.version == 1
        self.stream_requests += frame.message_id == _REQUEST_DATA_STREAM
        sender = frame.system_id, frame.component_id
        if sender not in self._speakers and len(self._speakers) == _SOURCES:
            return
        speaker = self._speakers.setdefault(sender, _Speaker())
        speaker.frames += 1
        speaker.signed += frame.version == 2 and bool(frame.raw[2] & SIGNED)
        if frame.message_id == _HEARTBEAT:
            heartbeat = unpack(frame)
            speaker.heartbeats += 1
            speaker.autopilot, speaker.type = heartbeat.autopilot, heartbeat.type

    def take_junk(self, raw: bytes) -> None:
        """Keep a sample; count the frames in it that are whole but for their checksum."""
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
