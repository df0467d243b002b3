"""PX4's EKF2 as a follower: it estimates the offset of ODOMETRY's frame to its own.

With a receiver the offset is learnt at the beginning and at each reset, and the estimate stays
where it is; without one, or when its fusion ends, the offset is dropped, and the estimate jumps to
ODOMETRY. That of heights is learnt unless ODOMETRY is their reference. An origin that comes while
positions of ODOMETRY are fused, and there was none before, leaves it 5300 km off (PX4 1.18).

Sources: ``ev_pos_control.cpp``, ``ev_height_control.cpp``, ``Ekf::setLatLonOrigin``,
``resetHorizontalPositionTo``, ``gps_checks.cpp``, ``mavlink_timesync.cpp``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ekf_companion.nav.arrays import Array
from sim_autopilot.arrival import Timesync
from sim_autopilot.flight import Fix
from sim_autopilot.follower import NEVER, POS, VEL
from sim_autopilot.local_frame import LocalFrame
from sim_autopilot.navigator import Navigator
from sim_autopilot.personality import Kind
from sim_autopilot.tuning import EKF2, Tuning

_HORIZONTAL, _YAW = 1, 8
"""Of EKF2_EV_CTRL; the first of EKF2_GPS_CTRL too."""
_VISION = 3
"""Of EKF2_HGT_REF."""


class Ekf2(Navigator):
    """PX4's filter."""

    kind = Kind.PX4

    def __init__(self, parameters: Mapping[str, float], tuning: Tuning = EKF2) -> None:
        """Begin with nothing fused."""
        super().__init__(tuning, parameters)
        self.timesync = self.arrival = Timesync()
        self._offset_n = np.zeros(3)
        """Of ODOMETRY's frame from its own, m."""
        self._fixed_t = NEVER
        self._had_reference = False

    @property
    def is_external(self) -> bool:  # type: ignore[override]
        """Whether it fuses positions of ODOMETRY."""
        return bool(int(self.parameters.get("EKF2_EV_CTRL", 0)) & _HORIZONTAL)

    @property
    def has_reference(self) -> bool:
        """Whether it fuses positions of its receiver."""
        is_on = int(self.parameters.get("EKF2_GPS_CTRL", 0)) & _HORIZONTAL
        return bool(is_on) and self._horizon_t - self._fixed_t < 2.0

    def set_origin(self, lat: float, lon: float, alt: float) -> bool:
        """Take an origin; the first one while positions are fused ends up elsewhere."""
        is_fused = self._is_fusing and not self.has_reference
        if self.origin is None and is_fused:
            self.misplaced += 1
            lat = lon = 0.0
        origin, was = LocalFrame(kind=self.kind, lat=lat, lon=lon, alt=alt), self.origin
        if was is not None:
            # The place stays, and has other metres
            moved_n = (origin.to_ned(*was.to_geodetic(self.pos_n)) - self.pos_n) * [1.0, 1.0, 0.0]
            self.pos_n = self.pos_n + moved_n
            self.shift_n += moved_n
        self.origin, self.is_origin_new = origin, True
        return True

    def odometry(self, m: Any, stamp: float | None = None) -> None:
        """Fuse an ODOMETRY message by the stamp assigned at its arrival."""
        if self.is_external:
            super().odometry(m, stamp)

    def vision(self, m: Any, stamp: float) -> None:
        """Take a VISION_POSITION_ESTIMATE as an ODOMETRY without a velocity."""
        if self.is_external and self._t is not None:
            self._later(stamp - 0.5 * self.tuning.step, lambda: self._fuse_vision(m, stamp))

    def _fuse_vision(self, m: Any, at: float) -> None:
        self._last_message = at
        self._compare_frames()
        is_moved = self._counter is not None and m.reset_counter != self._counter
        self._counter = m.reset_counter
        pos_n = np.array([m.x, m.y, m.z], dtype=float)
        place = np.full(3, self.tuning.position_floor**2)
        if is_moved or not self._is_fusing or at - self._accepted > self.tuning.retry:
            if self._is_fusing:
                self.events.append((at, "reset by the counter" if is_moved else "reset by time"))
            self._reset(pos_n, place, self.vel_n, np.full(3, 0.1**2), m.yaw)
            self._is_fusing, self._accepted = True, at
            return
        self._fuse_yaw(m.yaw, self.tuning.yaw_floor, self.tuning.yaw_gate)
        z = pos_n - self._offset_n - self.pos_n
        if self._fuse_vector(POS, z, place, self.tuning.position_gate):
            self._accepted = at

    def _compare_frames(self) -> None:
        """Begin anew where the receiver's fusion has begun or ended (``bias_estimator_change``)."""
        had, self._had_reference = self._had_reference, self.has_reference
        if had != self._had_reference:
            self._is_fusing = False
            self._offset_n = self._offset_n * [0.0, 0.0, 1.0]

    def _fuse_odometry(self, m: Any, at: float) -> None:
        self._compare_frames()
        if self._offset_n.any():
            m = _Moved(m, self._offset_n)
        super()._fuse_odometry(m, at)

    def _reset(self, pos_n: Array, place: Array, vel_n: Array, speed: Array, yaw: float) -> None:
        if self.has_reference:
            # The receiver has its place already: the frames differ by so much
            self._offset_n = self._offset_n + pos_n - self.pos_n
            return
        if int(self.parameters.get("EKF2_HGT_REF", _VISION)) != _VISION:
            self._offset_n = self._offset_n + (pos_n - self.pos_n) * [0.0, 0.0, 1.0]
            pos_n = np.array([pos_n[0], pos_n[1], self.pos_n[2]])
        self.shift_n += pos_n - self.pos_n
        super()._reset(pos_n, place, vel_n, speed, yaw)

    # Its own sensors

    def heading(self, t: float, yaw: float, std: float) -> None:
        """Fuse a heading of the compass, which is used until ODOMETRY has one."""
        is_external = self._is_fusing and int(self.parameters.get("EKF2_EV_CTRL", 0)) & _YAW
        if not is_external or self.has_reference:
            super().heading(max(t, self._horizon_t), yaw, std)

    def _begin_at(self, fix: Fix) -> None:
        if not int(self.parameters.get("EKF2_GPS_CTRL", 0)) & _HORIZONTAL:
            return
        frame = LocalFrame(kind=self.kind, lat=fix.lat, lon=fix.lon, alt=fix.alt)
        lat, lon, alt = frame.to_geodetic(-self.pos_n)
        self.origin = LocalFrame(kind=self.kind, lat=lat, lon=lon, alt=alt)
        self.is_origin_new = True

    def _fuse_fix(self, pos_n: Array, vel_n: Array, stds: tuple[float, float, float]) -> None:
        if not int(self.parameters.get("EKF2_GPS_CTRL", 0)) & _HORIZONTAL or not self.is_aligned:
            return
        if not self.has_good_fix:
            return
        horizontal, vertical, velocity = stds
        speed = np.square(np.maximum([velocity, velocity, 1.5 * velocity], 0.3))
        place = np.square(np.maximum([horizontal, horizontal, vertical], [0.5, 0.5, 0.75]))
        self._fuse_vector(VEL, vel_n - self.vel_n, speed, 5.0)
        is_lost = self._horizon_t - self._fixed_t > self.tuning.retry
        if self._fuse_vector(POS, pos_n - self.pos_n, place, self.tuning.position_gate):
            self._fixed_t = self._horizon_t
        elif is_lost:
            self._set([*range(POS.start, POS.stop)], pos_n, place)
            self._fixed_t = self._horizon_t

    def _fuse_baro(self, height: float) -> None:
        is_aided = self._is_fusing or self.has_reference
        if is_aided:
            self._follow_baro(height)
        else:
            self._fuse_baro_height(height - self._baro_offset)
            self._hold()


class _Moved:
    """An ODOMETRY in another frame."""

    def __init__(self, m: Any, offset_n: Array) -> None:
        self._m = m
        self.x, self.y, self.z = (np.array([m.x, m.y, m.z]) - offset_n).tolist()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._m, name)
