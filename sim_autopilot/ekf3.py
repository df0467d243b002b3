"""ArduPilot's EKF3 as a follower: which source set fuses what, and what a switch resets.

One lane of it. With EK3_SRC_OPTIONS at its default, velocities of ODOMETRY are fused whichever set
is in use, if any set names them. A switch resets position, height and yaw to the new source.

Sources: ``NavEKF3_core::setAidingMode``, ``SelectVelPosFusion``, ``selectHeightForFusion``,
``calcFiltBaroOffset``, ``readGpsData``, ``setOrigin``, ``setLatLng``, ``writeExtNavData``,
``getLLH``;
``AP_VisualOdom_MAV``; ``GCS_MAVLINK::handle_odometry``, ``handle_command_set_ekf_source_set``; 4.7.
The horizon, the noises and the gates are of ``AP_NavEKF3.cpp``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.arrival import LeastDelay
from sim_autopilot.flight import Fix
from sim_autopilot.follower import NEVER, POS, VEL
from sim_autopilot.local_frame import LocalFrame
from sim_autopilot.navigator import INFO, WARNING, Navigator
from sim_autopilot.personality import Kind
from sim_autopilot.tuning import EKF3, Tuning

RECEIVER, EXTERNAL, BARO, COMPASS = 3, 6, 1, 1
"""Values of EK3_SRCn_*."""
_ALL_VELOCITIES = 1
"""Of EK3_SRC_OPTIONS."""
_NE, _D, _VNE, _VD = [6, 7], [8], [3, 4], [5]
_DEAD_RECKONING = 1.0
"""s without an accepted position until it is said to reckon (``deadReckonDeclare_ms``)."""
_FRESH = 0.5
"""Age, s, beyond which an ODOMETRY is no longer a source of height."""
_VELOCITY_RETRY, _STOP = 10.0, 15.0
"""s: without an accepted velocity it is reset; without any aid it holds its position
(``tiltDriftTimeMax_ms``)."""
_POSITION_RETRY = 7.0
"""s, where no velocity aids either (``posRetryTimeNoVel_ms``)."""
_HEIGHT_GATE = 5.0
"""EK3_HGT_I_GATE."""
_HEIGHT_RETRY = 10.0
"""s (``hgtRetryTimeMode0_ms``)."""
_LEAST_YAW = math.radians(5.0)
_GPS = (0.3, 0.5, 0.5, 10.0)
"""Sigmas of velocity, velocity down and position at least, m/s and m (EK3_VELNE_M_NSE,
EK3_VELD_M_NSE, EK3_POSNE_M_NSE); and the position's largest."""
_FLAGS_HELD, _FLAGS_AIDED = 1 | 4 | 32 | 128, 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512
"""EKF_STATUS_REPORT.flags."""


