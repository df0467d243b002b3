"""Motion between two scans from the inertial samples, and its covariance.

Between two samples the mean of both is integrated. A sample at the end of its range, and a step
without samples, widen the noise: what happened there is not known.

Source: Forster et al. 2017, "On-manifold preintegration", arXiv 1512.02363 (discrete strapdown);
the covariance by the derivatives of these equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.lidar import loops
from ekf_companion.lidar.recording import InertialSamples
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.state import (
    ACCEL_BIAS,
    ATT,
    DELAY,
    DOWN,
    EXCESS,
    GYRO_BIAS,
    POS,
    VEL,
    N,
    State,
    exp,
)
from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.direction import direction_by_angles
from ekf_companion.nav.so3 import skew

CLIPPED_RATE, CLIPPED_FORCE = 0.05, 2.0
"""Variance that a sample at the end of its range adds, rad^2/s and m^2/s^3: as the kernel's."""
LEAST_RATE_RANGE, LEAST_FORCE_RANGE = 0.5, 11.5
"""No sensor has a smaller range, rad/s and m/s^2: as the kernel's."""
GAP = 3.0
"""Multiple of the usual step from which on a step is a gap."""
GAP_RATE, GAP_FORCE, MOTION_TIME = 0.5, 6.7, 0.4
"""A vehicle's motion in a gap, rad/s and m/s^2, and its correlation time, s: as the kernel's."""
WINDOW = 100
"""Samples over which vibration is averaged, before each."""
TOGETHER = 5
"""Samples of one step of the covariance."""
SCALE_TIME = 0.1
"""Time over which an error of scale acts before the lidar corrects it, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples(InertialSamples):
    """Inertial samples, with what is wrong with them."""

    is_clipped: Mask
    """Shape (n, 6): at the end of its range; gyro first."""
    step: float
    """Usual time between samples, s."""
    vibration: Array
    """Variance per second of what changes from sample to sample, shape (n, 6)."""


def prepare(inertial: InertialSamples) -> Samples:
    """Find the samples that are at the end of their range; not where it is known already."""
    if isinstance(inertial, Samples):
        return inertial
    both = np.hstack([inertial.gyro, inertial.accel])
    is_clipped = np.zeros(both.shape, dtype=np.bool_)
    least = np.repeat([LEAST_RATE_RANGE, LEAST_FORCE_RANGE], 3)
    for axis in range(6):
        size = np.abs(both[:, axis])
        if len(size) and (top := size.max()) > least[axis]:
            is_top = size >= top * (1.0 - 1e-4)
            # Noise does not give its largest value twice in a row
            is_clipped[1:, axis] = is_top[1:] & is_top[:-1]
            is_clipped[:-1, axis] |= is_clipped[1:, axis]
    step = float(np.median(np.diff(inertial.stamp))) if len(inertial.stamp) > 1 else 0.005
    vibration = _vibration(both) * step
    return Samples(inertial.stamp, inertial.gyro, inertial.accel, is_clipped, step, vibration)


def _vibration(values: Array) -> Array:
    """Return the variance of what is not smooth over three samples, averaged over a window.

    Vibration beyond half the sampling rate is folded into lower ones and does not average out as
    the motion that it is: it counts as white noise.
    """
    n = len(values)
    square = np.zeros_like(values)
    if n > 2:
        # The second difference of white noise has six times its variance
        square[1:-1] = (values[2:] - 2.0 * values[1:-1] + values[:-2]) ** 2 / 6.0
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(square, axis=0)])
    at = np.arange(n)
    first, last = np.maximum(at - WINDOW, 0), np.minimum(at + 1, n)
    return np.asarray((total[last] - total[first]) / np.maximum(last - first, 1)[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Poses of the body over one scan interval, and the covariance of the motion."""

    stamp: Array
    """s, inertial clock, shape (m,), from the first to the last time."""
    C_wb: Array
    """Shape (m, 3, 3)."""
    pos_w: Array
    """Shape (m, 3)."""
    vel_w: Array
    """Shape (m, 3)."""
    rate_b: Array
    """Without the bias, rad/s, of each step, shape (m - 1, 3)."""
    accel_w: Array
    """Of each step, m/s^2, shape (m - 1, 3)."""
    clipped: int
    """Number of samples at the end of a range."""
    lost: float
    """Time without samples, s."""

    def at(self, stamp: Array, back: Array | None = None) -> tuple[Array, Array]:
        """Return attitude, multiplied from the left, and position at times within the path.

        Shapes (n, 9) and (n, 3).
        """
        k = np.clip(np.searchsorted(self.stamp, stamp, side="right") - 1, 0, len(self.rate_b) - 1)
        turn, moved = np.empty((len(stamp), 9)), np.empty((len(stamp), 3))
        m = len(self.rate_b)
        attitude = self.C_wb[:m].reshape(-1, 9)
        states = np.hstack([attitude, self.pos_w[:m], self.vel_w[:m], self.rate_b, self.accel_w])
        left = np.eye(3) if back is None else np.ascontiguousarray(back)
        loops.carry(np.ascontiguousarray(stamp), k, self.stamp[:m], states, left, turn, moved)
        return turn, moved


