"""An unscented filter on the manifold: states and models of the linear one, no Jacobians.

The estimate is a state and the covariance of the error state about it. A step draws sigma points
(:mod:`ekf_companion.filters.cloud`), takes each through the motion or the sensor's model, and reads
mean and covariance off what comes out.

Source: Brossard, Barrau, Bonnabel 2020, "A code for unscented Kalman filtering on manifolds
(UKF-M)", arXiv 2002.00878; Hauberg et al. 2013; Crassidis and Markley 2003 (USQUE) for the
attitude's error kept small beside a quaternion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import FilterSettings
from ekf_companion.filters import cloud, course
from ekf_companion.filters.cloud import Draw
from ekf_companion.filters.course import Course, Setup
from ekf_companion.filters.gate import Trust
from ekf_companion.filters.observation import Observation, reset
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Interval, Nominal, in_n
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]


class Unscented:
    """A filter of 15 states by 31 sigma points."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.state: Nominal = setup.start.state
        """The estimate of now."""
        self.P: Array = setup.start.P.copy()
        """Covariance of its error state, shape (15, 15)."""
        self.mended = 0
        """How often the covariance had lost its positive definiteness to rounding."""

    def predict(self, over: Interval) -> None:
        """Carry the points over an interval; the noise is added to what comes out.

        The noise of one interval turns the body by 1e-4 rad: points of its own (55 instead of 31)
        would find what adding finds, to 1e-8.
        """
        points = self._draw()
        moved = cloud.move(cloud.scatter(self.state, points.dx), over, self._setup.earth)
        self.state, dx = cloud.gather(moved, points.mean)
        self.P = _covariance(dx, points) + self._setup.noise.covariance(over.dt)

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse what was measured now, one aid after the other."""
        for aid in aids:
            self._fuse(t_ns, aid)

    def _fuse(self, t_ns: int, aid: Observation) -> None:
        points, R = self._draw(), aid.covariance()
        seen = aid.innovation(cloud.scatter(self.state, points.dx))
        is_angle, away = aid.aid == "heading", seen - seen[0]
        # Angles by the shorter way from the middle point's
        away = so3.wrap(away) if is_angle else away
        mean = points.mean @ away
        z, dy = seen[0] + mean, mean - away
        z = so3.wrap(z) if is_angle else z
        weighted = points.covariance[:, None] * dy
        S = dy.T @ weighted + R
        trust = self._setup.gate.admits(aid.aid, t_ns, z, S)
        if trust is Trust.REFUSED:
            return
        inflation = 0.0 * self.P
        if trust is Trust.RESET:
            anew = reset(aid, self.state, self._setup.gate.patience(aid.aid))
            K, inflation, z = anew.gain, anew.inflation, aid.innovation(self.state)
        else:
            K = np.linalg.solve(S, weighted.T @ points.dx).T
        # What is left of every point's error, and what the sensor's noise brings: no difference of
        # covariances, so none that could turn negative
        self.P = _covariance(points.dx - dy @ K.T, points) + K @ R @ K.T + inflation
        self._settle(K @ z)

    def _settle(self, dx: Array) -> None:
        """Step to the corrected state, and turn the covariance into the error states there.

        The posterior's points are drawn about the error state dx of the old state, and gathered
        about their own mean: with points this is the Jacobian of the reset, and its second order.
        """
        points = self._draw()
        beside = cloud.scatter(self.state, dx + points.dx)
        self.state, about = cloud.gather(beside, points.mean)
        self.P = _covariance(about, points)

    def _draw(self) -> Draw:
        points = cloud.draw(self.P)
        self.mended += points.is_mended
        return points

    def covariance(self) -> Array:
        """Return that of attitude (in n), velocity and position, shape (9, 9)."""
        return in_n(self.P, self.state.q_nb)


def _covariance(dx: Array, points: Draw) -> Array:
    """Return the weighted covariance of error states about their mean, exactly symmetric."""
    P = dx.T @ (points.covariance[:, None] * dx)
    return np.asarray(0.5 * (P + P.T))


def run(
    events: Events,
    settings: FilterSettings,
    family: str = "unknown",
    gnss_delay: float | None = None,
) -> Solution:
    """Take the unscented filter through a recording.

    Args:
        events: In any order.
        settings: Those of the daemon.
        family: What ``auto`` means in them.
        gnss_delay: Delay that the log itself declares, s.

    Raises:
        LogError: No inertial samples, no fixes, no heading, or an end before the filter begins.
    """
    path = Course(events, settings, family, gnss_delay)
    setup = path.setup()
    tried = Unscented(setup)
    solution = course.run("ukf", tried, path, setup)
    if not tried.mended:
        return solution
    note = f"the covariance was not positive definite {tried.mended} times and was mended"
    return replace(solution, notes=(*solution.notes, note))
