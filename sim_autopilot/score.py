"""The ODOMETRY that came back, compared with the truth at its time of validity."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from sim_autopilot.autopilot import COMPONENT_ID, Received
from sim_autopilot.flight import Flight
from sim_autopilot.telemetry import POSE_DIAGONAL

LOCAL_NED, BODY_NED, BODY_FRD, LOCAL_FRD = 1, 8, 12, 20
_FRAMES = {
    (LOCAL_NED, LOCAL_NED),
    (LOCAL_NED, BODY_FRD),
    (LOCAL_FRD, BODY_FRD),
    (LOCAL_NED, BODY_NED),
}
"""Pairs that mean north-east-down and forward-right-down."""

_ROW = 21
"""Numbers kept of each message."""


class Estimate(NamedTuple):
    """The ODOMETRY messages as arrays with the times of validity, ascending, as first axis."""

    t_ns: npt.NDArray[np.int64]
    t: Array
    """Since the start of the flight, s."""
    pos_n: Array
    """North, east, down of home, m."""
    vel_n: Array
    q_nb: Array
    std: Array
    """Position north, east, down, attitude about x, y, z, velocity in the body."""


class Error(NamedTuple):
    """Estimate minus truth, row by row."""

    pos_n: Array
    vel_n: Array
    euler: Array
    """Roll, pitch, yaw, rad."""
    vel_b: Array


class Witness:
    """Receives the estimates of one flight, and compares them with the truth."""

    def __init__(self, flight: Flight, true_ns: Callable[[int, int], int] | None = None) -> None:
        """Start without an estimate.

        ``true_ns`` converts a stamp of the autopilot's clock, with its time of arrival, to the
        flight's clock, ns; None: the clocks are the same.
        """
        self.frames: Counter[tuple[int, int]] = Counter()
        """ODOMETRY by frame and child frame."""
        self.not_scored = 0
        """ODOMETRY in other frames, or with values that are not finite."""
        self.repeated = 0
        """ODOMETRY whose stamp is not after the one before."""
        self._flight = flight
        self._sent_ns = array("q")
        self._true_ns = true_ns or (lambda stamp_ns, now_ns: stamp_ns)
        self._rows = array("d")
        self._origins: list[LocalFrame] = []
        self._latencies_ns = array("q")
        self._resets = 0
        self._reset_counter: int | None = None

    def sent(self, now_ns: int) -> None:
        """Note the time at which the next inertial sample was sent."""
        self._sent_ns.append(now_ns)

    def receive(self, message: Received) -> None:
        """Take a message of another component."""
        if message.component_id == COMPONENT_ID:
            return
        if message.name == "GPS_GLOBAL_ORIGIN":
            self._origin(message.fields)
        elif message.name == "ODOMETRY":
            self._odometry(message.fields, message.now_ns)

    @property
    def count(self) -> int:
        """The number of messages that can be scored."""
        return len(self._rows) // _ROW

    def estimate(self, after: float = 0.0) -> Estimate:
        """Return the estimates that are valid at ``after`` seconds of flight or later.

        Positions are converted to the flight's own origin where theirs is known.
        """
        rows = np.array(self._rows, dtype=float).reshape(-1, _ROW)
        rows = rows[rows[:, 0] * 1000 >= self._flight.first_ns + after * 1e9]
        t_ns = np.asarray(rows[:, 0], dtype=np.int64) * 1000
        home = self._flight.trajectory.frame
        pos_n = rows[:, 2:5].copy()
        for index, origin in enumerate(self._origins):
            of_it = rows[:, 1] == index
            pos_n[of_it] = home.to_ned(*origin.to_geodetic(pos_n[of_it]))
        q_nb = rows[:, 5:9]
        return Estimate(
            t_ns=t_ns,
            t=np.asarray((t_ns - self._flight.first_ns) * 1e-9, dtype=np.float64),
            pos_n=pos_n,
            vel_n=so3.rotate(q_nb, rows[:, 9:12]),
            q_nb=q_nb,
            std=np.sqrt(np.maximum(rows[:, 12:21], 0.0)),
        )

    def error(self, estimate: Estimate) -> Error:
        """Return estimate minus truth; without a published origin the mean offset is subtracted."""
        truth = self._flight.truth_at(estimate.t_ns)
        pos_n = estimate.pos_n - truth.pos_n
        if not self._origins and len(pos_n):
            pos_n = pos_n - pos_n.mean(axis=0)
        vel_n = estimate.vel_n - truth.vel_n
        euler = so3.wrap(so3.to_euler(estimate.q_nb) - truth.euler)
        return Error(pos_n, vel_n, euler, so3.rotate(so3.conjugate(estimate.q_nb), vel_n))

    def score(self, after: float = 10.0) -> dict[str, Any]:
        """Return the score from ``after`` seconds of flight on, for JSON."""
        estimate = self.estimate(after)
        result: dict[str, Any] = {
            "scenario": self._flight.scenario.name,
            "seed": self._flight.seed,
            "duration_s": round(self._flight.duration, 3),
            "score_after_s": after,
            "odometry": {
                "received": sum(self.frames.values()),
                "not_scored": self.not_scored,
                "repeated": self.repeated,
                "scored": len(estimate.t),
                "rate_hz": _rate(estimate.t),
                "frames": {f"{pose}/{twist}": n for (pose, twist), n in self.frames.items()},
                "resets": self._resets,
            },
            "origin": "GPS_GLOBAL_ORIGIN" if self._origins else "unknown: mean offset taken off",
            "latency_ms": (
                quantiles(np.array(self._latencies_ns) * 1e-6) if self._latencies_ns else None
            ),
        }
        if not len(estimate.t):
            return result
        error = self.error(estimate)
        degrees = np.degrees(error.euler)
        result["horizontal_m"] = _summary(np.hypot(*error.pos_n[:, :2].T))
        result["vertical_m"] = _summary(error.pos_n[:, 2])
        result["velocity_mps"] = _summary(np.linalg.norm(error.vel_n, axis=1))
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            result[f"{name}_deg"] = _summary(degrees[:, axis])
        result["inside_2_sigma"] = _inside_2_sigma(error, estimate.std)
        return result

    def _origin(self, fields: Any) -> None:
        origin = LocalFrame(
            math.radians(fields.latitude * 1e-7),
            math.radians(fields.longitude * 1e-7),
            fields.altitude * 1e-3,
        )
        # Positions that came before the first origin are about it too
        if not self._origins or origin != self._origins[-1]:
            self._origins.append(origin)

    def _odometry(self, fields: Any, now_ns: int) -> None:
        frames = (fields.frame_id, fields.child_frame_id)
        self.frames[frames] += 1
        pose = (fields.x, fields.y, fields.z, *fields.q)
        variances = [fields.pose_covariance[i] for i in POSE_DIAGONAL]
        vel_b, var_b = body_velocity(fields)
        numbers = (*pose, *vel_b, *variances, *var_b)
        if frames not in _FRAMES or not all(map(math.isfinite, numbers[:10])):
            self.not_scored += 1
            return
        t_ns = self._true_ns(fields.time_usec * 1000, now_ns)
        if self._rows and t_ns // 1000 <= self._rows[-_ROW]:
            self.repeated += 1
            return
        self._rows.extend((t_ns // 1000, max(len(self._origins) - 1, 0), *numbers))
        if self._reset_counter not in (None, fields.reset_counter):
            self._resets += 1
        self._reset_counter = fields.reset_counter
        number = (t_ns - self._flight.first_ns) / self._flight.period_ns
        if 0 <= round(number) < len(self._sent_ns):
            self._latencies_ns.append(now_ns - self._sent_ns[round(number)])


def body_velocity(fields: Any) -> tuple[list[float], list[float]]:
    """Return the velocity along the body's axes, and the variances of that."""
    vel, c = [fields.vx, fields.vy, fields.vz], fields.velocity_covariance
    if fields.child_frame_id != LOCAL_NED:
        return vel, [c[i] for i in POSE_DIAGONAL[:3]]
    C_bn = so3.to_matrix(np.asarray(fields.q, dtype=float)).T
    P = np.array([[c[0], c[1], c[2]], [c[1], c[6], c[7]], [c[2], c[7], c[11]]])
    return (C_bn @ vel).tolist(), np.diagonal(C_bn @ P @ C_bn.T).tolist()


