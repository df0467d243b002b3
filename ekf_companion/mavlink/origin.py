"""The origin of the autopilot's local frame: which one it has, and ours where it has none.

ODOMETRY counts metres from an origin, and the autopilot takes them from its own. Where the two
differ it is as far off, and returns to a home that is not there.

**ArduPilot** has one origin for good: the first that it is given, or its receiver's place when that
becomes good, some seconds after our first fix. It tells it on request, and refuses another. So it
is asked once a second, ODOMETRY counts from what it says (:class:`OriginTold`), and waits for that
where ours may be fused. One that flies on ODOMETRY from its start is given ours, on the ground.
Its altitude is asked for again and again: ``resetHeightDatum`` moves it, before the take-off.

**PX4** that flies on ODOMETRY alone knows metres from a start and not where that is: it sends no
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

One that has an origin tells it when it changes, and on request: so it is asked, and ours counts
from it. ODOMETRY that may be fused waits for the answer, two seconds at most: from then on the
frame stays, in the next run too. PX4 drops an offset that it has learnt when it ceases to fuse its
receiver, and takes our numbers as they are: with the daemon started 40 m from home, its vehicle
flew on by 43 m.

Sources: PX4, ``Ekf::setLatLonOrigin``, ``setAltOrigin``, ``resetHorizontalPositionTo`` (the offset
``_ev_pos_b_est``), ``controlEvPosFusion`` (resets where the receiver's fusion ends),
``controlEvHeightFusion``, ``controlExternalVisionFusion`` (ends 0.4 s after the last message). PX4
reports an origin when it changes, and a global position for as long as it has one
(``streams/GPS_GLOBAL_ORIGIN.hpp``, ``GLOBAL_POSITION_INT.hpp``). ArduPilot,
``NavEKF3_core::readGpsData``, ``setOrigin``, ``getOriginLLH``, ``resetHeightDatum``,
``GCS_MAVLINK::set_ekf_origin``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from struct import Struct
from typing import Any

from ekf_companion.mavlink.codec import pack
from ekf_companion.mavlink.decision import Hold
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.event import Emit, OriginTold, PeerFound
from ekf_companion.mavlink.frame import Frame
from ekf_companion.mavlink.guard import Guard
from ekf_companion.mavlink.outbox import Outbox
from ekf_companion.mavlink.service import Service
from ekf_companion.mavlink.stamp import SECOND_NS
from ekf_companion.nav.earth import is_place
from ekf_companion.nav.projection import ARDUPILOT

_PLACE = Struct("<3i")
"""Latitude and longitude, degE7, and altitude, mm: GPS_GLOBAL_ORIGIN begins with them."""
_LISTEN_NS = 2 * SECOND_NS
"""So long after it was found, an autopilot that has an origin has shown it."""
_ANSWER_NS = SECOND_NS // 2
"""So long PX4 may need to answer: it takes 0.01 s where nothing is lost."""
_QUIET_NS = SECOND_NS
"""So long after the last ODOMETRY it fuses none."""
_TAKING_NS = SECOND_NS // 2
"""So long it may need to take an origin that it does not confirm."""
_PATIENCE_NS = 5 * SECOND_NS
"""Without an origin of its own for so long after it was given ours, it is given it again."""
_TRIES = 3
_SOON_NS = 30 * SECOND_NS
"""An ArduPilot's receiver is good so long after its start: until then nobody need worry."""
_FARTHEST = 100e3
"""m; beyond 131 km the steps of the numbers in ODOMETRY are more than a centimetre."""
_WAITING = Hold(reason="it waits a moment: the autopilot has no origin yet and is given ours first")
_SOON = Hold(reason="it waits for the origin of the autopilot's local frame, which it counts from")
_UNTOLD = Hold(
    reason="the autopilot has not said where its local frame begins (GPS_GLOBAL_ORIGIN): counted "
    "from another place, ODOMETRY would move the vehicle by the way between them",
    remedy="see that its EKF has an origin: a 3-D fix of its own, or an origin by a ground station",
    text="autopilot tells no origin",
)


