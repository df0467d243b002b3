"""Another computer on the link that says where the vehicle is: a camera, a tracker, a second board.

It knows the truth, in a frame of its own that may be moved, turned and stretched, and it has the
faults of a real one: what an autopilot, or an estimator that fuses it, makes of them is seen by
that.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.flight import Motion

_HEARTBEAT_NS = 1_000_000_000
_ONBOARD, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4
_LOCAL_FRD, _BODY_FRD, _VISION = 20, 12, 2
_VARIANCE = 0.01
_LONGEST_NS = 2_000_000_000
"""Longest delay."""
COMPONENT = 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VisionFaults:
    """What is wrong with it; each as by default is nothing."""

    scale: float = 1.0
    """By which it measures all ways."""
    yaw: float = 0.0
    """Of its frame: what it measures is turned by so much, rad."""
    delay: float = 0.0
    """What it says was true so long before its stamp, s."""
    walk: float = 0.0
    """Random walk of its place by the way that is travelled, m/sqrt(m)."""
    noise: float = 0.0
    """One sigma of the white error of its place, m."""
    jitter: float = 0.0
    """One sigma of its stamps, s."""
    burst: int = 1
    """So many messages come together, with their own stamps."""
    yaw_slip: float = 0.0
    """Rate at which its frame turns, rad/s."""
    frozen: tuple[float, float] = (math.inf, math.inf)
    """From when until when it repeats itself, s after its begin."""
    is_enu: bool = False
    """Whether it says east, north, up and calls it the frame it should be."""


class VisionSource:
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
        self.offset_n = np.array(offset_n)
        self.yaw = (faults or VisionFaults()).yaw
        self.counter = 0
        self._faults = faults or VisionFaults()
        self._rng = np.random.default_rng(seed)
        self._walked = np.zeros(3)
        self._past: deque[tuple[int, Motion]] = deque()
        self._held: list[bytes] = []
        self._before: tuple[int, Array, Array] | None = None
        """Stamp (us), place and attitude in its own frame of what it said last."""
        self._frozen: Motion | None = None
        self._motion, self._message, self._drift_n = motion, message, np.array(drift_n)
        self._period_ns = round(1e9 / rate)
        self._sender = Sender(1, component_id)
        self._out: list[bytes] = []
        self._begin_ns: int | None = None
        self._heartbeat_ns = self._next_ns = 0

    def receive(self, data: bytes, now_ns: int) -> None:
        """Speak in time with the autopilot."""
        self.tick(now_ns)

    def tick(self, now_ns: int) -> None:
        """Send what is due."""
        self._begin_ns = now_ns if self._begin_ns is None else self._begin_ns
        if now_ns >= self._heartbeat_ns:
            self._heartbeat_ns = now_ns + _HEARTBEAT_NS
            fields = {"type": _ONBOARD, "autopilot": _NO_AUTOPILOT, "system_status": _ACTIVE}
            self._out.append(self._sender.message("HEARTBEAT", **fields, mavlink_version=3))
        if now_ns >= self._next_ns:
            self._next_ns = max(self._next_ns + self._period_ns, now_ns)
            self._say(now_ns)

    def data_to_send(self) -> list[bytes]:
        """Return what it says, once."""
        out, self._out = self._out, []
        return out

    def reset(self, offset_n: tuple[float, float, float], yaw: float, *, counts: bool) -> None:
        """Begin a new frame, moved (m) and turned (rad) against that of now; tell it or not."""
        self.offset_n = self.offset_n + np.array(offset_n)
        self.yaw += yaw
        self.counter += counts

    def _true(self, now_ns: int, since: float) -> Motion:
        """Return the motion that it sees: that of some time ago, or of when it froze."""
        faults = self._faults
        self._past.append((now_ns, self._motion()))
        while self._past[0][0] < now_ns - _LONGEST_NS:
            self._past.popleft()
        at_ns = now_ns - round(faults.delay * 1e9)
        true = min(self._past, key=lambda one: abs(one[0] - at_ns))[1]
        if faults.frozen[0] <= since < faults.frozen[1]:
            self._frozen = self._frozen or true
            return self._frozen
        return true

    def _say(self, now_ns: int) -> None:
        faults, since = self._faults, (now_ns - (self._begin_ns or now_ns)) * 1e-9
        true = self._true(now_ns, since)
        length = float(np.linalg.norm(true.vel_n)) * self._period_ns * 1e-9
        self._walked += faults.walk * math.sqrt(length) * self._rng.standard_normal(3)
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
        stamp_us = now_ns // 1000 + round(faults.jitter * 1e6 * self._rng.standard_normal())
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
            way = self._travelled(stamp_us, pos_f, so3.from_euler(*euler))
            if way is not None:
                self._hold(self._sender.message(self._message, **way))
            return
        else:
            angles = dict(zip(("roll", "pitch", "yaw"), euler.tolist(), strict=True))
            fields = {"usec": stamp_us, **angles, "covariance": covariance}
        said = self._sender.message(self._message, **place, **fields, reset_counter=self.counter)
        self._hold(said)

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

    def _hold(self, said: bytes) -> None:
        """Send it, or wait until a burst is full."""
        self._held.append(said)
        if len(self._held) >= self._faults.burst:
            self._out += self._held
            self._held = []
