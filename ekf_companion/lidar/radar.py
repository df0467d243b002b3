"""Radar-inertial odometry: the velocity of each scan corrects what the inertial samples say.

The radar measures the velocity of itself, in its own axes, at the time of a scan:

    v_l = C_lb (C_bw v_w + w x l)

with the rate w and the lever arm l. It sees no place and no heading: position drifts by what is
wrong in velocity and heading, and the covariance says so. Filter, state and results are those of
the lidar, without a map; but estimates have stamps of the inertial clock, as the radar's are late.

Source: Doer and Trommer 2020, "An EKF based approach to radar inertial odometry", with mounting and
delay in the state: the same 2020, "Radar inertial odometry with online calibration".
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ekf_companion.lidar import start
from ekf_companion.lidar.doppler import LEAST, EgoVelocity, velocities
from ekf_companion.lidar.motion import Path, Samples, prepare, propagate
from ekf_companion.lidar.odometry import Estimate, recentred
from ekf_companion.lidar.recording import InertialSamples, Mounting, Recording
from ekf_companion.lidar.relative import MARKED, Marked
from ekf_companion.lidar.rows import Match
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ATT,
    CALIBRATION,
    DELAY,
    DOWN,
    EXCESS,
    GYRO_BIAS,
    MOUNT_ATT,
    MOUNT_POS,
    POSE,
    VEL,
    N,
    State,
)
from ekf_companion.lidar.track import Track
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.direction import direction_by_angles
from ekf_companion.nav.so3 import skew

AXES = np.radians([1.0, 4.0, 1.0])
"""Least sigmas of the axes in which a radar measures, rad: elevation, about y, is by the fewest
antennas. On one recording the motion shows 0.2, 7.5 and 1.1 deg beside what was measured."""
LATE = 0.02
"""Least sigma of the delay, s: a frame lasts 20 to 60 ms, and is stamped at its begin or end."""
GYRO_WALK = 5e-4
"""Least walk of the gyro's bias, rad/s/sqrt(s): half of what autopilots take (1e-3 of PX4 and
ArduPilot). Three seconds after a correction the velocities of a recorded walk miss by 3.2 sigmas
squared with that of a data sheet, by 0.8 with this, and by 0.11 m/s instead of 0.15: a lidar does
not go so long by the gyro alone."""
GATE = 16.27
"""Largest square of an innovation in its sigmas: chi-square of three, one in 1000."""


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """An innovation of three numbers, and what it depends on."""

    z: Array
    H: Array
    """Shape (3, 27)."""
    information: Array
    """Inverse of the covariance of its noise; 0 along what it does not show."""


class RadarOdometry:
    """Takes the velocities of scans in the order of their stamps."""

    def __init__(self, inertial: InertialSamples, mounting: Mounting, settings: Settings) -> None:
        """Begin with a mounting, of which what is not known is estimated."""
        walk = max(settings.gyro_walk, GYRO_WALK)
        self.settings, self._mounting = replace(settings, gyro_walk=walk), mounting
        self._samples: Samples = prepare(inertial)
        self._marked = Marked(settings.spacing)
        self._time = 0.0
        """Of the state, inertial clock, s."""
        self.x = State()
        self.P = np.zeros((N + POSE, N + POSE))
        self.refused = 0
        """Velocities outside the gate."""

    def run(self, found: Iterable[EgoVelocity]) -> Iterator[Estimate]:
        """Yield the estimate at each velocity: those of the first second also find the start."""
        first: list[EgoVelocity] = []
        is_started = False
        for one in found:
            if is_started:
                yield self._step(one)
                continue
            first.append(one)
            if one.stamp - first[0].stamp >= start.SPAN:
                is_started = True
                yield from self._begin(first)
        if first and not is_started:
            yield from self._begin(first)

    def _begin(self, first: Sequence[EgoVelocity]) -> Iterator[Estimate]:
        """Find the start, and take the velocities that it was found by."""
        self.x, self.P[:N, :N] = find_start(first, self._samples, self._mounting, self.settings)
        self._time = first[0].stamp
        for one in first:
            yield self._step(one)

    def _step(self, one: EgoVelocity) -> Estimate:
        """Carry the state to a velocity and correct it."""
        before = self._time
        end = max(one.stamp + self.x.delay, before)
        x, Phi, Q, path = propagate(self.x, self._samples, before, end, self.settings)
        P = self.P.copy()
        P[:N] = Phi @ P[:N]
        P[:, :N] = P[:, :N] @ Phi.T
        P[:N, :N] += Q
        if self._marked.is_none:
            # The first pose is the world
            x, G = recentred(x)
            P[:N, :N] = G @ P[:N, :N] @ G.T
        self.x, self.P, self._time = x, P, end

        match, is_still = None, False
        if one.used:
            if self._fuse(observe(self.x, one.vel, one.information, path)):
                match = _match(one, self.x)
                # Its square in sigmas: of what is not shown there is none
                is_still = float(one.vel @ one.information @ one.vel) < start.STILL
            else:
                self.refused += 1
        still = start.rest(end - start.SPAN, end, self._samples) if is_still else None
        if still is not None:
            self._fuse(no_turn(self.x, still, end - before))
        self.P[EXCESS] = self.P[:, EXCESS] = 0.0
        travelled = self._marked.travelled(end, self.x, self.P)
        return Estimate(
            stamp=end,
            state=self.x,
            P=self.P[:N, :N].copy(),
            travelled=travelled,
            relative=travelled if self._marked.renew(end, self.x, self.P) else None,
            match=match,
            clipped=path.clipped,
            lost=path.lost,
            evaluations=1,
        )

    def _fuse(self, row: Row) -> bool:
        """Correct the state by a row that lies within the gate; return whether it does."""
        # Rows of unit noise along what is shown
        size, axes = np.linalg.eigh(row.information)
        W = np.sqrt(np.maximum(size, 0.0))[:, None] * axes.T
        H = np.zeros((3, len(self.P)))
        H[:, :N] = W @ row.H
        z = W @ row.z
        PH = self.P @ H.T
        S = H @ PH + np.eye(3)
        if float(z @ np.linalg.solve(S, z)) > GATE:
            return False
        K = np.linalg.solve(S, PH.T).T
        # What was told of the marked pose stays as it was told: considered, not corrected
        K[MARKED] = 0.0
        A = np.eye(len(self.P)) - K @ H
        P = A @ self.P @ A.T + K @ K.T
        before, self.x = self.x, self.x.plus((K @ z)[:N])
        G = np.eye(len(self.P))
        G[:N, :N] = same_in_body(before, self.x)
        P = G @ P @ G.T
        self.P = 0.5 * (P + P.T)
        return True


def same_in_body(before: State, x: State) -> Array:
    """Return the derivative of the error state about a corrected state by that before, (27, 27).

    A radar sees velocity and gravity in the axes of the body: their errors there are what stays the
    same. With those in w kept instead, each correction of the attitude moves what it is that later
    velocities show, and together they seem to show a heading that nothing shows.
    """
    C, G = x.C_wb @ before.C_wb.T, np.eye(N)
    G[VEL, VEL] = C
    G[VEL, ATT] = x.C_wb @ skew(before.C_wb.T @ before.vel_w - x.C_wb.T @ x.vel_w)
    to_angles = direction_by_angles(x.down_w).T
    G[DOWN, DOWN] = to_angles @ C @ direction_by_angles(before.down_w)
    moved = before.C_wb.T @ before.down_w - x.C_wb.T @ x.down_w
    G[DOWN, ATT] = to_angles @ x.C_wb @ skew(moved)
    return G


def observe(x: State, vel: Array, information: Array, path: Path) -> Row:
    """Return the row of a velocity of the radar, at the end of a path."""
    rate_b = path.rate_b[-1] if len(path.rate_b) else np.zeros(3)
    accel_w = path.accel_w[-1] if len(path.accel_w) else np.zeros(3)
    C_lb, vel_b = x.C_bl.T, x.C_wb.T @ x.vel_w
    predicted = C_lb @ (vel_b + so3.cross(rate_b, x.pos_b))
    H = np.zeros((3, N))
    H[:, ATT] = C_lb @ skew(vel_b)
    H[:, VEL] = C_lb @ x.C_wb.T
    H[:, GYRO_BIAS] = C_lb @ skew(x.pos_b)
    H[:, MOUNT_ATT] = skew(predicted)
    H[:, MOUNT_POS] = C_lb @ skew(rate_b)
    H[:, DELAY] = C_lb @ (x.C_wb.T @ accel_w - so3.cross(rate_b, vel_b))
    return Row(vel - predicted, H, information)


def no_turn(x: State, still: tuple[Array, float], span: float) -> Row:
    """Return the row of a gyro at rest: its mean rate is its bias.

    One second of rest shows it as the start does.
    """
    rate, sigma = still
    H = np.zeros((3, N))
    H[:, GYRO_BIAS] = np.eye(3)
    return Row(rate - x.gyro_bias, H, np.eye(3) * span / start.SPAN / sigma**2)


def find_start(
    first: Sequence[EgoVelocity], samples: Samples, mounting: Mounting, settings: Settings
) -> tuple[State, Array]:
    """Return the state at the first of some velocities, and its covariance, shape (27, 27).

    What the inertial samples add from rest and without gravity leaves velocity and gravity, which
    are linear in what the radar says. The world is the body there. Errors of mounting and delay are
    in both, and are correlated with them: of a radar that is tilted by 7 deg against what is given
    a walk of 1.4 m/s seems to rise by 0.2 m/s.
    """
    x = State(C_bl=mounting.rotation, pos_b=mounting.position)
    begin, end = first[0].stamp, first[-1].stamp
    path = propagate(x, samples, begin, end, replace(settings, gravity=0.0))[3]
    span = end - begin
    mean = path.vel_w[-1] / span if span > 0 else np.array([0.0, 0.0, settings.gravity])
    prior = start.variances(settings)
    motion = np.concatenate([np.zeros(3), -mean, np.zeros(3)])
    A, b, by_calibration = np.diag(1.0 / prior), motion / prior, np.zeros((9, 7))
    for one in first:
        k = min(int(np.searchsorted(path.stamp, one.stamp)), len(path.stamp) - 1)
        C = path.C_wb[k]
        rate_b = path.rate_b[min(k, len(path.rate_b) - 1)] if len(path.rate_b) else np.zeros(3)
        accel_w = path.accel_w[min(k, len(path.accel_w) - 1)] if len(path.accel_w) else np.zeros(3)
        vel_b = x.C_bl @ one.vel - so3.cross(rate_b, x.pos_b)
        seen = C @ vel_b - path.vel_w[k]
        later = C @ so3.cross(rate_b, vel_b) - accel_w + mean
        D = np.column_stack([-C @ x.C_bl @ skew(one.vel), -C @ skew(rate_b), later])
        H = np.hstack([np.eye(3), (one.stamp - begin) * np.eye(3), np.zeros((3, 3))])
        turn = C @ x.C_bl
        weight = turn @ one.information @ turn.T
        A += H.T @ weight @ H
        b += H.T @ weight @ seen
        by_calibration += H.T @ weight @ D
    P = np.asarray(np.linalg.inv(A))
    motion = P @ b
    # Taken again, the same velocities count for nine tenths; what is known before them does not
    P = np.asarray(
        np.linalg.inv(A / start.AGAIN + (1.0 - 1.0 / start.AGAIN) * np.diag(1.0 / prior))
    )
    size = float(np.linalg.norm(motion[3:6]))
    x = replace(x, vel_w=motion[:3], down_w=motion[3:6] / size)
    still = start.rest(begin, end, samples)
    x, whole = start.settled(x, P, still, mean, settings)
    axes = np.maximum(mounting.rotation_sigma, AXES)
    late = max(settings.delay_sigma, LATE)
    sigma = np.concatenate([axes, np.repeat(mounting.position_sigma, 3), [late]])
    J = np.zeros((N, 7))
    J[CALIBRATION] = np.eye(7)
    if x.vel_w.any():
        J += start.by_motion(x, settings) @ P @ by_calibration / start.AGAIN
    return x, whole + (J * sigma**2) @ J.T


def _match(one: EgoVelocity, x: State) -> Match:
    """Return how a scan and the inertial samples agree, as a lidar's report has it."""
    C = x.C_wb @ x.C_bl
    size, axes = np.linalg.eigh(C @ one.information @ C.T)
    sigma = 1.0 / np.sqrt(np.maximum(size, 1e-12))
    return Match(one.used, np.zeros((3, 0)), np.full(3, np.nan), axes, sigma, one.rms)


