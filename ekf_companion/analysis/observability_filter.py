"""An error-state filter, with the covariances and Gramians by which observability is judged.

The filter is that of the textbook, with its start and its gate. The additional covariances begin
with what is not known, whatever a rest has shown: what becomes known is due to the flight. Between
two aids the transition is accumulated, and the covariances are predicted in one step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.analysis.observability_motion import MotionRecorder
from ekf_companion.errors import LogError
from ekf_companion.filters.gate import Decision
from ekf_companion.filters.observation import Azimuth, Observation, Velocity, reset
from ekf_companion.filters.sequence import Setup
from ekf_companion.filters.strapdown import (
    ATT,
    Earth,
    Interval,
    N,
    Nominal,
    integrate_strapdown,
    transition,
)
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

STEP_NS = 500_000_000
"""Length of a step, after which the covariances are recorded."""
REFUSED = 0.05
"""Share of refused measurements of an aid above which a note tells the user."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Step:
    """The result of a step; errors of attitude in P and the sigmas are about level axes."""

    t_ns: int
    """End of the step."""
    Phi: Array
    """Transition over the step, shape (15, 15)."""
    W: Array
    """Gramian of the step, referred to its start, shape (15, 15)."""
    to_level: Array
    """:func:`to_level_axes` at its start."""
    P: Array
    """Covariance at the end, shape (15, 15)."""
    rest: Array
    """One sigma at the end if the vehicle had stood still in its first attitude, shape (15,)."""
    free_heading: float
    """One sigma of the heading without heading aids, rad."""


def to_level_axes(state: Nominal) -> Array:
    """Return the matrix from errors in b to those about level forward, right and down axes."""
    C_nb = so3.to_matrix(state.q_nb)
    yaw = float(np.arctan2(C_nb[1, 0], C_nb[0, 0]))
    T = np.eye(N)
    T[ATT, ATT] = so3.to_matrix(so3.from_euler(0.0, 0.0, yaw)).T @ C_nb
    return T


def is_field(aid: Azimuth) -> bool:
    """Return whether a magnetic field was measured, and not the heading of the forward axis."""
    return bool(np.abs(aid.seen_b[1:]).max() > 0.0)


class Covariance:
    """A covariance that is predicted and corrected."""

    def __init__(self, P: Array) -> None:
        self.P = P.copy()

    def predict(self, Phi: Array, Q: Array) -> None:
        """Predict it over an interval."""
        self.P = Phi @ self.P @ Phi.T + Q

    def correct(self, white: Array) -> None:
        """Fuse rows of a whitened Jacobian, whose noise has unit covariance, shape (m, 15)."""
        for h in white:
            Ph = self.P @ h
            self.P = self.P - np.outer(Ph, Ph / (1.0 + h @ Ph))


