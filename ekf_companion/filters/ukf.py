"""An unscented filter on the manifold: states and models of the error-state filter, no Jacobians.

The estimate is a state and the covariance of the error state about it. A step draws sigma points
(:mod:`ekf_companion.filters.sigma_points`), propagates each through the motion or the measurement
model, and computes mean and covariance of the result.

Source: Brossard, Barrau, Bonnabel 2020, "A code for unscented Kalman filtering on manifolds
(UKF-M)", arXiv 2002.00878; Hauberg et al. 2013; Crassidis and Markley 2003 (USQUE) for the
attitude's error kept small beside a quaternion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ekf_companion.filters import sigma_points
from ekf_companion.filters.gate import Decision
from ekf_companion.filters.observation import Observation
from ekf_companion.filters.sequence import MeasurementSequence, Setup, run_sequence
from ekf_companion.filters.sigma_points import SigmaPoints
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Interval, Nominal, covariance_in_n
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array


class Unscented:
    """A filter of 15 states by 31 sigma points."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.state: Nominal = setup.start.state
        """The present estimate."""
        self.P: Array = setup.start.P.copy()
        """Covariance of its error state, shape (15, 15)."""
        self.repaired = 0
        """How often the covariance had lost its positive definiteness to rounding."""

    def predict(self, over: Interval) -> None:
        """Integrate the points over an interval; the noise is added to the result.

        The noise of one interval turns the body by 1e-4 rad: points of its own (55 instead of 31)
        would change the result by 1e-8.
        """
        points = self._draw()
        there = sigma_points.integrate(
            sigma_points.add(self.state, points.dx), over, self._setup.earth
        )
        self.state, dx = sigma_points.average(there, points.mean)
        self.P = _covariance(dx, points) + self._setup.noise.covariance(over.dt)

    def inflate(self, Q: Array) -> None:
        """Add to the covariance of the error state, shape (15, 15)."""
        self.P = self.P + Q

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse the aids of one time, one after the other."""
        for aid in aids:
            self._fuse(t_ns, aid)

    def _fuse(self, t_ns: int, aid: Observation) -> None:
        points, R = self._draw(), aid.covariance()
        innovations = aid.innovation(sigma_points.add(self.state, points.dx))
        is_angle, away = aid.aid == "heading", innovations - innovations[0]
        # Angles by the shorter way from the middle point's
        away = so3.wrap(away) if is_angle else away
        mean = points.mean @ away
        z, dy = innovations[0] + mean, mean - away
        z = so3.wrap(z) if is_angle else z
        weighted = points.covariance[:, None] * dy
        S = dy.T @ weighted + R
        decision = self._setup.gate.test(aid.aid, t_ns, z, S)
        if decision is Decision.REFUSED:
            return
        inflation = 0.0 * self.P
        if decision is Decision.RESET:
            K, inflation = self._setup.gate.reset(aid, self.state, t_ns)
            z = aid.innovation(self.state)
        else:
            K = np.linalg.solve(S, weighted.T @ points.dx).T
        # The remaining error of every point, and the noise of the sensor: no difference of
        # covariances, so none that could turn negative
        self.P = _covariance(points.dx - dy @ K.T, points) + K @ R @ K.T + inflation
        self._apply_update(K @ z)

    def _apply_update(self, dx: Array) -> None:
        """Step to the corrected state, and express the covariance about it.

        The posterior's points are drawn about the error state dx of the old state, and averaged
        about their own mean: with points this is the Jacobian of the reset, and its second order.
        """
        points = self._draw()
        beside = sigma_points.add(self.state, dx + points.dx)
        self.state, about = sigma_points.average(beside, points.mean)
        self.P = _covariance(about, points)

    def _draw(self) -> SigmaPoints:
        points = sigma_points.draw(self.P)
        self.repaired += points.is_repaired
        return points

    def covariance(self) -> Array:
        """Return the covariance of attitude, velocity and position in n, shape (9, 9)."""
        return covariance_in_n(self.P, self.state.q_nb)


def _covariance(dx: Array, points: SigmaPoints) -> Array:
    """Return the weighted covariance of error states about their mean, exactly symmetric."""
    P = dx.T @ (points.covariance[:, None] * dx)
    return np.asarray(0.5 * (P + P.T))


def run(sequence: MeasurementSequence) -> Solution:
    """Run the unscented filter over a recording.

    Raises:
        LogError: The recording ends before the filter can start.
    """
    setup = sequence.setup()
    tried = Unscented(setup)
    solution = run_sequence("ukf", tried, sequence, setup)
    if not tried.repaired:
        return solution
    note = f"the covariance was not positive definite {tried.repaired} times and was mended"
    return replace(solution, notes=(*solution.notes, note))
