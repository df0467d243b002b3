"""ODOMETRY in the local frame of the autopilot that follows it: its origin, its metres, its height.

An autopilot takes the numbers of ODOMETRY for places in its own local frame, and turns them into
latitude and longitude by its own projection. So they count from the origin that it has told.

For PX4 that origin is fixed as soon as it may fuse what is sent: to a filter on ODOMETRY alone a
moved frame is a jump. An offset between the frames PX4 learns only while it fuses its receiver, and
drops when that ends. Its altitude is left alone: it compares heights with its own sensors, and one
that was given an origin tells an altitude of 0.

ArduPilot on its own sensors takes the height from the barometer, above an altitude that its
receiver said once: 4 m off after a cold start. It would climb by what ours is better at the moment
it is switched to ODOMETRY. So heights are sent above its own datum, for as long as it is not ours
anyway.

Sources: ArduPilot, ``Location::get_distance_NE``, ``NavEKF3_core::getLLH``, ``getOriginLLH``,
``selectHeightForFusion``, ``CorrectExtNavForSensorOffset``; PX4, ``MapProjection``,
``ekf2/EKF/aid_sources/external_vision/ev_pos_control.cpp``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from ekf_companion.engine.checkpoint_parts import SentFrame
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav import projection
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.projection import Projection

Place = tuple[float, float, float]
"""Latitude, longitude (rad), altitude above mean sea level (m)."""
PROJECTIONS: Mapping[Family, Projection] = {
    Family.ARDUPILOT: projection.ARDUPILOT,
    Family.PX4: projection.PX4,
}
_SMOOTH_NS = 1_000_000_000
"""The autopilot's height is noisy by centimetres, from one message to the next."""
_AGREED = 0.25
"""m; half of the least jump of ODOMETRY that would be told. Who follows ours is nearer to it."""
_NOISE = 0.05
"""m; of a height, from one message to the next."""
_PROVEN_NS = 2_000_000_000
"""Further away for so long, it does not follow ours: EKF3 takes up a height in half a second."""
_LEVEL = 0.5
"""m/s; who follows ours, half a second late at most, is nearer while it climbs no faster."""


class Height(NamedTuple):
    """Height of the vehicle by the autopilot's own estimate, beside ours at the same time."""

    t_ns: int
    """On the autopilot's clock."""
    theirs: float
    """Altitude, m."""
    ours: float
    """Altitude, m."""
    climb: float
    """m/s, upwards, by ours."""


