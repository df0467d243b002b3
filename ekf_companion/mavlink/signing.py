"""MAVLink 2 signatures: a frame is from somebody who knows the secret, and is new.

A signature is the first 48 bits of SHA-256 over secret, frame, link id and time. The time counts
10 us since 2015 and must grow from frame to frame of one stream (system, component, link id), so
that a frame that was recorded cannot be replayed.

Our own time is that of the clock that is passed in, but never behind what was sent, received or
stored: so a board without a real-time clock catches up with the first signed frame that it
receives.

Source: MAVLink guide, "Message Signing" (mavlink.io/en/guide/message_signing.html).
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from struct import Struct

from ekf_companion.mavlink.frame import SIGNATURE_SIZE, Frame

KEY_SIZE = 32
"""Bytes of a secret."""
EPOCH_NS = 1_420_070_400 * 1_000_000_000
"""2015-01-01 00:00 UTC, unix time, ns."""
UNIT_NS = 10_000
SECOND = 1_000_000_000 // UNIT_NS
LARGEST = (1 << 48) - 1
"""Reached in 2104."""
FIRST_CONTACT = 60 * SECOND
"""How far behind ours the time of a new stream may be."""
STREAMS = 64
"""How many streams are remembered."""
MARGIN = 2 * SECOND
"""Added to the stored time at a start: it is stored once a second, and a disk is slow."""

WRONG = "signature is wrong"
REPLAYED = "signed frame is not newer than the last"
OLD = "signed frame is over a minute old"
CROWDED = "too many signed streams"

_MAGIC = b"EKFSIGN1"
_HEAD = Struct("<8sQH")
_STREAM = Struct("<BBBQ")
_TAG_SIZE = 16


class Signing:
    """Signs our frames and verifies those of others, with one secret."""

    def __init__(self, key: bytes, link_id: int = 0) -> None:
        """Begin with a secret of 32 bytes, and the id of our link."""
        if len(key) != KEY_SIZE:
            raise ValueError(f"a key has {KEY_SIZE} bytes")
        # The secret is kept as the state of its hash, which cannot be printed
        self._secret = hashlib.sha256(key)
        self._link_id = bytes([link_id])
        self._time = 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self.verified = 0
        """Frames whose signature was right."""

    def sign(self, frame: bytes, now_ns: int) -> bytes:
        """Return a whole frame, whose flags announce a signature, with that signature.

        ``now_ns`` is unix time, here and below.
        """
        self._time = min(max(self._time + 1, time_of(now_ns)), LARGEST)
        data = frame + self._link_id + self._time.to_bytes(6, "little")
        return data + self._digest(data)[:6]

    def verify(self, frame: Frame, now_ns: int) -> str:
        """Return why a signed frame is refused; empty if it is accepted, and its time noted."""
        raw = frame.raw
        if not hmac.compare_digest(self._digest(raw[:-6])[:6], raw[-6:]):
            return WRONG
        time = int.from_bytes(raw[-12:-6], "little")
        stream = (frame.system_id, frame.component_id, raw[-SIGNATURE_SIZE])
        last = self._streams.get(stream)
        if last is None:
            ours = max(self._time, time_of(now_ns))
            if time + FIRST_CONTACT < ours:
                return OLD
            if len(self._streams) == STREAMS and not self._forget(ours):
                return CROWDED
        elif time <= last:
            return REPLAYED
        self._streams[stream] = time
        self._time = max(self._time, time)
        self.verified += 1
        return ""

    def state(self) -> bytes:
        """Return what a restart must know: our time, and that of each stream; not the secret."""
        data = _HEAD.pack(_MAGIC, self._time, len(self._streams)) + b"".join(
            _STREAM.pack(*stream, time) for stream, time in self._streams.items()
        )
        return data + self._digest(data)[:_TAG_SIZE]

    def restore(self, state: bytes) -> bool:
        """Go on from a state; return False, changing nothing, if it is damaged or another's.

        Of several states the latest time of each stream counts.
        """
        data, tag = state[:-_TAG_SIZE], state[-_TAG_SIZE:]
        if not hmac.compare_digest(self._digest(data)[:_TAG_SIZE], tag):
            return False
        try:
            magic, time, count = _HEAD.unpack_from(data)
            streams = list(_STREAM.iter_unpack(data[_HEAD.size :]))
        except struct.error:
            return False
        if magic != _MAGIC or count != len(streams):
            return False
        self._time = max(self._time, min(time + MARGIN, LARGEST))
        for system, component, link, last in streams:
            stream = system, component, link
            if stream in self._streams or len(self._streams) < STREAMS:
                self._streams[stream] = max(last, self._streams.get(stream, 0))
        return True

    def _digest(self, data: bytes) -> bytes:
        digest = self._secret.copy()
        digest.update(data)
        return digest.digest()

    def _forget(self, ours: int) -> bool:
        """Forget the oldest stream if its frames would be refused anyway; return whether it was."""
        oldest = min(self._streams, key=lambda stream: self._streams[stream])
        if self._streams[oldest] + FIRST_CONTACT >= ours:
            return False
        del self._streams[oldest]
        return True


def time_of(now_ns: int) -> int:
    """Return unix time, ns, in the units of a signature; before 2015: 0."""
    return max((now_ns - EPOCH_NS) // UNIT_NS, 0)
