"""Frame i: the body, turned back by what the gyro says; it hardly turns itself.

In plain numbers, component by component: it is done for every sample.
"""

from __future__ import annotations

import math

Rows = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

Quaternion = tuple[float, float, float, float]


def turned(q: Quaternion, wx: float, wy: float, wz: float, dt: float) -> Quaternion:
    """Turn an attitude of unit norm by a rate in b, rad/s, over a time, s."""
    half = 0.5 * dt * math.sqrt(wx * wx + wy * wy + wz * wz)
    s = 0.5 * dt * (math.sin(half) / half if half > 1e-8 else 1.0)
    c, sx, sy, sz = math.cos(half), s * wx, s * wy, s * wz
    w, x, y, z = q
    w, x, y, z = (
        w * c - x * sx - y * sy - z * sz,
        w * sx + x * c + y * sz - z * sy,
        w * sy - x * sz + y * c + z * sx,
        w * sz + x * sy - y * sx + z * c,
    )
    size = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # one step of Newton to unit norm
    return w * size, x * size, y * size, z * size


class Strapdown:
    """The body in frame i, and what is summed up there over a step."""

    def __init__(self) -> None:
        self.q_ib = (1.0, 0.0, 0.0, 0.0)
        self.rows: Rows = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        """C_ib."""
        self.clear()

    def clear(self) -> None:
        """Begin a step."""
        self.elapsed = 0.0
        self.turn2 = 0.0
        """Integral of the squared rate, rad^2/s."""
        self.integral = [0.0] * 9
        """Of C_ib, s, by rows."""
        self.field = [0.0, 0.0, 0.0]
        self.fields = 0

    def turn(self, gyro: list[float], bias: list[float], dt: float) -> None:
        """Turn the body by a rate over a time."""
        wx, wy, wz = gyro[0] - bias[0], gyro[1] - bias[1], gyro[2] - bias[2]
        rate2 = wx * wx + wy * wy + wz * wz
        w, x, y, z = self.q_ib = turned(self.q_ib, wx, wy, wz, dt)
        self.rows = (
            (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
            (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
            (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
        )
        self.elapsed += dt
        self.turn2 += rate2 * dt
        total = self.integral
        for i, row in enumerate(self.rows):
            total[3 * i] += row[0] * dt
            total[3 * i + 1] += row[1] * dt
            total[3 * i + 2] += row[2] * dt

    def out(self, v: list[float]) -> tuple[float, float, float]:
        """Turn a vector of b into i."""
        x, y, z = v
        first, second, third = self.rows
        return (
            first[0] * x + first[1] * y + first[2] * z,
            second[0] * x + second[1] * y + second[2] * z,
            third[0] * x + third[1] * y + third[2] * z,
        )

    def see(self, mag: list[float]) -> None:
        """Sum up a field of b."""
        for i, value in enumerate(self.out(mag)):
            self.field[i] += value
        self.fields += 1