def _summary(error: Array) -> dict[str, float]:
    size = np.abs(error)
    return {
        "rms": round(float(np.sqrt(np.mean(size**2))), 4),
        "p95": round(float(np.quantile(size, 0.95)), 4),
        "max": round(float(size.max()), 4),
    }


def quantiles(values: Array) -> dict[str, float]:
    """Return median, 99 % quantile and maximum, for JSON."""
    p50, p99 = np.quantile(values, [0.5, 0.99])
    return {
        "p50": round(float(p50), 3),
        "p99": round(float(p99), 3),
        "max": round(float(values.max()), 3),
    }


def _rate(t: Array) -> float:
    return round((len(t) - 1) / float(t[-1] - t[0]), 2) if len(t) > 1 else 0.0


def _inside_2_sigma(error: Error, std: Array) -> dict[str, float]:
    """Return the share of the errors within two of their own sigmas: 0.954 is right."""
    blocks = {
        "horizontal": (error.pos_n[:, :2], std[:, :2]),
        "vertical": (error.pos_n[:, 2:], std[:, 2:3]),
        "attitude": (error.euler, std[:, 3:6]),
        "velocity": (error.vel_b, std[:, 6:9]),
    }
    return {
        name: round(float(np.mean(np.abs(part) <= 2.0 * sigma)), 4)
        for name, (part, sigma) in blocks.items()
    }
