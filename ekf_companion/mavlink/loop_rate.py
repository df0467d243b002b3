"""The rate of an ArduPilot's main loop, read before the streams are requested that it limits."""

from __future__ import annotations

from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.decode.parameter import value_of
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.stamp import SECOND_NS

NAME = "SCHED_LOOP_RATE"
_TRIES = 3
_PERIOD_NS = SECOND_NS * 2 // 5
"""Without an answer to three, 1.2 s later, the streams are requested as if it were fast."""
_SHARE_US = 800
"""A stream of one per ms needs a loop of no more us: a stream takes 0.8 of the loop's rate."""
_SURE = 40.0
"""Hz, which the slowest loop, 50 Hz, takes."""


class LoopRate:
    """Asks for the loop's rate, and knows by it the largest rate of a stream.

    Source: ArduPilot, ``GCS_MAVLINK::cap_message_interval`` in ``GCS_Common.cpp``: what is faster
    is denied, and the pilot is told so each time.
    """

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self.begin(PeerFound(0, 0, Family.UNKNOWN))

    def begin(self, peer: PeerFound) -> None:
        """Ask anew: a reboot may have changed it."""
        self._peer = peer
        self.value: float | None = None
        """Hz; None: not known."""
        self._tries = self._next_ns = 0

    def may_request(self, rate: float, now_ns: int) -> bool:
        """Return whether a stream may be requested: the loop's rate is known, or not needed."""
        if self._peer.family is not Family.ARDUPILOT or rate <= _SURE or self.value is not None:
            return True
        if now_ns < self._next_ns:
            return False
        if self._tries == _TRIES:
            return True
        self._tries, self._next_ns = self._tries + 1, now_ns + _PERIOD_NS
        name = NAME.encode()
        payload = pack("PARAM_REQUEST_READ", **self._peer.target, param_id=name, param_index=-1)
        self._outbox.send("PARAM_REQUEST_READ", payload, now_ns)
        return False

    def take(self, message: Any, frame: Frame) -> bool:
        """Take a PARAM_VALUE; return whether it told the rate for the first time."""
        if message.param_id.decode("ascii", "replace") != NAME:
            return False
        value = value_of(message, frame, self._peer.family)
        if value is None or not 1.0 <= value <= 1e6:
            return False
        is_first, self.value = self.value is None, value
        return is_first

    def limit(self, rate: float) -> float:
        """Return a rate, or the largest that is granted, Hz."""
        if self.value is None or rate <= 0.0:
            return rate
        period_us = int(1e6 / self.value)
        return min(rate, 1e3 / max(period_us // _SHARE_US, 1))
