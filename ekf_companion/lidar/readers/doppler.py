"""Find how a radar is turned on the inertial sensor, how late it is, and what its speeds are in.

The velocity by radial speeds changes as the inertial samples say: from one time to another, in
axes that the gyro carries along,

    C2 s R v2 - C1 s R v1 = integral of C f - g (t2 - t1)

with R the mounting and s the unit: negative where speeds are positive towards the sensor, or
where one axis is mirrored, which is the same. Pieces that follow each other share the direction of
gravity, which leaves with their mean. Where the vehicle does not accelerate nothing is shown, and
nothing changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.doppler import EgoVelocity, velocities
from ekf_companion.lidar.readers.scans import Scans
from ekf_companion.lidar.readers.timing import Timing
from ekf_companion.lidar.readers.units import SPEED, nearest
from ekf_companion.lidar.recording import InertialSamples, Mounting
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import exp
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Indices

PIECE = 0.3
"""s: over it a velocity changes by more than its noise, and a wrong bias of the gyro by less."""
PIECES = 13
"""That follow each other and share the direction of gravity: over 4 s a gyro bias of 0.01 rad/s
turns it by 2 deg."""
LEAST = 24
"""Pieces of which anything is found: three times as many rows as there are unknowns."""
LATENESS = np.arange(-0.3, 0.3001, 0.02)
"""Delays that are tried, s: a radar takes and sends a scan in two of its periods."""
STARTS = 3
"""Best of the 24 rotations onto axes from which the mounting is refined."""
ROUNDS = 8
STEP = 1e-4
"""Of the differences by which the rotation is refined, rad."""
SHOWN = np.radians(12.0)
"""Sigma of the mounting up to which it counts as shown: the axes of a cube are 90 deg apart."""
APART = np.radians(30.0)
"""Of a mounting that is known, beyond which it is another one: nobody measures so badly."""
SIGMAS = 4.0
"""By which a mounting that is known, or a delay of none, must be missed to be wrong."""
POSITION_SIGMA = 0.1
"""m, on each axis, of a radar on a vehicle that fits a hand."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How the radar is turned."""

    rotation: Array
    """Radar to body."""
    scale: float
    """Of its velocities; negative where the radial speeds are positive towards the sensor."""
    delay: float
    """s, added to the stamps of the scans."""
    P: Array
    """Of rotation (vector in the radar's frame) and log of the scale, shape (4, 4)."""
    delay_sigma: float
    left: float
    """Share of the changes of velocity that is not explained."""

    @property
    def sigma(self) -> float:
        """Return the largest sigma of the rotation, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.P[:3, :3])[-1]))


def compare_doppler(
    scans: Scans, inertial: InertialSamples, mounting: Mounting | None
) -> tuple[Timing, Mounting, list[str]]:
    """Return timing and mounting by which radar and inertial samples agree, and sentences on them.

    Args:
        scans: The scans, with the timing that their values show.
        inertial: The samples, in SI units and in order.
        mounting: Of the radar on the inertial sensor; None: not known.

    Raises:
        LogError: They contradict each other.
    """
    timing, name = scans.timing, scans.source.name
    found = [one for one in velocities(scans, Settings()) if one.vel is not None]
    if len(found) < 2:
        raise LogError(
            f"{name}: {len(found)} scans show a velocity: too few points, or none that agree; "
            "is it the right topic, and the radar's static clutter removal off?"
        )
    fit = find(found, inertial)
    if fit is None or fit.sigma > SHOWN:
        if mounting is not None:
            return timing, mounting, ["the motion does not show whether radar and samples agree"]
        words = "the recording does not say how the radar is mounted, nor does the motion show it"
        return timing, Mounting(), [f"{words}: taken for axes alike; give the mounting"]
    sentences = [
        f"radar and inertial samples agree: {100 * (1 - fit.left):.0f} % of the changes of "
        "velocity are the same"
    ]
    timing, words = _units(timing, fit, is_known=mounting is not None)
    sentences += words
    if abs(fit.delay) > SIGMAS * fit.delay_sigma:
        late = "late" if fit.delay < 0 else "early"
        timing = replace(timing, shift=timing.shift + fit.delay)
        sentences.append(
            f"stamps of scans are {1e3 * abs(fit.delay):.0f} ms {late} by the motion, sigma "
            f"{1e3 * fit.delay_sigma:.0f} ms: corrected"
        )
    if mounting is None:
        mounting = Mounting(fit.rotation, np.zeros(3), fit.sigma, POSITION_SIGMA)
        sentences.append(
            f"the recording does not say how the radar is mounted: by the motion {_angles(fit)}, "
            f"sigma {np.degrees(fit.sigma):.1f} deg, taken for at the inertial sensor; give the "
            "mounting if it is known"
        )
        return timing, mounting, sentences
    turn = so3.log(so3.from_matrix(mounting.rotation.T @ fit.rotation))
    P = fit.P[:3, :3] + mounting.rotation_sigma**2 * np.eye(3)
    angle, misses = float(np.linalg.norm(turn)), float(turn @ np.linalg.solve(P, turn))
    if angle > APART and misses > SIGMAS**2:
        raise LogError(
            f"{name}: the axes of radar and inertial sensor do not belong together: by the motion "
            f"the radar is mounted at {_angles(fit)}, {np.degrees(angle):.0f} deg from where it is "
            f"said to be{_mirrored(fit)}; correct the axes (forward, left, up), or the mounting"
        )
    if misses > SIGMAS**2:
        sentences.append(
            f"by the motion the radar is mounted at {_angles(fit)}, {np.degrees(angle):.0f} deg "
            "from where it is said to be: measure it again"
        )
    return timing, mounting, sentences


def _units(timing: Timing, fit: Fit, *, is_known: bool) -> tuple[Timing, list[str]]:
    """Return the timing with the unit and sign of the speeds, and sentences on them."""
    unit, said = nearest(1.0, abs(fit.scale), SPEED), list[str]()
    if unit != 1.0:
        said.append(f"radial speeds are in {SPEED[unit]}, not m/s")
    if fit.scale < 0:
        mirrored = "" if is_known else ", or an axis of the radar is mirrored, which is the same"
        said.append(f"radial speeds are positive towards the sensor{mirrored}: turned round")
    return replace(timing, speed_unit=np.sign(fit.scale) * unit), said


def _mirrored(fit: Fit) -> str:
    return ", and its speeds are reversed or one axis mirrored" if fit.scale < 0 else ""


def _angles(fit: Fit) -> str:
    roll, pitch, yaw = np.degrees(so3.to_euler(so3.from_matrix(fit.rotation))).tolist()
    return f"roll, pitch, yaw of {roll:.0f}, {pitch:.0f}, {yaw:.0f} deg"


def find(found: list[EgoVelocity], inertial: InertialSamples) -> Fit | None:
    """Return how a radar is turned and late by its velocities; None: too few pieces."""
    carried = _Carried.of(inertial)
    tried = [_fit(found, carried, delay, starts=1) for delay in LATENESS.tolist()]
    costs = np.array([np.inf if one is None else one.left for one in tried])
    best = int(np.clip(np.argmin(costs), 1, len(costs) - 2))
    if not np.isfinite(costs[best - 1 : best + 2]).all():
        return None
    before, here, after = costs[best - 1 : best + 2].tolist()
    step, bend = float(LATENESS[1] - LATENESS[0]), before - 2.0 * here + after
    delay = float(LATENESS[best])
    if bend > 0:
        delay += 0.5 * step * float(np.clip((before - after) / bend, -1.0, 1.0))
    fit = _fit(found, carried, delay, starts=STARTS)
    if fit is None:
        return None
    # The variance of what is left over the curvature of its sum, halved
    rows = 3.0 * (found[-1].stamp - found[0].stamp) / PIECE
    sigma = step * np.sqrt(2.0 * fit.left / max(rows - 5, 1) / bend) if bend > 0 else np.inf
    return replace(fit, delay_sigma=float(sigma))


@dataclass(frozen=True, slots=True, eq=False)
class _Carried:
    """The gyro's attitude and the integral of the force in its axes."""

    stamp: Array
    attitude: Array
    """Quaternions w, x, y, z, shape (n, 4)."""
    force: Array
    """m/s, shape (n, 3)."""

    @classmethod
    def of(cls, inertial: InertialSamples) -> _Carried:
        dt = np.diff(inertial.stamp)[:, None]
        turns = so3.exp(0.5 * (inertial.gyro[1:] + inertial.gyro[:-1]) * dt)
        attitude = [np.array([1.0, 0.0, 0.0, 0.0])]
        for turn in turns:
            attitude.append(so3.multiply(attitude[-1], turn))
        q = so3.normalise(np.array(attitude))
        force = so3.rotate(q, inertial.accel)
        steps = 0.5 * (force[1:] + force[:-1]) * dt
        return cls(inertial.stamp, q, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]))

    def at(self, t: Array) -> tuple[Array, Array]:
        """Return attitude matrices and integrals at times."""
        q = np.stack([np.interp(t, self.stamp, one) for one in self.attitude.T], axis=1)
        force = np.stack([np.interp(t, self.stamp, one) for one in self.force.T], axis=1)
        return so3.to_matrix(so3.normalise(q)), force


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Velocities of the radar at both ends of pieces, and how the inertial samples change."""

    v1: Array
    """m/s, in the radar's axes, shape (n, 3)."""
    v2: Array
    C1: Array
    """Body to the axes that the gyro carries along, shape (n, 3, 3)."""
    C2: Array
    span: Array
    """s, shape (n,)."""
    block: Indices
    """That shares a direction of gravity, shape (n,)."""
    change: Array
    """Mean force less that of the block, m/s^2, shape (n, 3)."""

    @classmethod
    def of(cls, found: list[EgoVelocity], carried: _Carried, delay: float) -> _Pieces | None:
        """Return the pieces between scans at a delay; None: too few."""
        t = np.array([one.stamp for one in found]) + delay
        ends = list[int]()
        for k in np.flatnonzero((t > carried.stamp[0]) & (t < carried.stamp[-1])).tolist():
            # To half a scan
            if not ends or t[k] - t[ends[-1]] >= PIECE - 0.05:
                ends.append(k)
        k = np.array(ends, np.int64)
        span = np.diff(t[k])
        good = np.flatnonzero(span < 2.0 * PIECE)
        if len(good) < LEAST:
            return None
        C, force = carried.at(t[k])
        vel = np.array([found[index].vel for index in ends])
        block = np.arange(len(span))[good] // PIECES
        mean = (np.diff(force, axis=0) / span[:, None])[good]
        C1, C2 = C[good], C[good + 1]
        change = _less_mean(mean, block)
        return cls(vel[good], vel[good + 1], C1, C2, span[good], block, change)

    def by_radar(self, R: Array) -> Array:
        """Return the changes of velocity of a radar that is turned so, as :attr:`change` is."""
        ends = np.einsum("nij,nj->ni", self.C2, self.v2 @ R.T)
        ends -= np.einsum("nij,nj->ni", self.C1, self.v1 @ R.T)
        return _less_mean(ends / self.span[:, None], self.block)

    def refined(self, R: Array, scale: float) -> Fit:
        """Return the fit by Gauss-Newton from a start."""
        y, J = self.change.ravel(), np.zeros((self.change.size, 4))
        for _ in range(ROUNDS):
            x = self.by_radar(R).ravel()
            for axis, turn in enumerate(STEP * np.eye(3)):
                J[:, axis] = scale * (self.by_radar(R @ exp(turn)).ravel() - x) / STEP
            J[:, 3] = scale * x
            # What nothing shows stays where it is
            A = J.T @ J + 1e-9 * np.eye(4)
            dx = np.linalg.solve(A, J.T @ (y - scale * x))
            dx *= min(1.0, 0.5 / max(float(np.linalg.norm(dx)), 1e-9))
            R, scale = R @ exp(dx[:3]), scale * float(np.exp(dx[3]))
        cost = float(np.sum((y - scale * self.by_radar(R).ravel()) ** 2))
        P = cost / max(y.size - 4, 1) * np.linalg.inv(A)
        return Fit(R, scale, 0.0, P, np.inf, cost / max(float(y @ y), 1e-12))


