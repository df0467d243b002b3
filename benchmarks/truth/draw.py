"""What differs from seed to seed, and functions of time that motions and faults are made of."""

from __future__ import annotations

import numpy as np

from benchmarks.truth.earth import Array
from benchmarks.truth.motion import Function

DEG = np.pi / 180.0
TURN = 2.0 * np.pi


class Draw:
    """What differs from seed to seed."""

    def __init__(self, seed: int, name: str) -> None:
        self.rng = np.random.default_rng([seed, *name.encode()])

    def about(self, value: float, share: float = 0.3) -> float:
        """Draw around a value, within a share of it."""
        return value * self.rng.uniform(1.0 - share, 1.0 + share)

    def sign(self) -> float:
        """Draw -1 or 1."""
        return float(self.rng.choice([-1.0, 1.0]))

    def angle(self) -> float:
        """Draw any angle."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def level(self) -> Array:
        """Draw a horizontal unit vector."""
        angle = self.angle()
        return np.array([np.cos(angle), np.sin(angle), 0.0])

    def unit(self) -> Array:
        """Draw a unit vector."""
        v = self.rng.standard_normal(3)
        return np.asarray(v / np.linalg.norm(v))

    def wander(self, std: float, slowest: float, fastest: float) -> Function:
        """Draw a smooth wandering function of one sigma, its periods between two, s."""
        waves = 12
        rate = TURN / np.exp(self.rng.uniform(np.log(fastest), np.log(slowest), waves))
        phase = self.rng.uniform(0.0, TURN, waves)
        share = std * np.sqrt(2.0 / waves)
        return lambda t: share * np.sin(np.multiply.outer(t, rate) + phase).sum(axis=-1)


def ramp(t: Array, begin: float, length: float) -> Array:
    """Rise from 0 to 1 with two continuous derivatives."""
    x = np.clip((t - begin) / length, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def ramped(t: Array, begin: float, length: float) -> Array:
    """Return the integral of `ramp`: time that begins to run softly."""
    x = np.clip((t - begin) / length, 0.0, 1.0)
    return np.asarray(
        length * (2.5 * x**4 - 3.0 * x**5 + x**6) + np.maximum(t - begin - length, 0.0)
    )


def still(value: float) -> Function:
    """Return a constant function of time."""
    return lambda t: np.full_like(t, value)


def integrated(t: Array, rate: Function) -> Array:
    """Integrate a function of time, one or more columns, from the first time on."""
    dt = 1.0 / 400.0
    fine = t[0] + dt * np.arange(round((t[-1] - t[0]) / dt) + 2)
    values = rate(fine)
    total = np.zeros_like(values)
    np.cumsum(0.5 * dt * (values[1:] + values[:-1]), axis=0, out=total[1:])
    if values.ndim == 1:
        return np.asarray(np.interp(t, fine, total))
    return np.stack([np.interp(t, fine, column) for column in total.T], axis=1)
