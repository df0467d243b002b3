"""Fit mounting, unit and delay of a radar to the inertial samples.

The velocity by radial speeds changes as the inertial samples say: from one time to another, in
axes that the gyro carries along,

    C2 (R v2 - s w2 x l) - C1 (R v1 - s w1 x l) = s (integral of C f - g (t2 - t1))

with R and l the mounting and s the unit: negative where speeds are positive towards the sensor, or
where one axis is mirrored, which is the same. Pieces that follow each other share the direction of
gravity, which leaves with their mean. The noise is that of the radar, on the left: so no scale is
made small by it. Where the vehicle does not accelerate nothing is shown, and nothing changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from ekf_companion.lidar.doppler import EgoVelocity
from ekf_companion.lidar.readers.motion import attitudes, every_axes
from ekf_companion.lidar.recording import InertialSamples, Mounting
from ekf_companion.lidar.state import exp
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices

PIECE = 0.3
"""s: over it a velocity changes by more than its noise, and a wrong bias of the gyro turns it by
less. From 0.2 to 0.6 s a recorded walk shows the same mounting and delay."""
PIECES = 13
"""That follow each other and share the direction of gravity: over 4 s a gyro bias of 0.01 rad/s
turns it by 2 deg."""
LEAST = 24
"""Pieces of which anything is found: some five times as many rows as unknowns."""
LATENESS = np.arange(-0.3, 0.3001, 0.02)
"""Delays that are tried, s: a scan arrives after one or two periods, of a recorded walk 0.12 s."""
ROUNDS = 8
"""Of Gauss-Newton, from at most 45 deg away: then no digit changes that is shown."""
STEP = 1e-4
"""Of the differences by which the rotation is refined, rad."""
SIGMAS = 5.0
"""By which a mounting that is known, signs as usual, or a delay of none must miss to be wrong: as
the clock of poses beside a log, where of thousands that are tried one reaches 4 by chance."""
UNIT_SIGMA = 0.2
"""Relative sigma of the unit up to which it counts as shown: its sign then is."""
NO_AXIS = 1e-3
"""Information along an axis of the radar, of the largest, below which it has none: no elevation."""
LEAST_UNIT = 1e-2
"""Size of a unit whose sign a start does not show."""
TAIL = 27.0
"""Square of a piece in its sigmas at which it has half its weight: three for each axis."""
POSITION_SIGMA = 0.1
"""m, on each axis, of a radar on a vehicle that fits a hand."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How the radar is turned."""

    rotation: Array
    """Radar to body."""
    unit: float
    """Of its velocities, 1 for m/s; negative where speeds are positive towards the sensor."""
    delay: float
    """s, added to the stamps of the scans."""
    P: Array
    """Of rotation, a vector in the radar's frame, and logarithm of the unit, shape (4, 4)."""
    delay_sigma: float
    cost: float
    """Sum of the squares of what is left of the changes of velocity, in their sigmas."""
    left: float
    """Share of them that is left."""
    freedom: int
    """Of the sum: rows less unknowns."""

    @property
    def sigma(self) -> float:
        """Return the largest sigma of the rotation, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.P[:3, :3])[-1]))

    @property
    def is_seen(self) -> bool:
        """Return whether the motion shows the unit, and with it the sign."""
        return float(self.P[3, 3]) < UNIT_SIGMA**2

    def apart(self, rotation: Array) -> float:
        """Return the angle to another rotation, rad."""
        return float(np.linalg.norm(so3.log(so3.from_matrix(rotation.T @ self.rotation))))

    @property
    def noise(self) -> float:
        """Return the variance of velocities as a multiple of what their points say, 1 at least."""
        return max(1.0, self.cost / self.freedom)

    def is_better(self, other: Fit) -> bool:
        """Return whether less is left by more than chance."""
        return other.cost - self.cost > SIGMAS**2 * self.noise


def find(
    found: list[EgoVelocity], inertial: InertialSamples, mounting: Mounting | None
) -> Fit | None:
    """Return how a radar is turned and late by its velocities.

    None: there are too few, or they have two axes only, into which any change can be turned.

    A mounting that is known, and speeds that are positive away, hold unless the motion denies them
    decisively: what it does not show, as which side is left of a vehicle that never moves there,
    it must not change.
    """
    shown = np.linalg.eigvalsh(sum(one.information for one in found))
    if shown[0] < NO_AXIS * shown[-1]:
        return None
    carried = _Carried.of(inertial)
    lever = np.zeros(3) if mounting is None else mounting.position
    known = [] if mounting is None else [mounting.rotation]
    every = [*known, *_onto_axes()]

    def fit_at(delay: float, known: list[Array]) -> Fit | None:
        """Return the fit at a delay: of what is known, or of any where it is decisively better."""
        pieces, best = _Pieces.of(found, carried, delay, lever), None
        if pieces is None:
            return None
        for rotations, sign in ((known, 1.0), (known, -1.0), (every, 1.0), (every, -1.0)):
            for other in pieces.fits(rotations, sign):
                if best is None or other.is_better(best):
                    best = other
        return None if best is None else replace(best, delay=delay)

    tried = [fit_at(delay, []) for delay in LATENESS.tolist()]
    costs = np.array([np.inf if one is None else one.cost for one in tried])
    best = int(np.clip(np.argmin(costs), 1, len(costs) - 2))
    if not np.isfinite(costs[best - 1 : best + 2]).all():
        return None
    before, here, after = costs[best - 1 : best + 2].tolist()
    step, bend = float(LATENESS[1] - LATENESS[0]), before - 2.0 * here + after
    delay, sigma = float(LATENESS[best]), np.inf
    if bend > 0:
        delay += 0.5 * step * float(np.clip((before - after) / bend, -1.0, 1.0))
    fit, plain = fit_at(delay, known), fit_at(0.0, known)
    if fit is None or (plain is not None and not fit.is_better(plain)):
        fit = plain
    if fit is not None and bend > 0:
        sigma = step * np.sqrt(2.0 * fit.noise / bend)
    return None if fit is None else replace(fit, delay_sigma=float(sigma))


@dataclass(frozen=True, slots=True, eq=False)
class _Carried:
    """The gyro's attitude and the integral of the force in its axes."""

    stamp: Array
    attitude: Array
    """Quaternions w, x, y, z, shape (n, 4)."""
    force: Array
    """m/s, shape (n, 3)."""
    rate: Array
    """rad/s, shape (n, 3)."""

    @classmethod
    def of(cls, inertial: InertialSamples) -> _Carried:
        q = so3.normalise(attitudes(inertial.stamp[None], inertial.gyro[None])[0])
        force = so3.rotate(q, inertial.accel)
        steps = 0.5 * (force[1:] + force[:-1]) * np.diff(inertial.stamp)[:, None]
        whole = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        return cls(inertial.stamp, q, whole, inertial.gyro)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Return attitude matrices, integrals of the force and rates at times."""
        q = np.stack([np.interp(t, self.stamp, one) for one in self.attitude.T], axis=1)
        force = np.stack([np.interp(t, self.stamp, one) for one in self.force.T], axis=1)
        rate = np.stack([np.interp(t, self.stamp, one) for one in self.rate.T], axis=1)
        return so3.to_matrix(so3.normalise(q)), force, rate


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Velocities of the radar at both ends of pieces, and how the inertial samples change."""

    vel: tuple[Array, Array]
    """m/s, in the radar's axes, at both ends, shape (n, 3) each."""
    C: tuple[Array, Array]
    """Body to the axes that the gyro carries along, shape (n, 3, 3) each."""
    rate: tuple[Array, Array]
    """Of the body, rad/s, shape (n, 3) each."""
    span: Array
    """s, shape (n,)."""
    block: Indices
    """That shares a direction of gravity, shape (n,)."""
    change: Array
    """Mean force less that of the block, m/s^2, shape (n, 3)."""
    weight: Array
    """Inverse of the variance of each of its axes by the radar, s^4/m^2, shape (n,)."""
    lever: Array
    """Of the radar on the inertial sensor as it is said to be, m."""

    @classmethod
    def of(
        cls, found: list[EgoVelocity], carried: _Carried, delay: float, lever: Array
    ) -> _Pieces | None:
        """Return the pieces between scans at a delay; None: too few."""
        t = np.array([one.stamp for one in found])
        # The same scans at each delay: costs of others are not to be compared
        first, last = carried.stamp[0] - LATENESS[0], carried.stamp[-1] - LATENESS[-1]
        ends = list[int]()
        for k in np.flatnonzero((t > first) & (t < last)).tolist():
            # To half a scan
            if not ends or t[k] - t[ends[-1]] >= PIECE - 0.05:
                ends.append(k)
        k = np.array(ends, np.int64)
        span = np.diff(t[k])
        good = np.flatnonzero(span < 2.0 * PIECE)
        if len(good) < LEAST:
            return None
        C, force, rate = carried.at(t[k] + delay)
        vel = np.array([found[index].vel for index in ends])
        block = np.arange(len(span))[good] // PIECES
        change = _less_mean((np.diff(force, axis=0) / span[:, None])[good], block)
        P = np.linalg.pinv(np.array([found[index].information for index in ends]))
        var = np.trace(P, axis1=1, axis2=2) / 3.0
        weight = span[good] ** 2 / (var[good] + var[good + 1])
        return cls(
            (vel[good], vel[good + 1]),
            (C[good], C[good + 1]),
            (rate[good], rate[good + 1]),
            span[good],
            block,
            change,
            weight,
            lever,
        )

    def fits(self, rotations: list[Array], sign: float) -> list[Fit]:
        """Return the fit from the best of some rotations, with a unit of this sign."""
        tried = []
        for R in rotations:
            x = self.by_radar(R, self.lever)
            square = float(self.weight @ (self.change**2).sum(axis=1))
            unit = float(self.weight @ (x * self.change).sum(axis=1)) / max(square, 1e-12)
            unit = unit if unit * sign > 0 else LEAST_UNIT * sign
            left = self.weight @ ((x - unit * self.change) ** 2).sum(axis=1)
            tried.append((float(left), R, unit))
        return [self.refined(R, unit) for _, R, unit in sorted(tried, key=itemgetter(0))[:1]]

    def by_radar(self, R: Array, lever: Array) -> Array:
        """Return the changes of velocity of a radar that is mounted so, as :attr:`change` is."""
        ends = [
            np.einsum("nij,nj->ni", C, vel @ R.T - rate @ so3.skew(lever))
            for C, vel, rate in zip(self.C, self.vel, self.rate, strict=True)
        ]
        return _less_mean((ends[1] - ends[0]) / self.span[:, None], self.block)

    def refined(self, R: Array, unit: float) -> Fit:
        """Return the fit of rotation, unit and lever arm by Gauss-Newton from a start.

        Pieces count the less the worse they fit: scans of which most points move are among them.
        """
        lever, J = self.lever, np.zeros((*self.change.shape, 7))
        # What nothing shows stays where it is
        prior = np.array([1e-6] * 4 + [POSITION_SIGMA**-2] * 3)
        for _ in range(ROUNDS):
            x = self.by_radar(R, unit * lever)
            for axis, turn in enumerate(STEP * np.eye(3)):
                J[:, :, axis] = (self.by_radar(R @ exp(turn), unit * lever) - x) / STEP
                J[:, :, 4 + axis] = (self.by_radar(R, unit * (lever + turn)) - x) / STEP
            J[:, :, 3] = self.by_radar(R, unit * lever) - self.by_radar(R, np.zeros(3))
            J[:, :, 3] -= unit * self.change
            r = x - unit * self.change
            weight = self.weight / (1.0 + self.weight * (r**2).sum(axis=1) / TAIL)
            A = np.einsum("n,nij,nik->jk", weight, J, J) + np.diag(prior)
            b = -np.einsum("n,nij,ni->j", weight, J, r)
            b[4:] += prior[4:] * (self.lever - lever)
            dx = np.linalg.solve(A, b)
            dx *= min(1.0, 0.5 / max(float(np.linalg.norm(dx[:4])), 1e-9))
            R, unit, lever = R @ exp(dx[:3]), unit * float(np.exp(dx[3])), lever + dx[4:]
        r = self.by_radar(R, unit * lever) - unit * self.change
        square = self.weight * (r**2).sum(axis=1)
        cost = float(TAIL * np.log1p(square / TAIL).sum())
        whole = weight @ (x**2).sum(axis=1)
        freedom = max(self.change.size - 3 * (int(self.block[-1]) + 1) - 7, 1)
        P = max(1.0, cost / freedom) * np.linalg.inv(A)[:4, :4]
        left = float(weight @ (r**2).sum(axis=1)) / max(float(whole), 1e-12)
        return Fit(R, unit, 0.0, P, np.inf, cost, min(left, 1.0), freedom)


def _less_mean(rows: Array, block: Indices) -> Array:
    """Return rows less the mean of those of the same block."""
    count = np.bincount(block)[:, None]
    sums = np.stack([np.bincount(block, one) for one in rows.T], axis=1)
    return np.asarray(rows - (sums / np.maximum(count, 1))[block])


def _onto_axes() -> list[Array]:
    """Return the 24 rotations that turn axes onto axes."""
    every = [np.array([sign * np.eye(3)[axis] for axis, sign in one]) for one in every_axes()]
    return [one for one in every if np.linalg.det(one) > 0]
