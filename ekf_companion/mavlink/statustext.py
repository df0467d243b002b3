"""Texts for the pilot: STATUSTEXT, each sent once, in chunks where it is long."""

from __future__ import annotations

from collections import deque
from enum import IntEnum
from typing import NamedTuple

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

CHUNK = 50
"""Bytes of a message's text."""
LARGEST = 4 * CHUNK
"""Bytes of a text; the rest is in the log."""
_MORE = b"..."
_WAITING = 16
"""Texts that may wait; beyond, the least severe is dropped, and of those the oldest."""
_PACE_NS = SECOND_NS // 5
"""Between any two texts."""
_LARGEST_ID = 65535


class Severity(IntEnum):
    """MAV_SEVERITY, as in RFC 5424."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


class _Text(NamedTuple):
    severity: Severity
    text: str


class StatusText(Service):
    """Sends texts to everybody on the link, and none while no autopilot is heard."""

    def __init__(self, outbox: Outbox) -> None:
        self.dropped = 0
        """Texts that were not sent because too many waited."""
        self._outbox = outbox
        self._is_heard = False
        self._waiting: deque[_Text] = deque()
        self._sent_ns: dict[_Text, int] = {}
        self._next_ns = 0
        self._id = 0

    def begin(self, peer: PeerFound) -> None:
        """Send from now on."""
        self._is_heard = True

    def end(self) -> None:
        """Drop what waits: nobody hears it, and later it would be old."""
        self._is_heard = False
        self._waiting.clear()

    def send(self, severity: Severity, text: str) -> None:
        """Queue a text; one that waits already goes last, so that the last text heard is true."""
        if not self._is_heard:
            return
        queued = _Text(severity, text)
        if queued in self._waiting:
            self._waiting.remove(queued)
        self._waiting.append(queued)
        if len(self._waiting) > _WAITING:
            self._waiting.remove(max(self._waiting, key=lambda text: text.severity))
            self.dropped += 1

    def tick(self, now_ns: int) -> None:
        """Send the first in line; a text that was sent in the last second waits."""
        if not self._waiting or now_ns < self._next_ns:
            return
        self._sent_ns = {
            text: at_ns for text, at_ns in self._sent_ns.items() if now_ns - at_ns < SECOND_NS
        }
        if (text := self._waiting[0]) not in self._sent_ns:
            self._waiting.popleft()
            self._sent_ns[text] = now_ns
            self._next_ns = now_ns + _PACE_NS
            self._send_chunks(text, now_ns)

    def _send_chunks(self, text: _Text, now_ns: int) -> None:
        pieces = chunks(text.text)
        text_id = 0
        if len(pieces) > 1:
            text_id = self._id = self._id % _LARGEST_ID + 1
        for number, piece in enumerate(pieces):
            payload = pack(
                "STATUSTEXT", severity=text.severity, text=piece, id=text_id, chunk_seq=number
            )
            self._outbox.send("STATUSTEXT", payload, now_ns)


def chunks(text: str) -> list[bytes]:
    """Return a text cut into chunks of 50 bytes, where there is a space, and through no character.

    A zero byte ends a text, so a chunk that is cut short is filled with spaces, and a last chunk
    without room for a zero is followed by an empty one.
    """
    rest = text.replace("\0", "").encode()
    if len(rest) > LARGEST:
        rest = _cut(rest, LARGEST - len(_MORE)).rstrip() + _MORE
    pieces: list[bytes] = []
    while len(rest) > CHUNK or (pieces and len(rest) == CHUNK):
        piece = _cut(rest, CHUNK)
        rest = rest[len(piece) :]
        pieces.append(piece.ljust(CHUNK))
    return [*pieces, rest]


def _cut(text: bytes, size: int) -> bytes:
    """Return the beginning of a text, up to a space if there is one in its second half."""
    piece = text[:size].decode(errors="ignore").encode()
    end = piece.rfind(b" ") + 1
    is_whole = len(piece) == len(text) or text[len(piece) : len(piece) + 1] == b" "
    return piece if is_whole or end <= size // 2 else piece[:end]
