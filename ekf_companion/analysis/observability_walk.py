"""The error-state filter along a recording, and beside it what its Jacobians say of its states.

The filter is that of the textbook, with its start and its gate. The covariances beside it begin
with what is not known, whatever a rest has shown: what comes to be known is by the flight. Between
two aids the transition is gathered, and the covariances follow at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ekf_companion.analysis.observability_motion import Track
from ekf_companion.errors import LogError
from ekf_companion.filters.course import Setup
from ekf_companion.filters.gate import Trust
from ekf_companion.filters.observation import Azimuth, Observation, Velocity, reset
from ekf_companion.filters.strapdown import ATT, Earth, Interval, N, Nominal, move, transition
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

STEP_NS = 500_000_000
"""From one note on the states to the next."""
REFUSED = 0.05
"""Share of refused measurements of an aid above which the user should know."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Cell:
    """What a step shows; the errors of attitude in P and the sigmas are about level axes."""

    t_ns: int
    """Its end."""
    Phi: Array
    """Over it, shape (15, 15)."""
    W: Array
    """Its Gramian, referred to its start, shape (15, 15)."""
    level: Array
    """Errors in b to those about level axes, at its start, shape (15, 15)."""
    P: Array
    """Covariance at its end, shape (15, 15)."""
    rest: Array
    """One sigma then, if the vehicle had stood as it began, shape (15,)."""
    free_heading: float
    """One sigma of the heading without the aids that show north, rad."""


def level(state: Nominal) -> Array:
    """Give what turns errors in b into those about forward, right (level) and down, (15, 15)."""
    C_nb = so3.to_matrix(state.q_nb)
    yaw = float(np.arctan2(C_nb[1, 0], C_nb[0, 0]))
    T = np.eye(N)
    T[ATT, ATT] = so3.to_matrix(so3.from_euler(0.0, 0.0, yaw)).T @ C_nb
    return T


def is_field(aid: Azimuth) -> bool:
    """Whether what is seen is a magnetic field; else it is the axis that points forward."""
    return bool(np.abs(aid.seen_b[1:]).max() > 0.0)


class Covariance:
    """A covariance that is carried along."""

    def __init__(self, P: Array) -> None:
        self.P = P.copy()

    def predict(self, Phi: Array, Q: Array) -> None:
        """Carry it over an interval."""
        self.P = Phi @ self.P @ Phi.T + Q

    def correct(self, white: Array) -> None:
        """Fuse rows of a Jacobian whose noise is white and of unit variance, shape (m, 15)."""
        for h in white:
            toward = self.P @ h
            self.P = self.P - np.outer(toward, toward / (1.0 + h @ toward))

    def weigh(self, K: Array, H: Array, R: Array) -> None:
        """Fuse rows by a gain that is not the one of least variance."""
        left = np.eye(N) - K @ H
        self.P = left @ self.P @ left.T + K @ R @ K.T


