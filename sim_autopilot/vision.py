"""Another computer on the link that says where the vehicle is: a camera, a tracker, a second board.

It knows the truth, in a frame of its own that may be moved, turned and stretched, and it has the
faults of a real one: what an autopilot, or an estimator that fuses it, makes of them is seen by
that.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.component import Component, ComponentFaults
from sim_autopilot.flight import Motion

_LOCAL_FRD, _BODY_FRD, _VISION = 20, 12, 2
_VARIANCE = 0.01
COMPONENT = 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VisionFaults(ComponentFaults):
    """What is wrong with it; each as by default is nothing."""

    scale: float = 1.0
    """By which it measures all ways."""
    yaw: float = 0.0
    """Of its frame: what it measures is turned by so much, rad."""
    walk: float = 0.0
    """Random walk of its place by the way that is travelled, m/sqrt(m)."""
    noise: float = 0.0
    """One sigma of the white error of its place, m."""
    yaw_slip: float = 0.0
    """Rate at which its frame turns, rad/s."""
    is_enu: bool = False
    """Whether it says east, north, up and calls it the frame it should be."""


class VisionSource(Component):
    """One such computer, as a peer of a link."""

    def __init__(
        self,
        motion: Callable[[], Motion],
        *,
        message: str = "VISION_POSITION_ESTIMATE",
        offset_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
        drift_n: tuple[float, float, float] = (0.0, 0.0, 0.0),
        rate: float = 30.0,
        component_id: int = COMPONENT,
        faults: VisionFaults | None = None,
        seed: int = 0,
    ) -> None:
        """Send a message so many times a second.

        Args:
            motion: The truth of now.
            message: VISION_POSITION_ESTIMATE, VISION_SPEED_ESTIMATE, VISION_POSITION_DELTA or
                ODOMETRY.
            offset_n: Its origin is so far from the true one, m, with the sign of what it says.
            drift_n: Growth of that, m/s.
            rate: Hz.
            component_id: Its own.
            faults: What is wrong with it.
            seed: Of what is random in that.
        """
        self._faults = faults or VisionFaults()
        super().__init__(motion, rate, component_id, self._faults, seed)
        self.offset_n = np.array(offset_n)
        self.yaw = self._faults.yaw
        self.counter = 0
        self._walked = np.zeros(3)
        self._message, self._drift_n = message, np.array(drift_n)
        self._before: tuple[int, Array, Array] | None = None
        """Stamp (us), place and attitude in its own frame of what it said last."""

    def reset(self, offset_n: tuple[float, float, float], yaw: float, *, counts: bool) -> None:
        """Begin a new frame, moved (m) and turned (rad) against that of now; tell it or not."""
        self.offset_n = self.offset_n + np.array(offset_n)
        self.yaw += yaw
        self.counter += counts

    def _say(self, true: Motion, since: float, stamp_us: int) -> bytes | None:
        faults = self._faults
        way = float(np.linalg.norm(true.vel_n)) * self._period_ns * 1e-9
        self._walked += faults.walk * math.sqrt(way) * self._rng.standard_normal(3)
        yaw = self.yaw + faults.yaw_slip * since
        q_fn = so3.from_euler(0.0, 0.0, yaw)
        vel_f = faults.scale * so3.rotate(q_fn, np.array(true.vel_n) + self._drift_n)
        pos_f = faults.scale * so3.rotate(q_fn, np.array(true.pos_n) + self._walked)
        pos_f = pos_f + self.offset_n + self._drift_n * since
        if self._frozen is not true and faults.noise:
            pos_f = pos_f + faults.noise * self._rng.standard_normal(3)
        euler = np.add(true.euler, (0.0, 0.0, yaw))
        if faults.is_enu:
            pos_f, vel_f = (one[[1, 0, 2]] * [1.0, 1.0, -1.0] for one in (pos_f, vel_f))
            euler = np.array([euler[0], -euler[1], math.pi / 2.0 - euler[2]])
        covariance = [0.0] * 21
        for k in (0, 6, 11, 15, 18, 20):
            covariance[k] = _VARIANCE
        place = dict(zip("xyz", pos_f.tolist(), strict=True))
        if self._message == "ODOMETRY":
            vel_b = so3.rotate(so3.conjugate(np.array(true.q_nb)), np.array(true.vel_n))
            vel_b = faults.scale * (
                vel_b + so3.rotate(so3.conjugate(np.array(true.q_nb)), self._drift_n)
            )
            fields = {
                "time_usec": stamp_us,
                "frame_id": _LOCAL_FRD,
                "child_frame_id": _BODY_FRD,
                "q": tuple(so3.from_euler(*euler).tolist()),
                **dict(zip(("vx", "vy", "vz"), vel_b.tolist(), strict=True)),
                "pose_covariance": covariance,
                "velocity_covariance": covariance,
                "estimator_type": _VISION,
                "quality": 100,
            }
        elif self._message == "VISION_SPEED_ESTIMATE":
            place = dict(zip("xyz", vel_f.tolist(), strict=True))
            fields = {"usec": stamp_us, "covariance": [_VARIANCE, 0, 0, 0, _VARIANCE, 0, 0, 0, 0]}
        elif self._message == "VISION_POSITION_DELTA":
            travelled = self._travelled(stamp_us, pos_f, so3.from_euler(*euler))
            if travelled is None:
                return None
            return self._sender.message(self._message, **travelled)
        else:
            angles = dict(zip(("roll", "pitch", "yaw"), euler.tolist(), strict=True))
            fields = {"usec": stamp_us, **angles, "covariance": covariance}
        return self._sender.message(self._message, **place, **fields, reset_counter=self.counter)

    def _travelled(self, stamp_us: int, pos_f: Array, q_fb: Array) -> dict[str, Any] | None:
        """Return the way since the last time, by the body's axes of now; None: there was none."""
        before, self._before = self._before, (stamp_us, pos_f, q_fb)
        if before is None or stamp_us <= before[0]:
            return None
        return {
            "time_usec": stamp_us,
            "time_delta_usec": stamp_us - before[0],
            "angle_delta": so3.log(so3.multiply(so3.conjugate(before[2]), q_fb)).tolist(),
            "position_delta": so3.rotate(so3.conjugate(q_fb), pos_f - before[1]).tolist(),
            "confidence": 100.0,
        }
