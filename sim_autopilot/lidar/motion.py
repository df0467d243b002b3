"""Smooth motions of a vehicle, and the inertial samples of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_autopilot.lidar.worlds import Array
from sim_autopilot.truth import Trajectory

GRAVITY = 9.80665
_TO_UP = np.array([1.0, -1.0, -1.0])
"""From forward, right, down or north, east, down to z up: places and angles alike."""
_STEP = 1e-3
"""s, of central differences: the motions are smooth, so that they are exact to 1e-6 m/s2."""


@dataclass(frozen=True, slots=True)
class Motion:
    """A pose as a function of time, smooth in all derivatives."""

    pose: Callable[[Array], tuple[Array, Array]]
    """Takes t, s, shape (n,); returns position, m, and roll, pitch, yaw, rad, shape (n, 3) each."""

    def position(self, t: Array) -> Array:
        """Return the position in the world, m, shape (n, 3)."""
        return self.pose(t)[0]

    def rotation(self, t: Array) -> Array:
        """Return body to world, shape (n, 3, 3)."""
        return from_euler(self.pose(t)[1])

    def velocity(self, t: Array) -> Array:
        """Return the velocity in the world, m/s, shape (n, 3)."""
        return (self.position(t + _STEP) - self.position(t - _STEP)) / (2 * _STEP)

    def gyro(self, t: Array) -> Array:
        """Return the rate in the body, rad/s, shape (n, 3)."""
        change = np.swapaxes(self.rotation(t - _STEP), 1, 2) @ self.rotation(t + _STEP)
        axis = np.stack(
            (
                change[:, 2, 1] - change[:, 1, 2],
                change[:, 0, 2] - change[:, 2, 0],
                change[:, 1, 0] - change[:, 0, 1],
            ),
            -1,
        )
        return axis / (4 * _STEP)  # sin(angle) is the angle: it is a milliradian

    def accel(self, t: Array) -> Array:
        """Return the specific force in the body, m/s2, shape (n, 3)."""
        before, now, after = (self.position(t + step) for step in (-_STEP, 0.0, _STEP))
        force = (before - 2 * now + after) / _STEP**2 + (0.0, 0.0, GRAVITY)
        turned: Array = np.einsum("nji,nj->ni", self.rotation(t), force)
        return turned


def from_euler(angles: Array) -> Array:
    """Return the rotations body to world of roll, pitch, yaw, rad, shape (n, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(angles).T, np.sin(angles).T
    return np.stack(
        (
            np.stack((cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr), -1),
            np.stack((sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr), -1),
            np.stack((-sp, cp * sr, cp * cr), -1),
        ),
        -2,
    )


def _way(t: Array, speed: float, rest: float, ramp: float = 0.5) -> Array:
    """Return the way, m, of a vehicle at rest until `rest`, then at a speed."""
    return speed * ramp * np.logaddexp(0.0, (t - rest) / ramp)


def _swing(t: Array, begin: Array, *parts: tuple[float, float, float]) -> Array:
    """Return a sum of (amplitude, Hz, phase) that begins with the way."""
    total = np.zeros_like(t)
    for size, rate, phase in parts:
        total += size * np.sin(2 * np.pi * rate * t + phase)
    return total * begin


def _begin(t: Array, rest: float) -> Array:
    return 0.5 * (1.0 + np.tanh((t - rest) / 0.5))


def walk(t: Array) -> tuple[Array, Array]:
    """Return poses hand-held in a room: an ellipse, looking about."""
    way, on = _way(t, 0.8, 3.0), _begin(t, 3.0)
    angle = way / 2.0
    position = np.stack(
        (
            2.2 * np.cos(angle),
            1.5 * np.sin(angle),
            1.4 + _swing(t, on, (0.03, 1.8, 0.0)),
        ),
        -1,
    )
    yaw = angle + np.pi / 2 + _swing(t, on, (0.9, 0.23, 0.0), (0.15, 0.9, 1.0))
    roll = _swing(t, on, (0.10, 0.5, 0.3), (0.02, 1.8, 0.0))
    return position, np.stack((roll, _swing(t, on, (0.15, 0.37, 1.2)), yaw), -1)


def drive(t: Array) -> tuple[Array, Array]:
    """Return poses of a rover along x that changes its lane."""
    way, on = _way(t, 5.0, 3.0), _begin(t, 3.0)
    side = 1.5 * np.sin(way / 12.0)
    position = np.stack((way, side, 0.8 + _swing(t, on, (0.01, 2.3, 0.0))), -1)
    yaw = np.arctan(1.5 / 12.0 * np.cos(way / 12.0))
    roll, pitch = _swing(t, on, (0.01, 1.1, 0.0)), _swing(t, on, (0.008, 1.7, 1.0))
    return position, np.stack((roll, pitch, yaw), -1)


def crawl(t: Array) -> tuple[Array, Array]:
    """Return poses of a rover through a tunnel along x."""
    way, on = _way(t, 3.0, 3.0), _begin(t, 3.0)
    position = np.stack((way - 5.0, 0.5 * np.sin(way / 9.0), np.full(len(t), 1.2)), -1)
    yaw = np.arctan(0.5 / 9.0 * np.cos(way / 9.0)) + _swing(t, on, (0.08, 0.2, 0.0))
    roll, pitch = _swing(t, on, (0.01, 1.1, 0.0)), _swing(t, on, (0.01, 1.3, 1.0))
    return position, np.stack((roll, pitch, yaw), -1)


def orbit(radius: float, height: float, speed: float) -> Callable[[Array], tuple[Array, Array]]:
    """Return the poses of a drone that climbs and flies a circle about the origin."""

    def pose(t: Array) -> tuple[Array, Array]:
        way, on = _way(t, speed, 5.0), _begin(t, 5.0)
        angle = way / radius
        climb = 0.3 + (height - 0.3) * 0.5 * (1.0 + np.tanh((t - 4.0) / 1.5))
        position = np.stack(
            (
                radius * np.cos(angle),
                radius * np.sin(angle),
                climb + _swing(t, on, (0.4, 0.11, 0.0)),
            ),
            -1,
        )
        yaw = angle + np.pi / 2 + _swing(t, on, (0.7, 0.17, 0.0))
        bank = -(speed**2) / radius / GRAVITY * on
        roll = bank + _swing(t, on, (0.04, 0.6, 0.0))
        return position, np.stack((roll, 0.05 * on + _swing(t, on, (0.05, 0.45, 1.0)), yaw), -1)

    return pose


def of_trajectory(trajectory: Trajectory) -> Motion:
    """Return the motion of a flight of the fake autopilot: north, west, up of its home."""

    def pose(t: Array) -> tuple[Array, Array]:
        true = trajectory.at(np.clip(t, 0.0, None))
        return true.pos_n * _TO_UP, true.euler * _TO_UP

    return Motion(pose)


MOTIONS = {
    "room": Motion(walk),
    "street": Motion(drive),
    "forest": Motion(orbit(20.0, 3.0, 3.0)),
    "tunnel": Motion(crawl),
    "plain": Motion(orbit(25.0, 6.0, 4.0)),
    "hall": Motion(orbit(12.0, 5.0, 3.0)),
}