class AutopilotFrame:
    """The local frame of one autopilot."""

    def __init__(self, family: Family) -> None:
        self._family, self._projection = family, PROJECTIONS.get(family)
        self.told_datum = 0.0
        """As :attr:`datum` was when the origin was told last."""
        self.changes = 0
        """Moves with all that positions are put by."""
        self.forget()

    def forget(self) -> None:
        """Count from our own origin: the autopilot has rebooted."""
        self.origin: Place | None = None
        """The autopilot's own; None: it has told none, and ours counts."""
        self._told: Place | None = None
        """The last that PX4 has told."""
        self._is_fixed = False
        """Whether PX4 may fuse what counts from the present one."""
        self.datum = 0.0
        """What the autopilot's altitudes are above ours, m."""
        self.changes += 1
        self._last_ns: int | None = None
        """Of the last height of the autopilot."""
        self._agreed_ns = 0
        """When its height was last ours."""
        self._kept: float | None = None
        """The datum of a run before, in place of the first comparison."""

    @property
    def sent(self) -> SentFrame:
        """What a restart is to go on with."""
        is_compared = self.origin is not None and self._last_ns is not None
        datum = self._kept if self._kept is not None else self.datum if is_compared else math.nan
        if self._family is not Family.PX4 or self.origin is None:
            return SentFrame(datum=datum)
        return SentFrame(*self.origin[:2])

    def keep(self, sent: SentFrame) -> None:
        """Go on in the frame of a run before, which the autopilot has heights and places in.

        An estimate that begins anew in the air is metres off at first, and to compare heights then
        would keep those for the whole flight.
        """
        if math.isfinite(sent.datum):
            self._kept = sent.datum
            if self.origin is not None and self._last_ns is None:
                self.datum = sent.datum
        if sent.has_origin and self._family is Family.PX4:
            self.origin, self._is_fixed = (sent.lat, sent.lon, 0.0), True
        self.changes += 1

    def set_origin(self, origin: Place) -> None:
        """Count from an origin that the autopilot has told; to PX4 only while it is not fixed."""
        if self._family not in PROJECTIONS:
            return
        if self._family is Family.PX4:
            origin = self._told = (*origin[:2], 0.0)
            if self._is_fixed:
                return
        if self.origin is None:
            self.datum, self._last_ns = self._kept or 0.0, None
        self.origin = origin
        self.changes += 1

    def fix(self, own: Place | None, *, is_fused: bool) -> None:
        """Count for good from where PX4 was sent places from, while it may fuse them.

        ``own`` is the origin of the estimate. While PX4 fuses nothing of ours, places count from
        the origin that it has told last.
        """
        if self._family is not Family.PX4:
            return
        self._is_fixed = is_fused
        origin = (self.origin or own) if is_fused else (self._told or self.origin)
        if origin != self.origin:
            self.origin = origin
            self.changes += 1

    def take_height(self, height: Height, *, may_follow: bool, may_choose: bool) -> None:
        """Learn what the autopilot's altitudes are above ours.

        Args:
            height: Its newest, and ours.
            may_follow: Whether it is sent ours and may fuse it: its height may then be our own.
            may_choose: Whether it may as well be on its own sensors.
        """
        if self._family is not Family.ARDUPILOT or self.origin is None:
            return
        last_ns, self._last_ns = self._last_ns, height.t_ns
        self.changes += 1
        apart = height.theirs - height.ours - self.datum
        if last_ns is None:
            # nothing was sent yet that counts from this origin, unless by a run before
            self.datum += 0.0 if self._kept is not None else apart
            self._kept, self._agreed_ns = None, height.t_ns
            return
        # One that has been found apart is followed until it is as near as its noise
        near = _NOISE if height.t_ns - self._agreed_ns >= _PROVEN_NS else _AGREED
        if not may_follow:
            self._agreed_ns = height.t_ns - _PROVEN_NS
        elif abs(apart) < near or abs(height.climb) > _LEVEL or not may_choose:
            self._agreed_ns = height.t_ns
        if height.t_ns - self._agreed_ns >= _PROVEN_NS:
            dt_ns = min(max(height.t_ns - last_ns, 0), _SMOOTH_NS)
            self.datum += apart * dt_ns / (dt_ns + _SMOOTH_NS)

    def counts_from(self, own: Place) -> Place:
        """Return the place that what is sent counts from, given the origin of the estimate.

        Its altitude is the truth as we know it: the autopilot's less what its datum is above ours;
        PX4's own is not known.
        """
        if self.origin is None:
            return own
        lat, lon, alt = self.origin
        return lat, lon, own[2] if self._family is Family.PX4 else alt - self.datum

    def distance(self, place: Place) -> float:
        """Return how far the autopilot's origin is from a place, in all axes, m; 0 without one."""
        if self.origin is None or self._projection is None:
            return 0.0
        level = self._projection.to_metres(*self.origin[:2], *place[:2])
        return math.hypot(*level, self.counts_from(place)[2] + self.datum - place[2])

    def place(self, own: Place | None) -> tuple[float, ...] | None:
        """Return where positions are put, as :class:`Follower` expresses them.

        ``own`` is the origin of the estimates; None: they stay as they are.
        """
        if self._projection is None or own is None:
            return None
        sphere = self._projection
        scale = LocalFrame(*own).scale
        return sphere.is_azimuthal, sphere.radius, *own, *scale, *self.counts_from(own)