def solve(recording: Recording, settings: Settings) -> tuple[Track, State, tuple[str, ...]]:
    """Return the estimates of a recording, the last state, and what was found on the way."""
    noise = recording.doppler_noise
    found = [
        replace(one, information=one.information / noise)
        for one in velocities(recording.scans, settings)
    ]
    odometry = RadarOdometry(recording.inertial, recording.mounting, settings)
    track = Track()
    for one in odometry.run(found):
        track.add(one)
    return track, odometry.x, tuple(_remarks(found, odometry.refused))


def _remarks(found: list[EgoVelocity], refused: int) -> Iterator[str]:
    """Yield what the scans have shown."""
    shown = [one for one in found if one.used]
    points, used = (sum(getattr(one, name) for one in shown) for name in ("points", "used"))
    if points:
        yield (
            f"{100.0 * (points - used) / points:.1f} % of the radar's points move, or are echoes "
            "over two surfaces: left out"
        )
    if blind := len(found) - len(shown):
        yield (
            f"{blind} scans show no velocity: fewer than {LEAST} of their points agree, or they "
            "repeat the scan before"
        )
    if refused:
        yield (
            f"{refused} velocities contradict the inertial samples: left out; most of what the "
            "radar sees moves, or its speeds wrap (`--most-speed`)"
        )
