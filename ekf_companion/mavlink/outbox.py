"""Messages of ours on their way out, in order, and the record of all that went in and out."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.stamp import quantise


class Message(NamedTuple):
    """A message of ours, not framed yet."""

    name: str
    payload: bytes
    is_replaceable: bool = False
    """Whether it is worthless once the next of its kind is there."""


class Outgoing(NamedTuple):
    """A frame of ours that waits to be sent."""

    data: bytes
    is_replaceable: bool
    """As of its message."""
    t_ns: int | None = None
    """Of a message about an estimate: when that was true, autopilot clock, ns."""


class Outbox:
    """Frames of ours that wait to be sent."""

    def __init__(self, sender: Sender, *, is_recording: bool = False) -> None:
        self.sent: Counter[str] = Counter()
        """Messages by name."""
        self.withheld: Counter[str] = Counter()
        """Messages by name that are only recorded."""
        self.ids = sender.system_id, sender.component_id
        """Our system and component id."""
        self._sender = sender
        self._is_recording = is_recording
        self._out: list[Outgoing] = []
        self._record: list[tuple[int, bytes]] = []

    @property
    def sequence(self) -> int:
        """Number of the next frame."""
        return self._sender.sequence

    def adopt(self, system_id: int) -> None:
        """Speak as a component of this system from now on."""
        self._sender.system_id = system_id
        self.ids = system_id, self._sender.component_id

    def send(
        self,
        name: str,
        payload: bytes,
        now_ns: int,
        *,
        is_replaceable: bool = False,
        t_ns: int | None = None,
    ) -> None:
        """Frame a message and queue it; ``t_ns`` is when the estimate that it is of was true."""
        frame = self._sender.frame(name, payload, now_ns)
        self.sent[name] += 1
        self._out.append(Outgoing(frame, is_replaceable, t_ns))
        if self._is_recording:
            self.record(frame, now_ns)

    def withhold(self, name: str, payload: bytes, now_ns: int) -> None:
        """Only record a message, with the sequence number of the next that is sent."""
        self.withheld[name] += 1
        if self._is_recording:
            self.record(self._sender.frame(name, payload, is_draft=True), now_ns)

    def record(self, raw: bytes, now_ns: int, link: int = 0) -> None:
        """Record what went in or out by a link, if anybody wants a record."""
        if self._is_recording:
            self._record.append((quantise(now_ns) // 1000 + link, raw))

    def take(self) -> list[Outgoing]:
        """Return the frames that wait to be sent, and forget them."""
        out, self._out = self._out, []
        return out

    def take_record(self) -> list[tuple[int, bytes]]:
        """Return stamp (us) and bytes of all that went in and out, in order, and forget it.

        Each item is a whole frame. Empty unless recording.
        """
        record, self._record = self._record, []
        return record