def propagate(
    x: State,
    samples: Samples,
    start: float,
    end: float,
    settings: Settings,
    *,
    is_turn_estimated: bool = False,
) -> tuple[State, Array, Array, Path]:
    """Integrate from one time to another on the inertial clock.

    Turns in a gap are noise, unless they are estimated: then ``EXCESS`` has their variance.

    Returns:
        The state, the derivative of its error state by the one before and the covariance that the
        motion adds, both of shape (27, 27), and the path.
    """
    first, last = np.searchsorted(samples.stamp, [start, end], side="right")
    inside = samples.stamp[first:last]
    inside = inside[(inside > start + 1e-7) & (inside < end - 1e-7)]
    t = np.concatenate([[start], inside, [end]])
    dt = np.diff(t)
    middle = 0.5 * (t[1:] + t[:-1])
    rate, force, is_clipped, span, vibration = _means(samples, middle)
    rate = rate - x.gyro_bias - x.excess
    force_b = force - x.accel_bias
    gravity_w = settings.gravity * x.down_w
    is_gap = span > GAP * samples.step
    turning = rate[is_gap] ** 2
    # Longer than motion is like itself, no more than the velocity is expected to last
    is_unknown = is_gap & (dt > MOTION_TIME)
    rate = np.where(is_unknown[:, None], 0.0, rate)

    half = exp(0.5 * rate * dt[:, None])
    C = np.empty((len(t), 3, 3))
    C[0] = x.C_wb
    middles = np.empty((len(dt), 3, 3))
    for k, turn in enumerate(half):
        middles[k] = C[k] @ turn
        C[k + 1] = middles[k] @ turn
    force_b = np.where(is_unknown[:, None], -middles.transpose(0, 2, 1) @ gravity_w, force_b)
    accel_w = np.einsum("kij,kj->ki", middles, force_b) + gravity_w
    vel = x.vel_w + np.concatenate([np.zeros((1, 3)), np.cumsum(accel_w * dt[:, None], axis=0)])
    steps = dt[:, None] * (vel[:-1] + 0.5 * dt[:, None] * accel_w)
    pos = x.pos_w + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    q = np.tile(settings.densities, (len(dt), 1))
    q[:, :6] = np.maximum(q[:, :6], vibration)
    q[:, :3] += (settings.inertial_scale * rate) ** 2 * SCALE_TIME
    change = force_b + middles.transpose(0, 2, 1) @ gravity_w  # without what stays: the bias has it
    q[:, 3:6] += (settings.inertial_scale * change) ** 2 * SCALE_TIME
    q[:, :3] += CLIPPED_RATE * is_clipped[:, :3]
    q[:, 3:6] += CLIPPED_FORCE * is_clipped[:, 3:]
    if is_gap.any():
        # A first-order Gauss-Markov motion: its density below, constant over a shorter gap
        width = 2.0 * np.minimum(span, MOTION_TIME)[is_gap, None]
        if not is_turn_estimated:
            q[is_gap, :3] += np.maximum(GAP_RATE**2, turning) * width
        q[is_gap, 3:6] += GAP_FORCE**2 * width

    Phi, Q = np.eye(N), np.zeros((N, N))
    tilt = settings.gravity * direction_by_angles(x.down_w)
    for a in range(0, len(dt), TOGETHER):
        b = min(a + TOGETHER, len(dt))
        h = t[b] - t[a]
        if h <= 0.0:
            continue
        m = (a + b) // 2
        weight = dt[a:b] / h
        F = _transition(weight @ rate[a:b], weight @ force_b[a:b], middles[m], h, tilt)
        Phi = F @ Phi
        Q = F @ Q @ F.T + _noise(middles[m], weight @ q[a:b], h)
    path = Path(
        t,
        C,
        pos,
        vel,
        rate,
        accel_w,
        int(np.count_nonzero(clipped_between(samples, start, end).any(axis=1))),
        float(dt[is_gap].sum()),
    )
    C_end = C[-1]
    # Rounding of the products of a whole flight
    U, _, V = np.linalg.svd(C_end)
    return x.moved(U @ V, pos[-1], vel[-1]), Phi, Q, path


