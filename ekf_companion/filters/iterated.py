"""The iterated error-state filter of LINS and FAST-LIO, aided by fixes and a heading.

Each update is the least-squares problem of :mod:`ekf_companion.filters.gauss_newton`: measurements
and prior are linearised again at each iterate. All aids of one time are one update. In the
robocentric form the frame of :mod:`ekf_companion.filters.robocentric` moves to the body after each
update.

Source: Xu and Zhang 2021, "FAST-LIO", arXiv 2010.08196; Qin et al. 2020, "LINS",
arXiv 1907.02233.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from ekf_companion.errors import part_of
from ekf_companion.filters import gauss_newton
from ekf_companion.filters.gate import Decision
from ekf_companion.filters.gauss_newton import MAX_ITERATIONS, Correction, Form, Manifold, Rows
from ekf_companion.filters.observation import Observation
from ekf_companion.filters.robocentric import DOWN, FRAME_ATT, FRAME_POS, FULL, RobocentricState
from ekf_companion.filters.sequence import MeasurementSequence, Setup, run_sequence
from ekf_companion.filters.solution import Solution
from ekf_companion.filters.strapdown import Interval, N, Nominal, covariance_in_n
from ekf_companion.nav.arrays import Array

with part_of("filters", "filter iterated"):
    from scipy.linalg import block_diag

Frame = Literal["global", "robocentric"]
Gravity = Literal["known", "sphere"]

GRAVITY_STD = 0.02
"""One sigma of the direction of gravity if estimated, rad per axis: of a start levelled by an
accelerometer with a bias of 0.2 m/s^2."""


class Iterated:
    """Error-state filter with an update iterated to the least cost."""

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
        """Start at the first estimate; one iteration is the update of an extended Kalman filter.

        The frame ``robocentric`` is the body frame of the last update. With gravity on the
        ``sphere`` its direction is estimated too, whose one sigma, rad, is ``gravity_std``.
        """
        self._setup, self._frame = setup, frame
        self._form, self._iterations = form, max_iterations
        self.is_settled = True
        """Whether the last update converged within its iterations."""
        self._x = RobocentricState(local=setup.start.state, down_n=setup.earth.down_n)
        P = np.zeros((FULL, FULL))
        P[:N, :N] = setup.start.P
        P[DOWN, DOWN] = gravity_std * gravity_std * np.eye(2)
        if frame == "robocentric":
            self._x, G = self._x.recentred()
            P = G @ P @ G.T
        pose = range(FRAME_ATT.start, FRAME_POS.stop) if frame == "robocentric" else ()
        down = range(DOWN.start, DOWN.stop) if gravity == "sphere" else ()
        self._active = np.array([*range(N), *pose, *down])
        self._active_by_active = np.ix_(self._active, self._active)
        self.P: Array = P[self._active_by_active]
        """Covariance of the error state, shape (k, k); in the global frame with gravity known, of
        that of :mod:`ekf_companion.filters.strapdown`."""
        self._manifold = Manifold(
            plus=lambda x, dx: x.plus(self._full(dx)),
            minus=lambda x, y: x.minus(y)[self._active],
            jacobian=lambda x, y: x.jacobian(y)[self._active_by_active],
        )

    @property
    def state(self) -> Nominal:
        """Return the present estimate in n."""
        return self._x.in_n()

    @property
    def down_n(self) -> Array:
        """Return the direction of gravity, a unit vector in n."""
        return self._x.down_n

    def covariance(self) -> Array:
        """Return the covariance of attitude, velocity and position in n, shape (9, 9)."""
        if self._frame == "global":
            return covariance_in_n(self.P, self._x.local.q_nb)
        T = self._x.in_n_jacobian()[:, self._active]
        return covariance_in_n(T @ self.P @ T.T, self.state.q_nb)

    def predict(self, over: Interval) -> None:
        """Predict the estimate over an interval by the midpoint rule."""
        self._x, Phi = self._x.integrated(over, self._setup.earth)
        Phi = Phi[self._active_by_active]
        self.P = Phi @ self.P @ Phi.T
        self.P[:N, :N] += self._setup.noise.covariance(over.dt)

    def inflate(self, Q: Array) -> None:
        """Add to the covariance of the error state, shape (15, 15)."""
        self.P[:N, :N] += Q

    def correct(self, t_ns: int, aids: Sequence[Observation]) -> None:
        """Fuse the aids of one time that pass the gate in one update."""
        judged = [(aid, self._test(t_ns, aid)) for aid in aids]
        resets = [aid for aid, decision in judged if decision is Decision.RESET]
        accepted = [aid for aid, decision in judged if decision is Decision.FUSED]
        for aid in resets:
            self._reset(t_ns, aid)
        if accepted:
            found = self._solve(accepted)
            self._x, self.P, self.is_settled = found.state, found.P, found.is_settled
        if self._frame == "robocentric" and (accepted or resets):
            self._x, G = self._x.recentred()
            G = G[self._active_by_active]
            self.P = G @ self.P @ G.T

    def _reset(self, t_ns: int, aid: Observation) -> None:
        """Set what an aid measures to the measurement; in n, where it is a block of the state."""
        T = np.eye(len(self.P))
        T[:N] = self._x.in_n_jacobian()[:, self._active]
        z, H, R = self._rows([aid], self._x)[:3]
        K, inflation = self._setup.gate.reset(aid, self.state, t_ns)
        back = np.linalg.solve(T, np.eye(len(T), N))
        K, inflation = back @ K, back @ inflation @ back.T
        A = np.eye(len(self.P)) - K @ H
        before, self._x = self._x, self._x.plus(self._full(K @ z))
        self.P = gauss_newton.reset(
            A @ self.P @ A.T + K @ R @ K.T + inflation,
            self._manifold.jacobian(self._x, before),
        )

    def _test(self, t_ns: int, aid: Observation) -> Decision:
        """Test an aid by its innovation or, as models are not linear, by its least cost."""
        z, H, R = self._rows([aid], self._x)[:3]
        nis = float(z @ np.linalg.solve(H @ self.P @ H.T + R, z))
        gate = self._setup.gate
        if self._iterations > 1 and not gate.is_within(nis, len(z)):
            nis = min(nis, self._solve([aid]).cost)
        return gate.decide(aid.aid, t_ns, nis, len(z))

    def _solve(self, aids: Sequence[Observation]) -> Correction[RobocentricState]:
        return gauss_newton.correct(
            self._x,
            self.P,
            lambda x: self._rows(aids, x),
            self._manifold,
            form=self._form,
            max_iterations=self._iterations,
        )

    def _rows(self, aids: Sequence[Observation], x: RobocentricState) -> Rows:
        state, T = x.in_n(), x.in_n_jacobian()[:, self._active]
        z = np.concatenate([aid.innovation(state) for aid in aids])
        H = np.concatenate([aid.jacobian(state) for aid in aids]) @ T
        return Rows(z, H, block_diag(*(aid.covariance() for aid in aids)))

    def _full(self, dx: Array) -> Array:
        full = np.zeros(FULL)
        full[self._active] = dx
        return full


def run(
    sequence: MeasurementSequence, *, frame: Frame = "global", gravity: Gravity = "known"
) -> Solution:
    """Run the filter over a recording, with frame and gravity as for :class:`Iterated`.

    Raises:
        LogError: The recording ends before the filter can start.
    """
    setup = sequence.setup()
    tried = Iterated(setup, frame=frame, gravity=gravity)
    name = "iterated" if frame == "global" else "iterated robocentric"
    return run_sequence(name, tried, sequence, setup)
