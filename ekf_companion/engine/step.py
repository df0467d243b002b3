"""What an estimate was corrected by between two looks at it: the step that no motion explains.

A follower sees one ODOMETRY after the other, and nothing of the filter behind them. So the step is
measured from outside: the second estimate less the first, carried on by the inertial samples
between them. That holds for whatever the filter does inside, a reset or one large correction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from struct import Struct
from typing import NamedTuple

from ekf_companion.core.output.jump import unexplained_step
from ekf_companion.nav.matrix3 import Vector3, apply, from_quaternion
from ekf_companion.nav.state import Odometry

_USUAL_S = 20.0
"""Time constant of the usual step."""
_MANY = 10.0
"""Times the usual step. The looks at which a fix is fused are one in six, so this is four times the
usual correction by a fix."""
_START_S = 5.0
"""After a start the first fixes correct each other by as much as they are uncertain."""
_SMOOTH_S = 0.05
"""Interval up to which the samples between two looks explain any flight."""
_MOTION = Struct("<10f")
"""Of an ODOMETRY's numbers: position in n, quaternion, velocity in b."""


class Step(NamedTuple):
    """The second of two estimates less what the first and the motion between them lead to."""

    dt: float
    """Time between the two, s."""
    pos_n: Vector3
    """m."""
    vel_n: Vector3
    """m/s."""
    yaw: float
    """About down, rad, in [-pi, pi]."""

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Distance (m), speed (m/s) and angle (rad)."""
        return math.hypot(*self.pos_n), math.hypot(*self.vel_n), abs(self.yaw)


class Pose(NamedTuple):
    """Of an ODOMETRY's numbers, what a step is measured by."""

    t_ns: int
    pos_n: Vector3
    q_nb: Sequence[float]
    vel_n: Vector3


def to_pose(odometry: Odometry) -> Pose:
    """Return position, attitude and velocity of an ODOMETRY."""
    numbers = _MOTION.unpack_from(odometry.numbers)
    vel_n = apply(from_quaternion(*numbers[3:7]), numbers[7:])
    return Pose(odometry.t_ns, numbers[:3], numbers[3:7], vel_n)


class StepMeter:
    """Measures the step from one look at the estimate to the next."""

    def __init__(self, lag: float = 0.0, *, is_mean: bool = True) -> None:
        """Begin without a look.

        Args:
            lag: An inertial sample was true this long before its stamp, s: an estimate is carried
                on to the stamp by its last sample, which the next samples replace.
            is_mean: Whether a sample is the mean since the one before, not a reading at its time.
        """
        self._lag, self._is_mean = lag, is_mean
        self._last: Pose | None = None
        self._before: tuple[float, ...] | None = None
        self._samples: list[tuple[float, ...]] = []

    def add(self, sample: tuple[float, ...]) -> None:
        """Add an inertial sample: angular rate (rad/s), then specific force (m/s^2), in b."""
        self._samples.append(sample)

    def forget(self) -> None:
        """Forget the last look: there is no estimate now."""
        self._last, self._before, self._samples = None, None, []

    def measure(self, pose: Pose) -> Step | None:
        """Return the step since the last look; None if there was none, or no sample came since."""
        last, before, samples = self._last, self._before, self._samples
        self._last, self._samples = pose, []
        if samples:
            self._before = samples[-1]
        if last is None or before is None or not samples or pose.t_ns <= last.t_ns:
            return None
        dt = (pose.t_ns - last.t_ns) * 1e-9
        # A reading at its time is the mean of the interval around it, which it ends half of
        ahead = self._lag if self._is_mean else self._lag - 0.5 * dt / len(samples)
        first, second = ((*one.pos_n, *one.q_nb, *one.vel_n) for one in (last, pose))
        x, y, z, vx, vy, vz, yaw = unexplained_step(first, second, samples, dt, before, ahead)
        return Step(dt, (x, y, z), (vx, vy, vz), yaw)


class Limit(NamedTuple):
    """How large a step must be at least, and need be at most, to be a jump."""

    least: float
    most: float
    slow: float
    """What motion may add over a longer interval, per s, or per s^2 of position."""


POSITION = Limit(0.5, 1.0, 2.5)
"""m. EKF2 refuses beyond 5 sigma (EKF2_EVP_GATE), sigma no less than 0.1 m (EKF2_EVP_NOISE); EKF3
beyond 5 sigma (EK3_POS_I_GATE) of 0.2 m (VISO_POS_M_NSE) on two axes, 1.4 m."""
VELOCITY = Limit(0.4, 0.8, 10.0)
"""m/s. EKF2: 3 sigma (EKF2_EVV_GATE) of 0.1 m/s (EKF2_EVV_NOISE) and its own; EKF3: 5 sigma
(EK3_VEL_I_GATE) of 0.1 m/s (VISO_VEL_M_NSE) on three axes, 0.87 m/s."""
YAW = Limit(0.175, 0.26, 1.0)
"""rad: 10 and 15 degrees. EKF2: 2.6 sigma (EKF2_HDG_GATE) of 0.1 rad (EKF2_EVA_NOISE), 15 degrees;
EKF3: 3 sigma (EK3_YAW_I_GATE) of 0.2 rad (VISO_YAW_M_NSE), 34 degrees."""


class JumpDetector:
    """Finds the jumps among the corrections: usual are those of a fix, and the samples' noise.

    A step is a jump beyond many times the usual one, between two bounds: at the lower, no follower
    refuses it; at the upper, one of them does, however noisy the receiver.
    """

    def __init__(self) -> None:
        # Until the usual step is known, only what no follower takes is a jump
        self._squares = [(limit.most / _MANY) ** 2 for limit in _LIMITS]
        self._age = 0.0

    def judge(self, step: Step, stated: Sequence[float]) -> tuple[bool, bool, bool]:
        """Return whether a step is a jump in position, in velocity and in yaw.

        Args:
            step: The step.
            stated: One sigma of position, velocity and yaw as it was sent before the step; 0: of
                what was not aided. A step within it is none for a receiver, nor is one of the
                position within three just after a start, when one fix is all there is: every gate
                has three sigma and more.
        """
        weight, beyond = min(step.dt / _USUAL_S, 1.0), max(step.dt - _SMOOTH_S, 0.0)
        self._age += step.dt
        factors = (3.0 if self._age < _START_S else 1.0), 1.0, 1.0
        jumps = []
        for i, (size, limit) in enumerate(zip(step.sizes, _LIMITS, strict=True)):
            allowed = limit.slow * (beyond * beyond if limit is POSITION else beyond)
            usual = _MANY * math.sqrt(self._squares[i])
            largest = max(min(max(limit.least, usual), limit.most), factors[i] * stated[i])
            largest += allowed
            jumps.append(size > largest)
            self._squares[i] += weight * (min(size, largest) ** 2 - self._squares[i])
        return jumps[0], jumps[1], jumps[2]


_LIMITS = (POSITION, VELOCITY, YAW)
