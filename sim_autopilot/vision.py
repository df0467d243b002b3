"""Another computer on the link that says where the vehicle is: a camera, a tracker, a second board.

It knows the truth, beside an offset of its frame and a drift: what an autopilot makes of two that
disagree is seen by that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav import so3
from sim_autopilot.flight import Motion

_HEARTBEAT_NS = 1_000_000_000
_ONBOARD, _NO_AUTOPILOT, _ACTIVE = 18, 8, 4
_LOCAL_FRD, _BODY_FRD, _VISION = 20, 12, 2
_VARIANCE = 0.01
COMPONENT = 197
"""MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY."""


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
    ) -> None:
        """Send a message so many times a second.

        Args:
            motion: The truth of now.
            message: VISION_POSITION_ESTIMATE or ODOMETRY.
            offset_n: Its origin is so far from the true one, m, with the sign of what it says.
            drift_n: Growth of that, m/s.
            rate: Hz.
            component_id: Its own.
        """
        self.offset_n = np.array(offset_n)
        self.counter = 0
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

    def _say(self, now_ns: int) -> None:
        true = self._motion()
        since = (now_ns - (self._begin_ns or now_ns)) * 1e-9
        pos_n = np.array(true.pos_n) + self.offset_n + self._drift_n * since
        covariance = [0.0] * 21
        for k in (0, 6, 11, 15, 18, 20):
            covariance[k] = _VARIANCE
        place = dict(zip("xyz", pos_n.tolist(), strict=True))
        if self._message == "ODOMETRY":
            q_nb = np.array(true.q_nb)
            vel_b = so3.rotate(so3.conjugate(q_nb), np.array(true.vel_n) + self._drift_n)
            fields = {
                "time_usec": now_ns // 1000,
                "frame_id": _LOCAL_FRD,
                "child_frame_id": _BODY_FRD,
                "q": tuple(q_nb.tolist()),
                **dict(zip(("vx", "vy", "vz"), vel_b.tolist(), strict=True)),
                "pose_covariance": covariance,
                "velocity_covariance": covariance,
                "estimator_type": _VISION,
                "quality": 100,
            }
        else:
            angles = dict(zip(("roll", "pitch", "yaw"), true.euler, strict=True))
            fields = {"usec": now_ns // 1000, **angles, "covariance": covariance}
        said = self._sender.message(self._message, **place, **fields, reset_counter=self.counter)
        self._out.append(said)
