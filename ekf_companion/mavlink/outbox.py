"""What goes out, in order, and the record of all that went in and out."""

from __future__ import annotations

from collections import Counter

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.frame import encode_frame
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.stamp import quantise

_ODOMETRY = IDS["ODOMETRY"].to_bytes(3, "little")


class Outbox:
    """Frames of ours that wait to be sent."""

    def __init__(self, sender: Sender, *, is_recording: bool = False) -> None:
        self.sent: Counter[str] = Counter()
        """Messages by name."""
        self.withheld: Counter[str] = Counter()
        """Messages by name that are only recorded."""
        self._sender = sender
        self._is_recording = is_recording
        self._out: list[bytes] = []
        self._record: list[tuple[int, bytes]] = []

    @property
    def ids(self) -> tuple[int, int]:
        """Our system and component id."""
        return self._sender.system_id, self._sender.component_id

    @property
    def sequence(self) -> int:
        """Number of the next frame."""
        return self._sender.sequence

    def adopt(self, system_id: int) -> None:
        """Speak as a component of this system from now on."""
        self._sender.system_id = system_id

    def send(self, name: str, payload: bytes, now_ns: int) -> None:
        """Queue a message by its name."""
        frame = self._sender.frame(name, payload, now_ns)
        self.sent[name] += 1
        self._out.append(frame)
        self.record(frame, now_ns)

    def note(self, name: str, payload: bytes, now_ns: int) -> None:
        """Record a message that is not sent; it takes the number of the next that is."""
        self.withheld[name] += 1
        if self._is_recording:
            frame = encode_frame(
                IDS[name],
                payload,
                system_id=self._sender.system_id,
                component_id=self._sender.component_id,
                sequence=self._sender.sequence,
            )
            self.record(frame, now_ns)

    def record(self, raw: bytes, now_ns: int) -> None:
        """Keep what went in or out, if that is wanted."""
        if self._is_recording:
            self._record.append((quantise(now_ns) // 1000, raw))

    def take(self) -> list[bytes]:
        """Give what is to be sent, one frame an item, and forget it."""
        out, self._out = self._out, []
        return out

    def take_record(self) -> list[tuple[int, bytes]]:
        """Give stamp (us) and bytes of all that went in and out, in order, and forget it."""
        record, self._record = self._record, []
        return record


def is_replaceable(frame: bytes) -> bool:
    """Whether a frame of ours is worthless once the next of its kind is there."""
    return frame[7:10] == _ODOMETRY
