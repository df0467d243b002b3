"""Walks with a known truth: a shoe that rests, swings, lands and rolls over its sole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind

GRAVITY = 9.81


@dataclass(frozen=True, kw_only=True)
class Walk:
    """Samples, and where the sensor truly was at their times."""

    events: Events
    pos_n: Array
    is_planted: npt.NDArray[np.bool_]


def _ease(u: Array) -> Array:
    """Go from 0 to 1 with speed and acceleration nought at both ends."""
    return u**3 * (10.0 + u * (6.0 * u - 15.0))


def _stride(t: Array, start: float, swing: float) -> Array:
    return _ease(np.clip((t - start) / swing, 0.0, 1.0))


def make(
    rng: np.random.Generator,
    *,
    rate: float = 250.0,
    strides: int = 20,
    lever: float = 0.06,
    rolling: float = 0.15,
    noise: float = 1.0,
) -> Walk:
    """Walk a loop of equal strides, back to the start.

    Args:
        rng: Of noise, biases and how the sensor is held.
        rate: Samples per second, Hz.
        strides: Of the loop; its last ends where the first began.
        lever: Height of the sensor over the point where the foot stands, m.
        rolling: How far the foot turns about that point while it stands, rad.
        noise: Factor on noise and biases.
    """
    rest, swing, stance, stride = 3.0, 0.6, 0.45, 1.3
    end = 2.0 * rest + strides * (swing + stance)
    # Ten times as fine as the samples: the truth is differentiated.
    fine = 10
    t = np.arange(int(end * rate * fine)) / (rate * fine)
    heading = np.zeros_like(t)
    pitch = np.zeros_like(t)
    contact = np.zeros((len(t), 3))
    is_planted = np.ones(len(t), dtype=bool)
    turn = 2.0 * np.pi / strides
    for index in range(strides):
        start = rest + index * (swing + stance)
        part = _stride(t, start, swing)
        way = turn * (index + 0.5)
        contact += part[:, None] * stride * np.array([np.cos(way), np.sin(way), 0.0])
        contact[:, 2] -= 0.12 * 16.0 * (part * (1.0 - part)) ** 2
        heading += turn * part
        u = np.clip((t - start) / swing, 0.0, 1.0)
        pitch += -0.9 * np.sin(2.0 * np.pi * u) * np.sin(np.pi * u) ** 2
        is_planted &= (t < start) | (t > start + swing)
        if index < strides - 1:
            flat = np.clip((t - start - swing) / stance, 0.0, 1.0)
            pitch += -rolling * np.sin(2.0 * np.pi * flat) * np.sin(np.pi * flat) ** 2
    held = so3.exp(rng.normal(size=3) * 0.3)
    q_nb = so3.multiply(so3.from_euler(np.zeros_like(t), pitch, heading), held)
    foot = so3.from_euler(np.zeros_like(t), pitch, heading)
    pos = contact + so3.rotate(foot, np.array([0.0, 0.0, -lever]))
    return _sample(rng, rate, fine, t, pos, q_nb, is_planted, noise)


def _sample(rng, rate, fine, t, pos, q_nb, is_planted, noise) -> Walk:
    dt = t[1] - t[0]
    accel_n = np.gradient(np.gradient(pos, dt, axis=0), dt, axis=0) - [0.0, 0.0, GRAVITY]
    rate_b = np.zeros_like(pos)
    rate_b[1:-1] = so3.log(so3.multiply(so3.conjugate(q_nb[:-2]), q_nb[2:])) / (2.0 * dt)
    force_b = np.einsum("nji,nj->ni", so3.to_matrix(q_nb), accel_n)
    some = slice(2 * fine, -2 * fine, fine)
    n = len(t[some])
    gyro = rate_b[some] + noise * (
        rng.normal(size=3) * 0.005 + rng.normal(size=(n, 3)) * 1.5e-4 * np.sqrt(rate)
    )
    accel = force_b[some] + noise * (
        rng.normal(size=3) * 0.05 + rng.normal(size=(n, 3)) * 1.5e-3 * np.sqrt(rate)
    )
    # Each axis of the gyro is a little too fast or slow, as that of any small sensor
    gyro *= 1.0 + noise * rng.normal(size=3) * 0.003
    t_ns = np.rint(t[some] * 1e9).astype(np.int64)
    return Walk(
        events=Events.from_columns(t_ns, Kind.IMU, *gyro.T, *accel.T),
        pos_n=pos[some] - pos[some][0],
        is_planted=is_planted[some],
    )
