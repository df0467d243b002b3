"""Directions: unit vectors on the sphere, changed by two angles about axes normal to them.

Source: He, Xu, Zhang 2021, arXiv 2102.03804 (the sphere in a filter).
"""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.so3 import cross, skew

_SMALL = 1e-4
"""Angle below which the coefficients are their series, rad: the next terms are 1e-10 of them."""


def basis(direction: Array) -> Array:
    """Return two axes normal to a direction and to each other, shape (3, 2)."""
    x, y, z = direction.tolist()
    # Duff et al. 2017, JCGT 6(1): no direction is singular
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.array([[1.0 + sign * x * x * a, b], [sign * b, sign + y * y * a], [-sign * x, -y]])


def direction_plus(direction: Array, u: Array) -> Array:
    """Rotate a direction by two angles (rad, shape (2,)) about the axes of its basis."""
    there = so3.rotate(so3.exp(basis(direction) @ u), direction)
    return np.asarray(there / math.sqrt(float(there @ there)))


def direction_minus(to: Array, start: Array) -> Array:
    """Return the two angles that rotate one direction into another the shorter way, rad."""
    return np.asarray(basis(start).T @ (_ratio(to, start)[0] * cross(start, to)))


def direction_by_angles(direction: Array) -> Array:
    """Return the derivative of :func:`direction_plus` by the angles at 0, shape (3, 2)."""
    return np.asarray(-skew(direction) @ basis(direction))


def direction_jacobian(to: Array, start: Array) -> Array:
    """Return the derivative of (to plus u) minus start by u at 0, shape (2, 2)."""
    ratio, slope = _ratio(to, start)
    by_to = ratio * skew(start) + slope * np.outer(cross(start, to), start)
    return np.asarray(basis(start).T @ by_to @ direction_by_angles(to))


def levelled(down: Array) -> Array:
    """Return the smallest rotation that turns a direction to -z, shape (3, 3).

    Of the opposite one, which all half turns turn there, it is that about x.
    """
    axis = cross(down, np.array([0.0, 0.0, -1.0]))
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, -down[2]))
    turn = axis * (angle / sine) if sine > 1e-12 else np.array([angle, 0.0, 0.0])
    return so3.to_matrix(so3.exp(turn))


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
