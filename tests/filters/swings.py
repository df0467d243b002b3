"""Motions in the hand with a known truth, and what an inertial and magnetic sensor says of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Trajectory

GRAVITY = 9.81
FIELD_N = np.array([0.2, 0.0, 0.42])
"""gauss."""


@dataclass(frozen=True, kw_only=True)
class Swing:
    """What is done with the sensor, and what the sensor does wrong."""

    seconds: float = 80.0
    rate: float = 100.0
    """Hz."""
    mag_rate: float | None = None
    """Hz; None: as the others."""
    still: float = 10.0
    """At the start, s; and for half of it at the end."""
    turn: float = 1.0
    """rad/s, RMS per axis."""
    push: float = 0.3
    """m/s^2, RMS per axis."""
    pace: float = 1.0
    """Hz, of the turns and pushes, by the middle of their band."""
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw, rad."""
    gyro_bias: tuple[float, float, float] = (0.005, -0.005, 0.008)
    accel_bias: tuple[float, float, float] = (0.03, -0.02, 0.03)
    gyro_noise: float = 1e-4
    """rad/s per square root of Hz."""
    accel_noise: float = 1e-3
    scale: float = 0.003
    """One sigma of the gyro's errors of scale and axes."""
    mag_noise: float = 0.003
    """gauss, per sample."""
    magnets: tuple[tuple[float, float, tuple[float, float, float]], ...] = field(default=())
    """From when to when which field is added in n, s, s, gauss."""
    magnet_b: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Field of a magnet that is fastened to the sensor, gauss."""
    seed: int = 1


FINE = 2
"""Steps of the truth per sample."""


@cache
def swing(what: Swing) -> tuple[Events, Trajectory]:
    """Return what the sensor says, and the truth at each inertial sample.

    The rates are means over the sample's interval, as a sensor's own filter gives them.
    """
    rng = np.random.default_rng(what.seed)
    n = int(what.seconds * what.rate)
    dt = 1.0 / (what.rate * FINE)
    t = np.arange(n * FINE) * dt
    ends = (what.still, what.seconds - 0.5 * what.still)
    envelope = np.ones_like(t)
    if what.still:
        envelope = np.clip((t - ends[0]) / 1.0, 0.0, 1.0) * np.clip((ends[1] - t) / 1.0, 0.0, 1.0)
    rate_b = what.turn * envelope[:, None] * _waves(t, what.pace, rng)
    accel_n = what.push * envelope[:, None] * _waves(t, what.pace, rng)
    q_nb = _integrated(so3.from_euler(*what.start), rate_b * dt)[FINE - 1 :: FINE]
    rate_b = rate_b.reshape(n, FINE, 3).mean(axis=1)
    force_b = so3.rotate(so3.conjugate(q_nb), accel_n[FINE - 1 :: FINE] - [0.0, 0.0, GRAVITY])
    white = np.sqrt(what.rate)
    M = np.eye(3) + what.scale * rng.standard_normal((3, 3))
    gyro = rate_b @ M.T + what.gyro_bias + what.gyro_noise * white * rng.standard_normal((n, 3))
    accel = force_b + what.accel_bias + what.accel_noise * white * rng.standard_normal((n, 3))
    t_ns = np.rint((np.arange(n) + 1) * (1e9 / what.rate)).astype(np.int64)
    imu = Events.from_columns(t_ns, Kind.IMU, *gyro.T, *accel.T)
    every = 1 if what.mag_rate is None else round(what.rate / what.mag_rate)
    mag = _mag(what, t_ns * 1e-9, q_nb, rng)[::every]
    truth = Trajectory(name="truth", att_t_ns=t_ns, q_nb=so3.normalise(q_nb))
    return merge(Events.from_columns(t_ns[::every], Kind.MAG, *mag.T), imu), truth


def _waves(t, pace, rng):
    """Return three sums of sines about a frequency, RMS 1; none of them has a mean."""
    total = np.zeros((len(t), 3))
    for axis in range(3):
        for frequency in pace * rng.uniform(0.3, 2.0, 6):
            total[:, axis] += np.sin(2 * np.pi * (frequency * t + rng.uniform()))
    return total / np.sqrt(3.0)


def _integrated(q, turns):
    """Return the attitude after each small turn."""
    out = np.empty((len(turns), 4))
    w, x, y, z = q.tolist()
    for i, (c, sx, sy, sz) in enumerate(so3.exp(turns).tolist()):
        w, x, y, z = (
            w * c - x * sx - y * sy - z * sz,
            w * sx + x * c + y * sz - z * sy,
            w * sy - x * sz + y * c + z * sx,
            w * sz + x * sy - y * sx + z * c,
        )
        out[i] = w, x, y, z
    return out


def _mag(what, t, q_nb, rng):
    field_n = np.tile(FIELD_N, (len(t), 1))
    for first, last, extra in what.magnets:
        field_n[(t >= first) & (t < last)] += extra
    noise = what.mag_noise * rng.standard_normal((len(t), 3))
    return so3.rotate(so3.conjugate(q_nb), field_n) + what.magnet_b + noise
