"""The iterated error-state filter of LINS and FAST-LIO, aided by fixes and a heading.

Each update is the least-squares problem of :mod:`ekf_companion.filters.gauss_newton`: what is
measured is linearised anew at each iterate, and the prior is seen from there. All aids of one time
are one update. Robocentric, the state is that of :mod:`ekf_companion.filters.anchored`, its
anchor set anew after each update.

Source: Xu and Zhang 2021, "FAST-LIO", arXiv 2010.08196; Qin et al. 2020, "LINS",
arXiv 1907.02233.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from ekf_companion.core.settings import FilterSettings
from ekf_companion.filters import gauss_newton
from ekf_companion.filters.anchored import ANCHOR_ATT, ANCHOR_POS, DOWN, FULL, Anchored
from ekf_companion.filters.course import Course, Setup
from ekf_companion.filters.course import run as run_filter
from ekf_companion.filters.gate import Trust
from ekf_companion.filters.gauss_newton import MAX_ITERATIONS, Correction, Form, Manifold, Rows
from ekf_companion.filters.observation import Observation, reset
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Interval, N, Nominal, in_n
from ekf_companion.nav.measurements import Events

Array = npt.NDArray[np.float64]
Frame = Literal["global", "robocentric"]
Gravity = Literal["known", "sphere"]

GRAVITY_STD = 0.02
"""One sigma of a direction of gravity that is estimated, rad per axis: of a start that was levelled
by an accelerometer with a bias of 0.2 m/s^2."""


class Iterated:
    """Error-state filter whose update is iterated to the least cost."""

    def __init__(
        self,
        setup: Setup,
        *,
        frame: Frame = "global",
        gravity: Gravity = "known",
        form: Form = "auto",
        max_iterations: int = MAX_ITERATIONS,
        gravity_std: float = GRAVITY_STD,
    ) -> None:
        """Begin.

        Args:
            setup: First estimate, the Earth, the noise, the gate.
            frame: ``robocentric``: relative to the body frame of the last update.
            gravity: ``sphere``: its direction is estimated beside the attitude, its size is known.
            form: Of the gain.
            max_iterations: 1: the linear step of an extended Kalman filter.
            gravity_std: One sigma of the direction of gravity where it is estimated, rad.
        """
        self._setup, self._frame = setup, frame
        self._form, self._iterations = form, max_iterations
        self.is_settled = True
        """Whether the last update came to an end within its iterations."""
        self._x = Anchored(local=setup.start.state, down_n=setup.earth.down_n)
        P = np.zeros((FULL, FULL))
        P[:N, :N] = setup.start.P
        P[DOWN, DOWN] = gravity_std * gravity_std * np.eye(2)
        if frame == "robocentric":
            self._x, G = self._x.re_anchored()
            P = G @ P @ G.T
        anchor = range(ANCHOR_ATT.start, ANCHOR_POS.stop) if frame == "robocentric" else ()
        down = range(DOWN.start, DOWN.stop) if gravity == "sphere" else ()
        self._active = np.array([*range(N), *anchor, *down])
        self._active_by_active = np.ix_(self._active, self._active)
        self.P: Array = P[self._active_by_active]
        """Covariance of the error state, shape (k, k): in the global frame with gravity known, of
        the 15 of :mod:`ekf_companion.filters.strapdown`."""
        self._manifold = Manifold(
            plus=lambda x, dx: x.plus(self._full(dx)),
            minus=lambda x, y: x.minus(y)[self._active],
            jacobian=lambda x, y: x.jacobian(y)[self._active_by_active],
        )

    @property
    def state(self) -> Nominal:
        """Return the estimate of now, in n."""
        return self._x.in_n()

    @property
    def down_n(self) -> Array:
        """Return the direction of gravity, a unit vector in n."""
        return self._x.down_n

    def covariance(self) -> Array:
        """Return that of attitude (in n), velocity and position, shape (9, 9)."""
        if self._frame == "global":
            return in_n(self.P, self._x.local.q_nb)
        T = self._x.in_n_jacobian()[:, self._active]
        return in_n(T @ self.P @ T.T, self.state.q_nb)

    def predict(self, over: Interval) -> None:
        """Carry the estimate over an interval by the midpoint rule."""
        self._x, Phi = self._x.moved(over, self._setup.earth)
        Phi = Phi[self._active_by_active]
        self.P = Phi @ self.P @ Phi.T
        self.P[:N, :N] += self._setup.noise.covariance(over.dt)

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse those aids of one time that the gate lets through, together."""
        trusted = [(aid, self._judge(t_ns, aid)) for aid in aids]
        resets = [aid for aid, trust in trusted if trust is Trust.RESET]
        believed = [aid for aid, trust in trusted if trust is Trust.FUSED]
        for aid in resets:
            self._reset(aid)
        if believed:
            found = self._solve(believed)
            self._x, self.P, self.is_settled = found.state, found.P, found.is_settled
        if self._frame == "robocentric" and (believed or resets):
            self._x, G = self._x.re_anchored()
            G = G[self._active_by_active]
            self.P = G @ self.P @ G.T

    def _reset(self, aid: Observation) -> None:
        """Take what an aid shows from it alone; in n, where it is a block of the error state."""
        T = np.eye(len(self.P))
        T[:N] = self._x.in_n_jacobian()[:, self._active]
        z, H, R = self._rows([aid], self._x)[:3]
        anew = reset(aid, self.state, self._setup.gate.patience(aid.aid))
        back = np.linalg.solve(T, np.eye(len(T), N))
        K, inflation = back @ anew.gain, back @ anew.inflation @ back.T
        left = np.eye(len(self.P)) - K @ H
        before, self._x = self._x, self._x.plus(self._full(K @ z))
        self.P = gauss_newton.reset(
            left @ self.P @ left.T + K @ R @ K.T + inflation,
            self._manifold.jacobian(self._x, before),
        )

    def _judge(self, t_ns: int, aid: Observation) -> Trust:
        """Judge an aid by its innovation or, where it bends, by what is left of it at best."""
        z, H, R = self._rows([aid], self._x)[:3]
        nis = float(z @ np.linalg.solve(H @ self.P @ H.T + R, z))
        gate = self._setup.gate
        if self._iterations > 1 and not gate.allows(nis, len(z)):
            nis = min(nis, self._solve([aid]).cost)
        return gate.judges(aid.aid, t_ns, nis, len(z))

    def _solve(self, aids: Sequence[Observation]) -> Correction[Anchored]:
        return gauss_newton.correct(
            self._x,
            self.P,
            lambda x: self._rows(aids, x),
            self._manifold,
            form=self._form,
            max_iterations=self._iterations,
        )

    def _rows(self, aids: Sequence[Observation], x: Anchored) -> Rows:
        state, T = x.in_n(), x.in_n_jacobian()[:, self._active]
        z = np.concatenate([aid.innovation(state) for aid in aids])
        H = np.concatenate([aid.jacobian(state) for aid in aids]) @ T
        R, first = np.zeros((len(z), len(z))), 0
        for block in (aid.covariance() for aid in aids):
            rows = slice(first, first := first + len(block))
            R[rows, rows] = block
        return Rows(z, H, R)

    def _full(self, dx: Array) -> Array:
        full = np.zeros(FULL)
        full[self._active] = dx
        return full


def run(
    events: Events,
    settings: FilterSettings,
    family: str = "unknown",
    gnss_delay: float | None = None,
    *,
    frame: Frame = "global",
    gravity: Gravity = "known",
) -> Solution:
    """Take the filter through a recording.

    Args:
        events: In any order.
        settings: The same as the daemon's.
        family: What ``auto`` means in them.
        gnss_delay: Delay that the log itself declares, s.
        frame: ``global`` or ``robocentric``.
        gravity: ``known``: down; ``sphere``: its direction is estimated.

    Raises:
        LogError: There are no inertial samples, no fixes or no heading.
    """
    course = Course(events, settings, family, gnss_delay)
    setup = course.setup()
    tried = Iterated(setup, frame=frame, gravity=gravity)
    name = "iterated" if frame == "global" else "iterated robocentric"
    return run_filter(name, tried, course, setup)
