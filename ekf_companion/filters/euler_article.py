"""The direct filter on Euler angles with the constants and the order of the seed article.

At each inertial sample: one step with that sample (the first too), then the heading, then position
and velocity together, without a gate. The Earth is flat and does not turn. Two of the constants are
errors: the variance of the heading is its one sigma, 0.02, where the square was meant; and a floor
of (1e-3)^2 under the whole diagonal of Q, meant against a singular matrix, raises the random walk
of the biases from 1e-5 to 1e-3.

Source: tsuibeyond/BasicEKF, SimMatlab/run_state_estimation_ins_euler_directEKF_method.m; the C++
edition in SimCpp of the same filter is in single precision, uses 1 + A dt for the exponential, and
starts at constants.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import FilterError, LogError
from ekf_companion.filters.euler import (
    Real,
    derivative,
    jacobian,
    navigation_covariance,
    refuse_steep,
    to_nominal,
    van_loan,
)
from ekf_companion.filters.observation import Azimuth, Position, Velocity
from ekf_companion.filters.sequence import MeasurementSequence, stopped
from ekf_companion.filters.solution import Recorder, Solution
from ekf_companion.filters.strapdown import N
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import SIMULATED, LocalFrame

GRAVITY = 9.81
"""m/s^2."""
POSITION_STD, VELOCITY_STD = 1.0, 0.05
"""m, m/s, each axis."""
START_STD = np.repeat([np.radians(30.0), 100.0, 10.0, 0.01, 0.05], 3)
"""rad, m, m/s, rad/s, m/s^2."""
WALK = np.array([2e-3, 5e-3, 1e-3])
"""Of angles, position, velocity: rad, m, m/s per square root of s."""
NEAR = 1e5
"""Distance from the origin of ``SIMULATED`` within which a recording is of a simulation, m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Constants:
    """The constants that can be varied; the defaults are the article's."""

    heading_variance: float = 0.02
    """rad^2; 4e-4 was meant."""
    bias_walk: float = 1e-3
    """rad/s and m/s^2 per square root of s; 1e-5 was meant."""
    is_single: bool = False
    """Single precision."""
    is_first_order: bool = False
    """1 + A dt for the exponential."""


ARTICLE = Constants()
PUBLISHED = Constants(is_single=True, is_first_order=True)
"""Those of the C++ edition, whose output its author published."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Epoch:
    """An inertial sample, and the aids since the one before."""

    t_ns: int
    dt: float
    """s."""
    gyro: Array
    accel: Array
    headings: tuple[Azimuth, ...]
    fixes: tuple[Array, ...]
    """North, east, altitude, velocity north, east, down, each of shape (6,)."""


class Direct:
    """The article's filter."""

    def __init__(self, x: npt.ArrayLike, constants: Constants = ARTICLE) -> None:
        """Start at a state, shape (15,)."""
        dtype = np.float32 if constants.is_single else np.float64
        self._constants = constants
        self.x: Real = np.array(x, dtype=dtype)
        """State."""
        self.P: Real = np.diag(np.square(START_STD)).astype(dtype)
        """Covariance."""
        walks = np.repeat([*WALK, constants.bias_walk, constants.bias_walk], 3)
        self._Q: Real = np.diag(np.square(walks)).astype(dtype)
        self._R: Real = np.diag(np.square(np.repeat([POSITION_STD, VELOCITY_STD], 3))).astype(dtype)
        self._fall_n: Real = np.array([0.0, 0.0, GRAVITY], dtype=dtype)

    def predict(self, dt: float, gyro: npt.ArrayLike, accel: npt.ArrayLike) -> None:
        """Predict over an interval, s, by a sample.

        Raises:
            FilterError: The pitch has become too steep.
        """
        rate_b, force_b = (np.asarray(one, dtype=self.x.dtype) for one in (gyro, accel))
        F = jacobian(self.x, rate_b, force_b)
        Phi, Q = van_loan(F, self._Q, dt, self._constants.is_first_order)
        rate = derivative(self.x, rate_b, force_b, self._fall_n)
        self.x = self.x + rate * self.x.dtype.type(dt)
        self.P = Phi @ self.P @ Phi.T + Q
        refuse_steep(self.x)

    def step(self, epoch: Epoch) -> None:
        """Process a sample, then its aids, in the article's order."""
        self.predict(epoch.dt, epoch.gyro, epoch.accel)
        for azimuth in epoch.headings:
            self.correct_heading(_yaw(self.x, azimuth))
        for fix in epoch.fixes:
            self.correct_fix(fix)

    def correct_heading(self, yaw: float) -> None:
        """Fuse a heading, rad, at the multiple of a turn next to the state."""
        turns = np.rint((self.x[2] - yaw) / (2.0 * np.pi))
        R = np.array([[self._constants.heading_variance]], dtype=self.x.dtype)
        self._correct(slice(2, 3), np.array([yaw + 2.0 * np.pi * turns], dtype=self.x.dtype), R)

    def correct_fix(self, fix: npt.ArrayLike) -> None:
        """Fuse north, east, altitude (m) and velocity north, east, down (m/s) together."""
        self._correct(slice(3, 9), np.asarray(fix, dtype=self.x.dtype), self._R)

    def _correct(self, states: slice, measured: Real, R: Real) -> None:
        """Fuse a measurement of states."""
        K = self.P[:, states] @ np.linalg.inv(self.P[states, states] + R)
        self.x = self.x + K @ (measured - self.x[states])
        self.P = self.P - K @ self.P[states]
        refuse_steep(self.x)