class Walk:
    """The filter on its way."""

    def __init__(self, setup: Setup, P: Array, *, is_gated: bool = True) -> None:
        """Begin.

        Args:
            setup: Where from.
            P: What is not known before, shape (15, 15).
            is_gated: What the gate refuses is not fused; else it only counts.
        """
        self._setup, self._is_gated = setup, is_gated
        self._state = setup.start.state
        self.begin_ns = setup.start.t_ns
        """When it begins."""
        self._own = Covariance(setup.start.P)
        self._full = Covariance(P)
        self._free = Covariance(P)
        self._rest = _Rest(setup, P)
        self._Phi, self._Q, self._dt = np.eye(N), np.zeros((N, N)), 0.0
        self._begin(setup.start.t_ns)
        self._fields, self._slope = 0, 0.0
        self.track = Track()
        self.cells: list[Cell] = []
        self.first_ns: dict[str, int] = {}
        """When each aid was first fused."""

    def _begin(self, t_ns: int) -> None:
        self._cell_ns = t_ns
        self._level = level(self._state)
        self._Phi_cell, self._W = np.eye(N), np.zeros((N, N))

    def predict(self, over: Interval) -> None:
        """Carry the state over an interval."""
        before, earth = self._state, self._setup.earth
        Phi = transition(before, over, earth)
        self._state = move(before, over, earth)
        self.track.drive(self._state.vel_n - before.vel_n)
        self._Q = Phi @ self._Q @ Phi.T + self._setup.noise.covariance(over.dt)
        self._Phi = Phi @ self._Phi
        self._dt += over.dt

    def correct(self, t_ns: int, aid: Observation) -> None:
        """Fuse an aid, unless the gate refuses it: then it shows nothing."""
        self._catch_up()
        if isinstance(aid, Azimuth):
            if not aid.is_seen(self._state):
                return
            aid = self._calm(aid)
        z, H, R = aid.innovation(self._state), aid.jacobian(self._state), aid.covariance()
        toward = self._own.P @ H.T
        S = H @ toward + R
        trust = self._setup.gate.admits(aid.aid, t_ns, z, S)
        if trust is Trust.REFUSED and self._is_gated:
            return
        is_reset = trust is Trust.RESET and self._is_gated
        anew = reset(aid, self._state, self._setup.gate.patience(aid.aid))
        K = anew.gain if is_reset else np.linalg.solve(S, toward.T).T
        self.first_ns.setdefault(aid.aid, t_ns)
        whiten = np.linalg.inv(np.linalg.cholesky(R))
        white = whiten @ H
        self._rest.correct(whiten, aid, self._state)
        if is_reset:
            self._own.weigh(K, H, R)
            self._own.P += anew.doubt
        else:
            self._own.correct(white)
        self._full.correct(white)
        if not isinstance(aid, Azimuth):
            self._free.correct(white)
        seen = white @ self._Phi_cell
        self._W += seen.T @ seen
        self._state = self._state.plus(K @ z)

    def close(self, t_ns: int) -> None:
        """Note the motion at an inertial sample, and end a step that is long enough.

        Raises:
            LogError: The estimate is no number any more.
        """
        self.track.add(t_ns, self._state)
        if t_ns - self._cell_ns < STEP_NS:
            return
        self._catch_up()
        T = level(self._state)
        P, free = T @ self._full.P @ T.T, T @ self._free.P @ T.T
        if not (np.isfinite(P).all() and np.isfinite(self._state.vel_n).all()):
            raise LogError("the filter diverges along this recording; its Jacobians say nothing")
        self.cells.append(
            Cell(
                t_ns=t_ns,
                Phi=self._Phi_cell,
                W=self._W,
                level=self._level,
                P=P,
                rest=self._rest.sigma,
                free_heading=float(np.sqrt(free[2, 2])),
            )
        )
        self._begin(t_ns)

    def _calm(self, aid: Azimuth) -> Azimuth:
        """Give the same innovation with a Jacobian that does not shake with what is seen.

        The noise of a field would turn up as a dip that differs from sample to sample, which would
        seem to show tilt: so the mean of it until now counts.
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
        """Say which aids were refused often."""
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
        """Whether it was seldom where the aids said."""
        return self.doubt > 0.5

    @property
    def doubt(self) -> float:
        """Give the largest share of an aid that the gate refused."""
        counts = self._setup.gate.counts.values()
        return max((refused / (fused + refused) for fused, refused in counts), default=0.0)

    def _catch_up(self) -> None:
        if self._dt == 0.0:
            return
        self._own.predict(self._Phi, self._Q)
        self._full.predict(self._Phi, self._Q)
        self._free.predict(self._Phi, self._Q)
        self._rest.predict(self._dt)
        self._Phi_cell = self._Phi @ self._Phi_cell
        self._Phi, self._Q, self._dt = np.eye(N), np.zeros((N, N)), 0.0


class _Rest:
    """The covariance of one that stands as it began, aided alike."""

    def __init__(self, setup: Setup, P: Array) -> None:
        q_nb = setup.start.state.q_nb
        self._state = Nominal(q_nb=q_nb, vel_n=np.zeros(3), pos_n=np.zeros(3))
        self._earth, self._noise = Earth.flat(setup.earth.gravity), setup.noise
        self._C_nb = so3.to_matrix(q_nb)
        self._force_b = -self._earth.gravity * self._C_nb[2]
        self._level = level(self._state)
        self._covariance = Covariance(P)
        self._known: dict[int, tuple[Array, Array]] = {}

    @property
    def sigma(self) -> Array:
        """Give one sigma, SI, about level axes, shape (15,)."""
        P = self._level @ self._covariance.P @ self._level.T
        return np.asarray(np.sqrt(np.diagonal(P)))

    def predict(self, dt: float) -> None:
        """Stand for so long."""
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
        """Take what an aid of the flight, where its state was that, would have shown here."""
        if isinstance(aid, Velocity):
            aid = replace(aid, swing_b=np.zeros(3))
        elif isinstance(aid, Azimuth):
            seen_n = so3.to_matrix(state.q_nb) @ aid.seen_b
            aid = replace(aid, seen_b=self._C_nb.T @ seen_n)
        self._covariance.correct(whiten @ aid.jacobian(self._state))
