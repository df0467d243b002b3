"""The directions of a lidar's rays as a function of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sim_autopilot.lidar.worlds import Array


@dataclass(frozen=True, slots=True)
class Beams:
    """A lidar: its rays, and the errors of its ranges."""

    name: str
    rings: int
    """Lasers."""
    shots: int
    """Firings of all lasers in one scan."""
    low: float
    """deg, of the lowest laser."""
    high: float
    """deg, of the highest."""
    is_rosette: bool = False
    """Directions that never repeat, as a Livox has, instead of a turning head."""
    rate: float = 10.0
    """Scans a second."""
    nearest: float = 0.5
    """m."""
    farthest: float = 80.0
    """m."""
    range_sigma: float = 0.02
    """m at right angles to a wall, half as much more at a grazing one."""
    range_bias: float = 0.003
    """m, one sigma, of each laser, constant."""
    angle_sigma: float = 0.0002
    """rad."""
    missing: float = 0.04
    """Share of rays without a return, and more far away."""

    def fire(self, t: Array) -> tuple[Array, Array, npt.NDArray[np.uint8]]:
        """Return times, unit vectors in the lidar's frame, shape (n, 3), and lasers of a scan.

        Args:
            t: s, of each firing; the rays of one firing follow within it.
        """
        ring = np.tile(np.arange(self.rings, dtype=np.uint8), len(t))
        step = 1.0 / (self.rate * self.shots * self.rings)
        times = np.repeat(t, self.rings) + ring * step
        if self.is_rosette:
            # Two wedges that turn at rates without a common period
            one, two = 2 * np.pi * 77.31 * times, 2 * np.pi * 121.897 * times
            azimuth = (
                2 * np.pi * 9.713 * times + 2.2 * np.sin(one) + ring * (2 * np.pi / self.rings)
            )
            middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
            elevation = np.radians(middle + half * np.sin(two + 0.7 * one))
        else:
            azimuth = -2 * np.pi * self.rate * times
            elevation = np.radians(np.linspace(self.low, self.high, self.rings))[ring]
        flat = np.cos(elevation)
        direction = np.stack(
            (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), -1
        )
        return times, direction, ring


BEAMS = {
    one.name: one
    for one in (
        Beams("spin16", 16, 150, -15, 15),
        Beams("spin32", 32, 75, -25, 15),
        Beams("rosette", 4, 600, -7, 52, is_rosette=True, nearest=0.1, farthest=60),
    )
}