class OriginSetter(Service):
    """Learns the autopilot's origin, and gives it ours if it is to fly on it and has none."""

    def __init__(
        self,
        outbox: Outbox,
        guard: Guard,
        emit: Emit,
        ask: Callable[[str], None],
        is_flying: Callable[[], bool] = lambda: False,
    ) -> None:
        """Begin with no autopilot.

        ``ask`` requests a message once; ``is_flying`` returns whether the vehicle is in the air:
        there it is given no origin.
        """
        self.handles = {"GPS_GLOBAL_ORIGIN": self._take, "GLOBAL_POSITION_INT": self._take_position}
        self._outbox, self._guard, self._emit = outbox, guard, emit
        self._ask, self._is_flying = ask, is_flying
        self._ours: tuple[int, int, int] | None = None
        self._peer: PeerFound | None = None
        self.is_fixed = False
        """Whether ODOMETRY counts from where it did before, whatever PX4 tells."""
        self._forget()

    def _forget(self) -> None:
        self.hold = None
        self.theirs: tuple[int, int, int] | None = None
        """As the autopilot has told it: degE7, mm."""
        self._has_one = False
        """Whether the autopilot has shown that it knows one."""
        self._has_height = False
        """Whether it has said, since, how high it takes the vehicle to be."""
        self._tries = 0
        self._found_ns: int | None = None
        self.sent_ns: int | None = None
        """When ODOMETRY was sent last."""
        self.is_settled = False
        """Whether nothing holds ODOMETRY and nothing will, until the autopilot or we count from
        another place: then there is no need to ask before each."""
        self._given_ns: int | None = None
        self._asked_ns: int | None = None

    @property
    def is_shown(self) -> bool:
        """Whether a global position of the autopilot changes nothing here."""
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
        self.is_settled = False

    def on_odometry(self, now_ns: int) -> None:
        """Learn that ODOMETRY is about to be sent; it may have to wait."""
        self.tick(now_ns)
        if self.hold is None:
            self.sent_ns = now_ns

    def tick(self, now_ns: int) -> None:
        """Let ODOMETRY wait where an origin is missing; give it as soon as nothing is fused."""
        if self._found_ns is None:
            self._found_ns = now_ns
        waited_ns = now_ns - self._found_ns
        self._ask_px4(now_ns)
        decision = self._guard.decision
        is_followed = decision.is_streaming and decision.is_fused and bool(decision.parameters)
        if self._peer is None or not is_followed:
            self.hold = None
        elif self._peer.family is Family.ARDUPILOT:
            self._wait_for_theirs(now_ns, waited_ns)
        else:
            self._wait_for_px4(now_ns, waited_ns)
        self.is_settled = self.is_shown and self._is_counted_from()

    def _is_counted_from(self) -> bool:
        """Return whether the autopilot's origin can be counted from, as far as it must be."""
        if self._peer is None or self._peer.family is not Family.ARDUPILOT:
            return self._peer is not None
        return self.theirs is not None and self._has_height and self._distant() is None

    def _wait_for_theirs(self, now_ns: int, waited_ns: int) -> None:
        """Wait until an ArduPilot has told its origin; give it ours where it will find none."""
        if self.theirs is not None and self._has_height:
            self.hold = self._distant()
            return
        is_early = waited_ns < (_LISTEN_NS if self._is_flying() else _SOON_NS)
        self.hold = _SOON if is_early else _UNTOLD
        is_due = self._given_ns is None or now_ns - self._given_ns >= _PATIENCE_NS
        if (
            is_due
            and self.theirs is None
            and self._guard.decision.is_followed_from_start
            and self._ours is not None
            and waited_ns >= _LISTEN_NS
            and not self._is_flying()
        ):
            self._give(now_ns, self._ours[2])

    def _distant(self) -> Hold | None:
        """Return a hold where the autopilot's origin is too far away to count from."""
        if self._ours is None or self.theirs is None:
            return None
        here, there = (
            [math.radians(angle * 1e-7) for angle in one[:2]] for one in (self._ours, self.theirs)
        )
        away = math.hypot(*ARDUPILOT.to_metres(here[0], here[1], there[0], there[1]))
        if away < _FARTHEST:
            return None
        return Hold(
            reason=f"the autopilot's origin is {away * 1e-3:.0f} km away: the numbers of ODOMETRY "
            "have no centimetres there",
            remedy="reboot the autopilot where it is to fly",
            text=f"autopilot's origin is {away * 1e-3:.0f} km off",
        )

    def _ask_px4(self, now_ns: int) -> None:
        """Ask PX4 for its origin, and again where it shows that it has one."""
        if self._peer is None or self._peer.family is not Family.PX4 or self.theirs is not None:
            return
        is_due = self._asked_ns is None
        if self._asked_ns is not None and self._has_one:
            is_due = now_ns - self._asked_ns >= _ANSWER_NS
        if is_due:
            self._asked_ns = now_ns
            self._ask("GPS_GLOBAL_ORIGIN")

    def _wait_for_px4(self, now_ns: int, waited_ns: int) -> None:
        """Wait until PX4 has told its origin, or was given ours."""
        is_px4 = self._peer is not None and self._peer.family is Family.PX4
        may_tell = is_px4 and self.theirs is None and (self._has_one or self._is_flying())
        if may_tell and not self.is_fixed and waited_ns < _LISTEN_NS:
            self.hold = _SOON
            return
        is_wanted = is_px4 and not self._has_one and self._ours is not None
        if not is_wanted or self._is_flying():
            self.hold = None
            return
        given_ns = self._given_ns
        if given_ns is not None and now_ns - given_ns < _PATIENCE_NS:
            self.hold = _WAITING if now_ns - given_ns < _TAKING_NS else None
            return
        self.hold = _WAITING if self._tries < _TRIES else None
        was_fused = self.sent_ns is not None and now_ns - self.sent_ns < _QUIET_NS
        if self.hold is not None and not was_fused and waited_ns >= _LISTEN_NS:
            self._give(now_ns, altitude=0)

    def _give(self, now_ns: int, altitude: int) -> None:
        """Send the autopilot the place of our origin, at an altitude, mm."""
        self._given_ns, self._tries = now_ns, self._tries + 1
        latitude, longitude, _ = self._ours or (0, 0, 0)
        payload = pack(
            "SET_GPS_GLOBAL_ORIGIN",
            target_system=self._peer.system_id if self._peer is not None else 0,
            latitude=latitude,
            longitude=longitude,
            altitude=altitude,
        )
        self._outbox.send("SET_GPS_GLOBAL_ORIGIN", payload, now_ns)

    def _take(self, message: Any, frame: Frame, now_ns: int) -> None:
        told = message.latitude, message.longitude, message.altitude
        if not is_place(1e-7 * told[0], 1e-7 * told[1]):
            return
        self._has_one = True
        if told != self.theirs:
            self.theirs, self.is_settled = told, False
            lat, lon = (math.radians(angle * 1e-7) for angle in told[:2])
            self._emit(OriginTold(lat, lon, told[2] * 1e-3))

    def _take_position(self, message: Any, frame: Frame, now_ns: int) -> None:
        if is_place(1e-7 * message.lat, 1e-7 * message.lon):
            self._has_height = self.theirs is not None
            self._has_one = True
