"""The direct extended Kalman filter on Euler angles: what it carries is the state, not its error.

Each interval is one step of first order; the covariance is that of the state's own numbers
(:mod:`ekf_companion.filters.euler_motion`), its noise van Loan's. The rates of roll and yaw grow as
1 / cos(pitch): near 90 degrees of pitch the filter stops, and says so; what it estimated until
then stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import FilterSettings
from ekf_companion.filters import course as courses
from ekf_companion.filters import euler_article
from ekf_companion.filters.course import Course, Setup
from ekf_companion.filters.euler_motion import (
    ACCEL,
    ANGLES,
    GYRO,
    PITCH_LIMIT,
    SPEED,
    angle_rates,
    body_to_n,
    by_turn,
    covariance_in_n,
    derivative,
    from_nominal,
    jacobian,
    refuse_steep,
    to_nominal,
    van_loan,
)
from ekf_companion.filters.gate import Trust
from ekf_companion.filters.observation import Observation, reset
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Interval, N, Noise, Nominal
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]
Preset = Literal["corrected", "article"]


class Euler:
    """The filter with noise, gate and Earth as the other filters have them."""

    def __init__(self, setup: Setup, pitch_limit: float = PITCH_LIMIT) -> None:
        """Begin.

        Args:
            setup: As for the other filters.
            pitch_limit: Steeper, up or down, it stops, rad.

        Raises:
            FilterError: It begins steeper.
        """
        self._setup, self._limit = setup, pitch_limit
        self.x: Array = from_nominal(setup.start.state)
        """State, shape (15,)."""
        refuse_steep(self.x, pitch_limit)
        T = by_turn(self.x)
        self.P: Array = T @ setup.start.P @ T.T
        """Its covariance, shape (15, 15)."""

    @property
    def state(self) -> Nominal:
        """The estimate of now."""
        return to_nominal(self.x)

    def predict(self, over: Interval) -> None:
        """Carry the state by its rate of change at the start, the covariance by van Loan.

        Raises:
            FilterError: The pitch has become too steep.
        """
        x, earth = self.x, self._setup.earth
        rate_b = over.gyro - body_to_n(x).T @ earth.rate_n
        dx = derivative(x, rate_b, over.accel, earth.accel_n(self.state))
        F = jacobian(x, rate_b, over.accel)
        Phi, Q = van_loan(F, density(x, self._setup.noise), over.dt)
        self.x = x + dx * over.dt
        self.P = Phi @ self.P @ Phi.T + Q
        refuse_steep(self.x, self._limit)

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse aids one after the other, by the Joseph form.

        Raises:
            FilterError: The pitch has become too steep.
        """
        for aid in aids:
            now = self.state
            # An error in Euler angles as a turn in b, of which the aid has its Jacobian
            H = aid.jacobian(now) @ np.linalg.inv(by_turn(self.x))
            z, R = aid.innovation(now), aid.covariance()
            S = H @ self.P @ H.T + R
            trust = self._setup.gate.admits(aid.aid, t_ns, z, S)
            if trust is Trust.REFUSED:
                continue
            if trust is Trust.RESET:
                anew = reset(aid, now, self._setup.gate.patience(aid.aid))
                T = by_turn(self.x)
                K, inflation = T @ anew.gain, T @ anew.inflation @ T.T
            else:
                K, inflation = np.linalg.solve(S, H @ self.P).T, np.zeros((N, N))
            L = np.eye(N) - K @ H
            self.x = self.x + K @ z
            self.P = L @ self.P @ L.T + K @ R @ K.T + inflation
            refuse_steep(self.x, self._limit)

    def covariance(self) -> Array:
        """Return that of attitude (rotation vector in n), velocity, position (n), shape (9, 9)."""
        return covariance_in_n(self.x, self.P)


def density(x: Array, noise: Noise) -> Array:
    """Return the density of the noise's covariance, per second, shape (15, 15)."""
    E = np.asarray(angle_rates(x))
    Q = np.zeros((N, N))
    Q[ANGLES, ANGLES] = noise.gyro**2 * E @ E.T
    Q[SPEED, SPEED] = noise.accel**2 * np.eye(3)
    Q[GYRO, GYRO] = noise.gyro_walk**2 * np.eye(3)
    Q[ACCEL, ACCEL] = noise.accel_walk**2 * np.eye(3)
    return Q


def run(
    events: Events,
    settings: FilterSettings,
    family: str = "unknown",
    gnss_delay: float | None = None,
    preset: Preset = "corrected",
) -> Solution:
    """Take the filter through a recording.

    Args:
        events: In any order.
        settings: Those of the daemon; ``article`` takes the delays and sources only.
        family: What ``auto`` means in them.
        gnss_delay: Delay that the log itself declares, s.
        preset: ``corrected``: noise, gate and Earth as told; ``article``: the seed article's own
            constants and order, its two slips among them.

    Returns:
        The estimates; where the pitch became too steep, those until then, and a note.

    Raises:
        LogError: The recording offers no inertial samples, fixes or heading.
        FilterError: It begins too steep.
    """
    course = Course(events, settings, family, gnss_delay)
    if preset == "article":
        return euler_article.run(course)
    setup = course.setup()
    return courses.run("euler", Euler(setup), course, setup)