def epochs(sequence: MeasurementSequence, frame: LocalFrame) -> Iterator[Epoch]:
    """Yield a recording in the article's form: aids count at the time of the next sample.

    A fix without a velocity in three axes is left out.
    """
    waiting = deque(sequence.aids)
    t_ns = sequence.t_ns.tolist()
    first = t_ns[1] - t_ns[0]
    for k, now in enumerate(t_ns):
        headings: list[Azimuth] = []
        positions: dict[int, Position] = {}
        fixes: list[Array] = []
        while waiting and waiting[0][0] <= now:
            t, aid = waiting.popleft()
            if isinstance(aid, Azimuth):
                headings.append(aid)
            elif isinstance(aid, Position):
                positions[t] = aid
            elif isinstance(aid, Velocity) and len(aid.vel_n) == 3 and t in positions:
                pos_n = frame.to_ned(*sequence.frame.to_geodetic(positions[t].pos_n))
                fixes.append(np.concatenate([pos_n * [1.0, 1.0, -1.0], aid.vel_n]))
        yield Epoch(
            t_ns=now,
            dt=(now - t_ns[k - 1] if k else first) * 1e-9,
            gyro=sequence.gyro[k],
            accel=sequence.accel[k],
            headings=tuple(headings),
            fixes=tuple(fixes),
        )


def run(sequence: MeasurementSequence, constants: Constants = ARTICLE) -> Solution:
    """Run the article's filter over a recording, from the first fix with a recent heading on.

    Positions are metres of ``nav.earth.SIMULATED`` if the first fix is near it, so that those of a
    simulation are its own; else of the first fix.

    Raises:
        LogError: The recording ends before a heading, and a fix with its velocity, are known.
        FilterError: It starts too steep.
    """
    first = sequence.frame
    here = SIMULATED.to_ned(first.lat, first.lon, first.alt)
    frame = SIMULATED if np.hypot(here[0], here[1]) < NEAR else first
    recorder = Recorder("euler:article", frame)
    heading: Azimuth | None = None
    heard_ns = 0
    tried: Direct | None = None
    for epoch in epochs(sequence, frame):
        if tried is None:
            # Start at a fix with a heading shortly before it, level
            if epoch.headings:
                heading, heard_ns = epoch.headings[-1], epoch.t_ns
            if heading is None or not epoch.fixes or epoch.t_ns - heard_ns > sequence.window_ns:
                continue
            yaw = _yaw(np.zeros(N), heading)
            tried = Direct([0.0, 0.0, yaw, *epoch.fixes[0], *np.zeros(6)], constants)
        try:
            tried.step(epoch)
        except FilterError as why:
            if not len(recorder):
                raise
            return recorder.solution(notes=(*sequence.notes, stopped(epoch.t_ns, why)))
        recorder.add(epoch.t_ns, to_nominal(tried.x), navigation_covariance(tried.x, tried.P))
    if tried is None:
        raise LogError(
            "the recording ends before a heading, and a fix with velocity in three axes, are "
            "known: the article's filter takes both together; --preset corrected takes what it gets"
        )
    return recorder.solution(notes=sequence.notes)


def _yaw(x: Real, azimuth: Azimuth) -> float:
    """Return the heading by an azimuth and the state's tilt, rad."""
    return float(x[2]) + float(azimuth.innovation(to_nominal(x))[0])
