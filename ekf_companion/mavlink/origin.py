"""The origin of the autopilot's local frame, where the autopilot has no receiver of its own to ask.

A PX4 that flies on ODOMETRY alone knows metres from a start and not where that is: it sends no
global position, and flies no mission and no return. It takes the place of that start by
SET_GPS_GLOBAL_ORIGIN, in flight too, and keeps its metres.

It is given once: each origin is a reset of its position, even the same again. And its altitude is
zero: PX4 1.17 adds the altitude of an origin to its own, but goes on to compare that with the
height that ODOMETRY states, and takes the difference for an error at the next moved counter. In its
simulator, 489 m above the sea, the height so jumped by 489 m in flight, and the vehicle climbed
until it was stopped.

Source: PX4, ``Ekf::setLatLonOrigin``, ``setAltOrigin``, ``controlEvHeightFusion``: an origin that
is given while it already navigates in a local frame becomes that frame's. PX4 reports an origin
when it changes, and a global position for as long as it has one (``streams/GPS_GLOBAL_ORIGIN.hpp``,
``GLOBAL_POSITION_INT.hpp``).
"""

from __future__ import annotations

from struct import Struct
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_PLACE = Struct("<2i")
"""Latitude and longitude, degE7: GPS_GLOBAL_ORIGIN begins with them."""
_PATIENCE_NS = 5 * SECOND_NS
"""Without an origin of its own for so long it is given ours, and again after as long."""


class OriginSetter(Service):
    """Sends the autopilot the origin of our frame, if it flies on our estimate and has none."""

    def __init__(self, outbox: Outbox, guard: Guard) -> None:
        self.handles = {"GPS_GLOBAL_ORIGIN": self._take, "GLOBAL_POSITION_INT": self._take}
        self.sent = 0
        """How often it was given."""
        self._outbox, self._guard = outbox, guard
        self._ours: tuple[int, int] | None = None
        self._peer: PeerFound | None = None
        self._has_one = False
        """Whether the autopilot has shown that it knows one."""
        self._since_ns: int | None = None

    def begin(self, peer: PeerFound) -> None:
        """Wait for the origin of an autopilot that was found, or has rebooted."""
        self._peer, self._since_ns, self._has_one = peer, None, False

    def end(self) -> None:
        """Forget the autopilot."""
        self._peer = None

    def note(self, payload: bytes) -> None:
        """Learn the origin of our frame from the GPS_GLOBAL_ORIGIN that tells it."""
        self._ours = _PLACE.unpack(payload[: _PLACE.size].ljust(_PLACE.size, b"\0"))

    def tick(self, now_ns: int) -> None:
        """Send the origin where it has been missing for long."""
        if self._has_one:
            return
        peer, ours = self._peer, self._ours
        is_followed = self._guard.decision.is_streaming and self._guard.decision.is_fused
        if peer is None or ours is None or peer.family is not Family.PX4 or not is_followed:
            self._since_ns = None
            return
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns < _PATIENCE_NS:
            return
        self._since_ns = now_ns
        self.sent += 1
        payload = pack(
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=peer.system_id,
            latitude=ours[0],
            longitude=ours[1],
            altitude=0,
        )
        self._outbox.send("SET_GPS_GLOBAL_ORIGIN", payload, now_ns)

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        self._has_one = True
