"""Rotations and directions as curved spaces: how far apart two are, and the Jacobian of that.

A direction is a unit vector, moved by two angles about the axes of :func:`basis`, which are
normal to it.

Source: Sola 2017, arXiv 1711.02508, section 4.3 (right Jacobian of SO(3)); Hertzberg et al. 2013,
"Integrating generic sensor fusion algorithms with sound state representations through
encapsulation of manifolds"; He, Xu, Zhang 2021, arXiv 2102.03804 (the sphere in a filter).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.strapdown import cross, skew
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

_SMALL = 1e-4
"""Angle below which the coefficients are their series, rad: the next terms are 1e-10 of them."""


def turn_jacobian(phi: Array) -> Array:
    """Return the derivative of log(exp(-phi) exp(phi + d)) by d at 0, shape (3, 3).

    The right Jacobian of SO(3).

    Args:
        phi: Rotation vector, rad, shape (3,).
    """
    angle = math.sqrt(float(phi @ phi))
    if angle < _SMALL:
        first, second = 0.5, 1.0 / 6.0
    else:
        first = (1.0 - math.cos(angle)) / angle**2
        second = (angle - math.sin(angle)) / angle**3
    X = skew(phi)
    return np.asarray(np.eye(3) - first * X + second * (X @ X))


def turn_jacobian_inverse(phi: Array) -> Array:
    """Return the derivative of log(exp(phi) exp(d)) by d at 0, shape (3, 3); |phi| < 2 pi."""
    angle = math.sqrt(float(phi @ phi))
    if angle < _SMALL:
        second = 1.0 / 12.0
    else:
        second = (1.0 - 0.5 * angle / math.tan(0.5 * angle)) / angle**2
    X = skew(phi)
    return np.asarray(np.eye(3) + 0.5 * X + second * (X @ X))


def basis(direction: Array) -> Array:
    """Return two axes normal to a direction and to each other, shape (3, 2)."""
    x, y, z = direction.tolist()
    # Duff et al. 2017, JCGT 6(1): no direction is singular
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])


def direction_plus(direction: Array, u: Array) -> Array:
    """Turn a direction by two angles (rad, shape (2,)) about the axes of its basis."""
    moved = so3.rotate(so3.exp(basis(direction) @ u), direction)
    return np.asarray(moved / math.sqrt(float(moved @ moved)))


def direction_minus(to: Array, start: Array) -> Array:
    """Return the two angles that turn one direction into another the shorter way, rad."""
    return np.asarray(basis(start).T @ (_ratio(to, start)[0] * cross(start, to)))


def direction_by_turn(direction: Array) -> Array:
    """Return the derivative of :func:`direction_plus` by the angles at 0, shape (3, 2)."""
    return np.asarray(-skew(direction) @ basis(direction))


def direction_jacobian(to: Array, start: Array) -> Array:
    """Return the derivative of (to plus u) minus start by u at 0, shape (2, 2)."""
    ratio, slope = _ratio(to, start)
    by_to = ratio * skew(start) + slope * np.outer(cross(start, to), start)
    return np.asarray(basis(start).T @ by_to @ direction_by_turn(to))


def _ratio(to: Array, start: Array) -> tuple[float, float]:
    """Return angle / sin(angle) between two directions, and its derivative by the cosine."""
    axis = cross(start, to)
    sine, cosine = math.sqrt(float(axis @ axis)), float(start @ to)
    angle = math.atan2(sine, cosine)
    if angle < _SMALL:
        return 1.0, -1.0 / 3.0
    # Opposite directions have no shorter way: any is as good
    sine = max(sine, 1e-12)
    return angle / sine, -(sine - angle * cosine) / sine**3