class Ekf3(Navigator):
    """ArduPilot's filter."""

    kind = Kind.ARDUPILOT

    def __init__(self, parameters: Mapping[str, float], tuning: Tuning = EKF3) -> None:
        """Begin with source set 1."""
        super().__init__(tuning, parameters)
        self.arrival = LeastDelay()
        self.set = 1
        """Number of the source set in use."""
        self.is_aided = False
        """Whether it knows a position (``AID_ABSOLUTE``)."""
        self.ratios = dict.fromkeys(("velocity", "position", "height", "yaw"), 0.0)
        """Innovations over their gates; above 1: refused."""
        self._passed = dict.fromkeys(self.ratios, NEVER)
        """When one was last accepted, s."""
        self._position_source, self._height_source, self._yaw_source = 0, BARO, 0
        self._is_switched = False
        self._last_stamp = self._external_t = NEVER
        self._last_counter = 0
        self._is_moved = False
        """Whether the counter has moved since the last message that was taken."""

    @property
    def is_external(self) -> bool:  # type: ignore[override]
        """Whether it flies on ODOMETRY."""
        return self._wants("POSXY") == EXTERNAL

    def _wants(self, part: str) -> int:
        return int(self.parameters.get(f"EK3_SRC{self.set}_{part}", 0))

    def _is_fused(self, part: str, source: int) -> bool:
        """Whether a velocity of a source is fused."""
        if self._wants(part) == source:
            return True
        is_any = int(self.parameters.get("EK3_SRC_OPTIONS", 1)) & _ALL_VELOCITIES
        names = (f"EK3_SRC{number}_{part}" for number in (1, 2, 3))
        return bool(is_any) and any(self.parameters.get(name, 0) == source for name in names)

    def select(self, number: int) -> bool:
        """Switch to a set of sources, 1 to 3."""
        if number not in (1, 2, 3):
            return False
        self.set = number
        return True

    def set_origin(self, lat: float, lon: float, alt: float) -> bool:
        """Take an origin if it has none."""
        if self.origin is not None:
            return False
        self.origin = LocalFrame(kind=self.kind, lat=lat, lon=lon, alt=alt)
        self.is_origin_new = True
        self.send_text(INFO, "EKF3 IMU0 origin set")
        return True

    def take_position(self, lat: float, lon: float, std: float) -> bool:
        """Move to a position from outside, while nothing has shown one for a second.

        Without a sigma, or with a small one, the receiver's floor counts.
        """
        is_late = self._horizon_t - self._passed["position"] >= _DEAD_RECKONING
        if not is_late or not self.is_aided or self.origin is None:
            return False
        variance = max(0.0 if math.isnan(std) else std, _GPS[2]) ** 2
        self._set(_NE, self.origin.to_ned(lat, lon, self.origin.alt)[:2], variance)
        self.events.append((self._horizon_t, "moved from outside"))
        return True

    # Its own sensors

    def heading(self, t: float, yaw: float, std: float) -> None:
        """Take a heading of the compass."""
        if self._wants("YAW") == COMPASS or not self.is_aligned:
            self._later(max(t, self._horizon_t), lambda: self._fuse_heading(COMPASS, yaw, std))

    def _begin_at(self, fix: Fix) -> None:
        # The altitude of its start, whatever height it has by now
        self.set_origin(fix.lat, fix.lon, fix.alt + float(self.pos_n[2]))

    def _fuse_fix(self, pos_n: Array, vel_n: Array, stds: tuple[float, float, float]) -> None:
        if self._wants("POSXY") != RECEIVER:
            return
        least, least_down, least_place, most = _GPS
        place = float(np.clip(stds[0], least_place, most)) ** 2
        speed = np.square([max(stds[2], least), max(stds[2], least), max(stds[2], least_down)])
        if not self.is_aided:
            if not self.has_good_fix or not self.is_aligned:
                return
            self._begin("EKF3 IMU0 is using GPS", pos_n, place, vel_n, speed)
        if self._is_fused("VELXY", RECEIVER):
            self._fuse_velocity(vel_n, speed)
        self._fuse_place(pos_n, place, RECEIVER, is_reset=False)

    def _fuse_baro(self, height: float) -> None:
        now = self._horizon_t
        wanted = self._wants("POSZ")
        if wanted == BARO or (wanted == EXTERNAL and now - self._external_t > _FRESH):
            self._fuse_height(BARO, height - self._baro_offset, 2.0**2)
        elif self._height_source != BARO:
            self._follow_baro(height)
        else:
            self._fuse_height(BARO, height - self._baro_offset, 2.0**2)
        if not self.is_aided:
            self._hold()

    # ODOMETRY and its like

    def odometry(self, m: Any, stamp: float | None = None) -> None:
        """Fuse an ODOMETRY message by the stamp assigned at its arrival."""
        c = m.pose_covariance
        place = 0.0 if math.isnan(c[0]) else math.sqrt(max(c[0] + c[6] + c[11], 0.0))
        turn = 0.0 if math.isnan(c[0]) else math.sqrt(max(c[15] + c[18] + c[20], 0.0))
        q_nb = np.array(m.q, dtype=float)
        vel_n = so3.rotate(q_nb, np.array([m.vx, m.vy, m.vz], dtype=float))
        pos_n = np.array([m.x, m.y, m.z], dtype=float)
        self._external(m, stamp, pos_n, so3.to_euler(q_nb)[2], vel_n, (place, turn), m.quality)

    def vision(self, m: Any, stamp: float) -> None:
        """Take a VISION_POSITION_ESTIMATE: no velocity, no quality."""
        c = m.covariance
        place = 0.0 if math.isnan(c[0]) else math.sqrt(max(c[0] + c[6] + c[11], 0.0))
        turn = 0.0 if math.isnan(c[0]) else math.sqrt(max(c[15] + c[18] + c[20], 0.0))
        self._external(m, stamp, np.array([m.x, m.y, m.z]), m.yaw, None, (place, turn), 0)

    def _external(
        self,
        m: Any,
        stamp: float | None,
        pos_n: Array,
        yaw: float,
        vel_n: Array | None,
        stds: tuple[float, float],
        quality: int,
    ) -> None:
        values, own = self.parameters, self.tuning
        t = m.time_usec * 1e-6 if stamp is None else stamp
        least = values.get("VISO_QUAL_MIN", own.quality_min)
        if quality < least:
            return
        # A moved counter is kept, though the message itself comes too soon after the last
        self._is_moved |= m.reset_counter != self._last_counter
        self._last_counter = m.reset_counter
        if 0.0 <= t - self._last_stamp < own.least_interval or self._t is None:
            return
        self._last_stamp = t
        is_reset, self._is_moved = self._is_moved, False
        place = float(np.clip(stds[0], values.get("VISO_POS_M_NSE", own.position_floor), 100.0))
        turn = float(np.clip(stds[1], values.get("VISO_YAW_M_NSE", own.yaw_floor), 1.5))
        # Nothing is older than the horizon: what came too late counts as if it were of there
        at = t - values.get("VISO_DELAY_MS", own.delay * 1e3) * 1e-3 - 0.5 * own.step
        at = max(at, self._horizon_t)
        turn = max(turn, _LEAST_YAW)
        self._external_t = self._t
        self._later(at, lambda: self._fuse_external(pos_n, yaw, vel_n, place, turn, is_reset))

    def _fuse_external(
        self,
        pos_n: Array,
        yaw: float,
        vel_n: Array | None,
        place: float,
        turn: float,
        is_reset: bool,
    ) -> None:
        speed = np.full(3, self.parameters.get("VISO_VEL_M_NSE", self.tuning.velocity_floor) ** 2)
        is_source = self.is_external
        if self._wants("YAW") == EXTERNAL:
            self._fuse_heading(EXTERNAL, yaw, turn)
        if is_source and not self.is_aided:
            first = np.zeros(3) if vel_n is None else vel_n
            self._begin("EKF3 IMU0 is using external nav data", pos_n, place**2, first, speed)
            said = ",".join(f"{value:3.1f}" for value in pos_n)
            self.send_text(INFO, f"EKF3 IMU0 initial pos NED = {said} (m)")
            self._set(_D, pos_n[2:], place**2)
            self._height_source = EXTERNAL if self._wants("POSZ") == EXTERNAL else BARO
        if vel_n is not None and self.is_aided and self._is_fused("VELXY", EXTERNAL):
            self._fuse_velocity(vel_n, speed)
        if not is_source:
            return
        if self._wants("POSZ") == EXTERNAL:
            variance = float(np.clip(place, 0.1, 10.0)) ** 2
            if is_reset and self._height_source == EXTERNAL:
                self._set(_D, pos_n[2:], variance)
            self._fuse_height(EXTERNAL, -float(pos_n[2]), variance)
        self._fuse_place(pos_n, place**2, EXTERNAL, is_reset=is_reset)

    # What is fused, refused, reset

    def _advance(self, one: Any) -> None:
        super()._advance(one)
        if not self.is_aided:
            return
        last = max(self._passed["position"], self._passed["velocity"])
        if one.t - last > _STOP:
            self.is_aided, self._held_n = False, self.pos_n.copy()
            self.send_text(WARNING, "EKF3 IMU0 stopped aiding")
            self.events.append((one.t, "stopped aiding"))

    def _begin(self, text: str, pos_n: Array, place: float, vel_n: Array, speed: Array) -> None:
        self.send_text(INFO, text)
        self.events.append((self._horizon_t, text))
        self.is_aided, self._is_switched = True, False
        self._position_source = self._wants("POSXY")
        self._set(_NE, pos_n[:2], place)
        self._set([*_VNE, *_VD], vel_n, speed)
        for name in ("position", "velocity"):
            self._passed[name] = self._horizon_t

    def _fuse_velocity(self, vel_n: Array, variance: Array) -> None:
        rows, now = [*_VNE, *_VD], self._horizon_t
        z = vel_n - self.vel_n
        ratio = self._fuse_rows(rows, z, variance, self.tuning.velocity_gate)
        self.ratios["velocity"] = math.sqrt(ratio)
        if ratio <= 1.0:
            self._passed["velocity"] = now
        elif now - self._passed["velocity"] > _VELOCITY_RETRY:
            self._set(rows, vel_n, variance)
            self._passed["velocity"] = now
            self.events.append((now, "velocity reset by time"))

    def _fuse_place(self, pos_n: Array, variance: float, source: int, *, is_reset: bool) -> None:
        now = self._horizon_t
        # A switch counts until it is used up by the new source's first position
        self._is_switched |= source != self._position_source
        self._position_source = source
        if is_reset or self._is_switched:
            why = "reset by the switch" if self._is_switched else "reset by the counter"
            self._is_switched = False
            self.events.append((now, why))
            self._set(_NE, pos_n[:2], variance)
            self._passed["position"] = now
            return
        z = pos_n[:2] - self.pos_n[:2]
        ratio = self._fuse_rows(_NE, z, variance, self.tuning.position_gate)
        self.ratios["position"] = math.sqrt(ratio)
        speeds = now - self._passed["velocity"] < _POSITION_RETRY
        retry = self.tuning.retry if speeds else _POSITION_RETRY
        if ratio <= 1.0:
            self._passed["position"] = now
        elif now - self._passed["position"] > retry:
            self._set(_NE, pos_n[:2], variance)
            self._passed["position"] = now
            self.events.append((now, "position reset by time"))

    def _fuse_height(self, source: int, height: float, variance: float) -> None:
        now, down = self._horizon_t, np.array([-height])
        if source != self._height_source:
            self._height_source = source
            self._set(_D, down, variance)
            self._passed["height"] = now
            return
        ratio = self._fuse_rows(_D, down - self.pos_n[2:], variance, _HEIGHT_GATE)
        self.ratios["height"] = math.sqrt(ratio)
        if ratio <= 1.0:
            self._passed["height"] = now
        elif now - self._passed["height"] > _HEIGHT_RETRY:
            self._set(_D, down, variance)
            self._passed["height"] = now
            self.events.append((now, "height reset by time"))

    def _fuse_heading(self, source: int, yaw: float, std: float) -> None:
        if source != self._yaw_source:
            # Aligned to the new source at once
            self._yaw_source = source
            roll, pitch, _ = so3.to_euler(self.q_nb)
            self.q_nb = so3.from_euler(roll, pitch, yaw)
            self.P[2, :] = 0.0
            self.P[:, 2] = 0.0
            self.P[2, 2] = std**2
            self.is_aligned = True
            return
        before = self.rejected
        self._fuse_yaw(yaw, std, self.tuning.yaw_gate)
        self.ratios["yaw"] = 1.1 if self.rejected > before else 0.0

    def status(self) -> dict[str, float]:
        """Return the fields of EKF_STATUS_REPORT."""
        ratios = self.ratios
        return {
            "velocity_variance": ratios["velocity"] if self.is_aided else 0.0,
            "pos_horiz_variance": ratios["position"] if self.is_aided else 0.0,
            "pos_vert_variance": ratios["height"],
            "compass_variance": ratios["yaw"],
            "flags": _FLAGS_AIDED if self.is_aided else _FLAGS_HELD,
        }


assert POS.start == _NE[0]
assert VEL.start == _VNE[0]