def clipped_between(samples: Samples, start: float, end: float) -> Mask:
    """Return which axes are at the end of their range between two times, by sample, (n, 6)."""
    first, last = np.searchsorted(samples.stamp, [start, end])
    return samples.is_clipped[first:last]


def unmeasured_turns(samples: Samples, start: float, end: float) -> Mask:
    """Return about which axes turns between two times are not measured, shape (3,).

    A sample of the gyro is at the end of its range there, or none came for long.
    """
    first = np.searchsorted(samples.stamp, start, side="right")
    last = np.searchsorted(samples.stamp, end)
    around = samples.stamp[max(first - 1, 0) : last + 1]
    if (np.diff(around) > GAP * samples.step).any():
        return np.ones(3, np.bool_)
    return np.asarray(clipped_between(samples, start, end)[:, :3].any(axis=0))


def _means(samples: Samples, middle: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return rate, force, clipped axes, step and vibration at times between samples."""
    last = len(samples.stamp) - 1
    after = np.clip(np.searchsorted(samples.stamp, middle), 1, max(last, 1))
    if last < 1:
        zeros = np.zeros((len(middle), 3))
        none = np.zeros((len(middle), 6))
        return zeros, zeros, none, np.full(len(middle), np.inf), none
    before = after - 1
    t0, t1 = samples.stamp[before], samples.stamp[after]
    u = np.clip((middle - t0) / np.maximum(t1 - t0, 1e-9), 0.0, 1.0)[:, None]
    gyro = (1.0 - u) * samples.gyro[before] + u * samples.gyro[after]
    accel = (1.0 - u) * samples.accel[before] + u * samples.accel[after]
    is_clipped = (samples.is_clipped[before] | samples.is_clipped[after]).astype(np.float64)
    # Before the first and after the last sample there is none to go by
    outside = np.maximum(t0 - middle, middle - t1)
    return gyro, accel, is_clipped, np.maximum(t1 - t0, outside), samples.vibration[after]


def _transition(rate: Array, force: Array, C: Array, h: float, tilt: Array) -> Array:
    """Return the derivative of the error state after a step by the one before, (27, 27)."""
    F = np.eye(N)
    turn = exp(-rate * h)
    F[ATT, ATT] = turn
    F[ATT, GYRO_BIAS] = -h * exp(-0.5 * rate * h)
    half = exp(0.5 * rate * h)
    # The attitude before the step, seen at its middle
    by_att = -C @ skew(force) @ half.T
    F[VEL, ATT] = h * by_att
    F[POS, ATT] = 0.5 * h * h * by_att
    F[VEL, GYRO_BIAS] = 0.5 * h * h * C @ skew(force)
    F[POS, GYRO_BIAS] = h**3 / 6.0 * C @ skew(force)
    F[VEL, ACCEL_BIAS] = -h * C
    F[POS, ACCEL_BIAS] = -0.5 * h * h * C
    F[VEL, DOWN] = h * tilt
    F[POS, DOWN] = 0.5 * h * h * tilt
    F[POS, VEL] = h * np.eye(3)
    F[:9, EXCESS] = F[:9, GYRO_BIAS]
    return F


def _noise(C: Array, q: Array, h: float) -> Array:
    """Return the covariance that white noise of variances ``q`` per second adds, (27, 27)."""
    Q = np.zeros((N, N))
    Q[ATT, ATT] = np.diag(q[:3] * h)
    A = (C * q[3:6]) @ C.T
    Q[VEL, VEL] = h * A
    Q[POS, VEL] = Q[VEL, POS] = 0.5 * h * h * A
    Q[POS, POS] = h**3 / 3.0 * A
    Q[GYRO_BIAS, GYRO_BIAS] = np.diag(q[6:9] * h)
    Q[ACCEL_BIAS, ACCEL_BIAS] = np.diag(q[9:12] * h)
    Q[DELAY, DELAY] = 0.0
    return Q