class ObservabilityFilter:
    """The error-state filter along a recording, and what it records of each step."""

    def __init__(self, setup: Setup, P: Array, *, is_gated: bool = True) -> None:
        """Start at the first estimate.

        P is the covariance of what is not known before the flight, shape (15, 15). What the gate
        refuses is not fused or, if not ``is_gated``, only counted.
        """
        self._setup, self._is_gated = setup, is_gated
        self._state = setup.start.state
        self.begin_ns = setup.start.t_ns
        """Time of the first estimate."""
        self._own = Covariance(setup.start.P)
        self._full = Covariance(P)
        self._free = Covariance(P)
        self._rest = _AtRest(setup, P)
        self._Phi, self._Q, self._dt = np.eye(N), np.zeros((N, N)), 0.0
        self._begin_step(setup.start.t_ns)
        self._fields, self._slope = 0, 0.0
        self.motion = MotionRecorder()
        self.steps: list[Step] = []
        self.first_ns: dict[str, int] = {}
        """When each aid was first fused."""

    def _begin_step(self, t_ns: int) -> None:
        self._step_ns = t_ns
        self._to_level = to_level_axes(self._state)
        self._Phi_step, self._W = np.eye(N), np.zeros((N, N))

    def predict(self, over: Interval) -> None:
        """Predict the state over an interval; accumulate the transition."""
        before, earth = self._state, self._setup.earth
        Phi = transition(before, over, earth)
        self._state = integrate_strapdown(before, over, earth)
        self.motion.add_specific_force(self._state.vel_n - before.vel_n)
        self._Q = Phi @ self._Q @ Phi.T + self._setup.noise.covariance(over.dt)
        self._Phi = Phi @ self._Phi
        self._dt += over.dt

    def correct(self, t_ns: int, aid: Observation) -> None:
        """Fuse an aid unless the gate refuses it; a refused one adds no information."""
        self._catch_up()
        if isinstance(aid, Azimuth):
            if not aid.is_usable(self._state):
                return
            aid = self._smoothed(aid)
        z, H, R = aid.innovation(self._state), aid.jacobian(self._state), aid.covariance()
        PHt = self._own.P @ H.T
        S = H @ PHt + R
        decision = self._setup.gate.test(aid.aid, t_ns, z, S)
        if decision is Decision.REFUSED and self._is_gated:
            return
        is_reset = decision is Decision.RESET and self._is_gated
        K, inflation = reset(aid, self._state, self._setup.gate.patience[aid.aid])
        K = K if is_reset else np.linalg.solve(S, PHt.T).T
        self.first_ns.setdefault(aid.aid, t_ns)
        whiten = np.linalg.inv(np.linalg.cholesky(R))
        white = whiten @ H
        self._rest.correct(whiten, aid, self._state)
        if is_reset:
            left = np.eye(N) - K @ H
            self._own.P = left @ self._own.P @ left.T + K @ R @ K.T + inflation
        else:
            self._own.correct(white)
        self._full.correct(white)
        if not isinstance(aid, Azimuth):
            self._free.correct(white)
        at_start = white @ self._Phi_step
        self._W += at_start.T @ at_start
        self._state = self._state.plus(K @ z)

    def end_sample(self, t_ns: int) -> None:
        """Record the motion at an inertial sample, and end a step that is long enough.

        Raises:
            LogError: The estimate is no longer finite.
        """
        self.motion.add(t_ns, self._state)
        if t_ns - self._step_ns < STEP_NS:
            return
        self._catch_up()
        T = to_level_axes(self._state)
        P, free = T @ self._full.P @ T.T, T @ self._free.P @ T.T
        if not (np.isfinite(P).all() and np.isfinite(self._state.vel_n).all()):
            raise LogError("the filter diverges along this recording; its Jacobians say nothing")
        self.steps.append(
            Step(
                t_ns=t_ns,
                Phi=self._Phi_step,
                W=self._W,
                to_level=self._to_level,
                P=P,
                rest=self._rest.sigma,
                free_heading=float(np.sqrt(free[2, 2])),
            )
        )
        self._begin_step(t_ns)

    def _smoothed(self, aid: Azimuth) -> Azimuth:
        """Return an aid with the same innovation and a Jacobian without the noise of the field.

        The noise would appear as a dip that differs from sample to sample, which would seem to
        show tilt: so the mean of the dip until now is used.
        """
        if not is_field(aid):
            return aid.about(self._state)
        C_nb = so3.to_matrix(self._state.q_nb)
        seen_n = C_nb @ aid.seen_b
        self._fields += 1
        slope = float(seen_n[2] / np.hypot(seen_n[0], seen_n[1]))
        self._slope += (slope - self._slope) / self._fields
        expected_n = np.array([np.cos(aid.azimuth), np.sin(aid.azimuth), self._slope])
        apart = float(aid.innovation(self._state)[0])
        return replace(aid, seen_b=C_nb.T @ expected_n, azimuth=aid.azimuth + apart)

    def notes(self) -> tuple[str, ...]:
        """Return notes on the aids that were refused often."""
        done = "were refused by the filter, and count as not made"
        text = []
        if not self._is_gated:
            done = "would have been"
            text.append("with its gate the filter loses its way here: nothing is refused")
        text += [
            f"{refused} of {fused + refused} measurements of {aid} {done}"
            for aid, (fused, refused) in self._setup.gate.counts.items()
            if refused > REFUSED * (fused + refused)
        ]
        if self.is_lost:
            text.append("the filter is not on this flight's path; do not rely on what follows")
        return tuple(text)

    @property
    def is_lost(self) -> bool:
        """Whether the gate refused most of an aid."""
        return self.refused_share > 0.5

    @property
    def refused_share(self) -> float:
        """Return the largest share of an aid that the gate refused."""
        counts = self._setup.gate.counts.values()
        return max((refused / (fused + refused) for fused, refused in counts), default=0.0)

    def _catch_up(self) -> None:
        if self._dt == 0.0:
            return
        self._own.predict(self._Phi, self._Q)
        self._full.predict(self._Phi, self._Q)
        self._free.predict(self._Phi, self._Q)
        self._rest.predict(self._dt)
        self._Phi_step = self._Phi @ self._Phi_step
        self._Phi, self._Q, self._dt = np.eye(N), np.zeros((N, N)), 0.0


class _AtRest:
    """The covariance of a vehicle that stands still in its first attitude, with the same aids."""

    def __init__(self, setup: Setup, P: Array) -> None:
        q_nb = setup.start.state.q_nb
        self._state = Nominal(q_nb=q_nb, vel_n=np.zeros(3), pos_n=np.zeros(3))
        self._earth, self._noise = Earth.flat(setup.earth.gravity), setup.noise
        self._C_nb = so3.to_matrix(q_nb)
        self._force_b = -self._earth.gravity * self._C_nb[2]
        self._to_level = to_level_axes(self._state)
        self._covariance = Covariance(P)
        self._known: dict[int, tuple[Array, Array]] = {}

    @property
    def sigma(self) -> Array:
        """Return one sigma, SI, about level axes, shape (15,)."""
        P = self._to_level @ self._covariance.P @ self._to_level.T
        return np.asarray(np.sqrt(np.diagonal(P)))

    def predict(self, dt: float) -> None:
        """Predict over a time at rest, s."""
        key = round(dt * 1e6)
        if key not in self._known:
            still, force = np.zeros(3), self._force_b
            over = Interval(dt=dt, gyro0=still, gyro1=still, accel0=force, accel1=force)
            self._known[key] = (
                transition(self._state, over, self._earth),
                self._noise.covariance(dt),
            )
        self._covariance.predict(*self._known[key])

    def correct(self, whiten: Array, aid: Observation, state: Nominal) -> None:
        """Fuse the aid as the sensor at rest would have measured it, given the state in flight."""
        if isinstance(aid, Velocity):
            aid = replace(aid, swing_b=np.zeros(3))
        elif isinstance(aid, Azimuth):
            seen_n = so3.to_matrix(state.q_nb) @ aid.seen_b
            aid = replace(aid, seen_b=self._C_nb.T @ seen_n)
        self._covariance.correct(whiten @ aid.jacobian(self._state))