def _fit(found: list[EgoVelocity], carried: _Carried, delay: float, starts: int) -> Fit | None:
    """Return the fit at a delay, from the best of the rotations that turn axes onto axes."""
    pieces = _Pieces.of(found, carried, delay)
    if pieces is None:
        return None
    tried = []
    for R in _onto_axes():
        x = pieces.by_radar(R)
        scale = float((x * pieces.change).sum()) / max(float((x**2).sum()), 1e-12)
        tried.append((float(((pieces.change - scale * x) ** 2).sum()), R, scale))
    tried.sort(key=lambda one: one[0])
    fits = [pieces.refined(R, scale) for _, R, scale in tried[:starts]]
    return replace(min(fits, key=lambda one: one.left), delay=delay)


def _less_mean(rows: Array, block: Indices) -> Array:
    """Return rows less the mean of those of the same block."""
    count = np.bincount(block)[:, None]
    sums = np.stack([np.bincount(block, one) for one in rows.T], axis=1)
    return np.asarray(rows - (sums / np.maximum(count, 1))[block])


def _onto_axes() -> list[Array]:
    """Return the 24 rotations that turn axes onto axes."""
    every = [
        np.array([np.eye(3)[axis] * sign for axis, sign in zip(axes, signs, strict=True)])
        for axes in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return [one for one in every if np.linalg.det(one) > 0]
