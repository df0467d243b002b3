"""The origin of the autopilot's local frame, where the autopilot has no receiver of its own to ask.

A PX4 that flies on ODOMETRY alone knows metres from a start and not where that is: it sends no
global position, and flies no mission and no return. It takes the place of that start by
SET_GPS_GLOBAL_ORIGIN.

That comes before the first ODOMETRY, and on the ground. PX4 1.18 that gets an origin while it fuses
positions of ours counts the way from latitude and longitude 0 to the new place as the offset of
ours: in its simulator it was 5300 km off, four seconds after the daemon's start. So ODOMETRY waits
until the origin is given, and where some was sent already, until PX4 has ceased to fuse it.

It is given once: each origin is a reset of its position, even the same again. And its altitude is
zero: PX4 1.17 adds the altitude of an origin to its own, but goes on to compare that with the
height that ODOMETRY states, and takes the difference for an error at the next moved counter. In its
simulator, 489 m above the sea, the height so jumped by 489 m in flight, and the vehicle climbed
until it was stopped.

Source: PX4, ``Ekf::setLatLonOrigin``, ``setAltOrigin``, ``resetHorizontalPositionTo`` (the offset
``_ev_pos_b_est``), ``controlEvHeightFusion``, ``controlExternalVisionFusion`` (ends 0.4 s after the
last message). PX4 reports an origin when it changes, and a global position for as long as it has
one (``streams/GPS_GLOBAL_ORIGIN.hpp``, ``GLOBAL_POSITION_INT.hpp``).
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS

_PLACE = Struct("<2i")
"""Latitude and longitude, degE7: GPS_GLOBAL_ORIGIN begins with them."""
_LISTEN_NS = 2 * SECOND_NS
"""So long after it was found, an autopilot that has an origin has shown it."""
_QUIET_NS = SECOND_NS
"""So long after the last ODOMETRY it fuses none."""
_TAKING_NS = SECOND_NS // 2
"""So long it may need to take an origin that it does not confirm."""
_PATIENCE_NS = 5 * SECOND_NS
"""Without an origin of its own for so long after it was given ours, it is given it again."""
_TRIES = 3
_WAITING = Hold(reason="it waits a moment: the autopilot has no origin yet and is given ours first")


class OriginSetter(Service):
    """Gives the autopilot the origin of our frame, if it is to fly on our estimate and has none."""

    def __init__(
        self, outbox: Outbox, guard: Guard, is_flying: Callable[[], bool] = lambda: False
    ) -> None:
        """``is_flying`` returns whether the vehicle is in the air: there it is given none."""
        self.handles = {"GPS_GLOBAL_ORIGIN": self._take, "GLOBAL_POSITION_INT": self._take}
        self._outbox, self._guard, self._is_flying = outbox, guard, is_flying
        self._ours: tuple[int, int] | None = None
        self._peer: PeerFound | None = None
        self._forget()

    def _forget(self) -> None:
        self.hold = None
        self._has_one = False
        """Whether the autopilot has shown that it knows one."""
        self._tries = 0
        self._found_ns: int | None = None
        self._last_ns: int | None = None
        """When ODOMETRY was sent last."""
        self._given_ns: int | None = None

    @property
    def is_shown(self) -> bool:
        """Whether the autopilot has shown that it knows one: to hear it again changes nothing."""
        return self._has_one and self.hold is None

    def begin(self, peer: PeerFound) -> None:
        """Wait for the origin of an autopilot that was found, or has rebooted."""
        self._forget()
        self._peer = peer

    def end(self) -> None:
        """Forget the autopilot."""
        self._forget()
        self._peer = None

    def note(self, payload: bytes) -> None:
        """Learn the origin of our frame from the GPS_GLOBAL_ORIGIN that tells it."""
        self._ours = _PLACE.unpack(payload[: _PLACE.size].ljust(_PLACE.size, b"\0"))

    def on_odometry(self, now_ns: int) -> None:
        """Learn that ODOMETRY is about to be sent; it may have to wait."""
        self.tick(now_ns)
        if self.hold is None:
            self._last_ns = now_ns

    def tick(self, now_ns: int) -> None:
        """Let ODOMETRY wait where an origin is missing; give it as soon as nothing is fused."""
        if self._found_ns is None:
            self._found_ns = now_ns
        if not self._is_wanted():
            self.hold = None
            return
        given_ns = self._given_ns
        if given_ns is not None and now_ns - given_ns < _PATIENCE_NS:
            self.hold = _WAITING if now_ns - given_ns < _TAKING_NS else None
            return
        self.hold = _WAITING if self._tries < _TRIES else None
        was_fused = self._last_ns is not None and now_ns - self._last_ns < _QUIET_NS
        if self.hold is not None and not was_fused and now_ns - self._found_ns >= _LISTEN_NS:
            self._give(now_ns)

    def _is_wanted(self) -> bool:
        """Return whether the autopilot says that it fuses ours, and has shown no origin."""
        peer, decision = self._peer, self._guard.decision
        if peer is None or peer.family is not Family.PX4 or self._has_one or self._ours is None:
            return False
        is_followed = decision.is_streaming and decision.is_fused and bool(decision.parameters)
        return is_followed and not self._is_flying()

    def _give(self, now_ns: int) -> None:
        self._given_ns, self._tries = now_ns, self._tries + 1
        latitude, longitude = self._ours or (0, 0)
        payload = pack(
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=self._peer.system_id if self._peer is not None else 0,
            latitude=latitude,
            longitude=longitude,
            altitude=0,
        )
        self._outbox.send("SET_GPS_GLOBAL_ORIGIN", payload, now_ns)

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        self._has_one = True
        self.hold = None
