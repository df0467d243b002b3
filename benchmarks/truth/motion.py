"""A motion in, its exact inertial increments out.

A motion is a quintic spline of position in the tangent plane at the start, and an attitude that
follows from its velocity and acceleration. Both are differentiated on a fine grid:

    f_b = C_be (r'' + 2 w x r' - g)         specific force, all in ECEF; g with its centrifugal part
    dtheta = log(C_eb[k]^T Rz(w dt) C_eb[k+1])     rotation relative to inertial space
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from benchmarks.truth import earth
from benchmarks.truth.earth import Array

FINE = 1000
"""Points of the fine grid per second."""
KNOTS = 50
"""Knots of the spline per second."""
GRAVITY_T = np.array([0.0, 0.0, 9.81])
"""The gravity that a pilot leans against; a rough one, for attitudes only."""

Function = Callable[[Array], Array]
Attitude = Callable[[Array, Array, Array], Array]
"""C_tb, shape (n, 3, 3), from times, velocities and accelerations in the tangent plane."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A path and how the vehicle leans along it."""

    pos_t: Function
    """Position in the tangent plane at given times, shape (n, 3); smooth."""
    attitude: Attitude


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """The truth on the fine grid: of n points, and n - 1 increments between them."""

    t: Array
    pos_e: Array
    vel_n: Array
    C_en: Array
    C_nb: Array
    dtheta_b: Array
    """Integral of the angular rate relative to inertial space, rad."""
    dvel_b: Array
    """Integral of the specific force, m/s."""

    def index(self, t: Array) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Return the points of the grid at given times."""
        return np.clip(np.rint(t * FINE).astype(np.int64), 0, len(self.t) - 1)


def fly(motion: Motion, duration: float, place: tuple[float, float, float]) -> Flight:
    """Fly a motion from a place (latitude, longitude, height) on the turning Earth."""
    margin = 0.5
    knots = np.arange(-margin * KNOTS, (duration + margin) * KNOTS + 1) / KNOTS
    path = make_interp_spline(knots, motion.pos_t(knots), k=5)
    t = np.arange(round(duration * FINE) + 1) / FINE
    pos_t, vel_t, acc_t = path(t), path(t, 1), path(t, 2)
    C_tb = motion.attitude(t, vel_t, acc_t)

    lat, lon, alt = (np.float64(x) for x in place)
    C_et = earth.to_dcm(lat, lon)
    pos_e = earth.to_ecef(lat, lon, alt) + pos_t @ C_et.T
    vel_e, acc_e = vel_t @ C_et.T, acc_t @ C_et.T
    C_eb = C_et @ C_tb
    lat, lon, alt = earth.to_geodetic(pos_e)
    C_en = earth.to_dcm(lat, lon)

    gravity_e = earth.gravity(lat, alt)[:, None] * C_en[:, :, 2]
    force_e = acc_e + 2.0 * np.cross(earth.RATE_E, vel_e) - gravity_e
    force_b = rotate(transpose(C_eb), force_e)
    angle = earth.RATE / FINE
    turned = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    return Flight(
        t=t,
        pos_e=pos_e,
        vel_n=rotate(transpose(C_en), vel_e),
        C_en=C_en,
        C_nb=transpose(C_en) @ C_eb,
        dtheta_b=rotation_vector(transpose(C_eb[:-1]) @ (turned @ C_eb[1:])),
        dvel_b=(force_b[1:] + force_b[:-1]) / (2.0 * FINE),
    )


def rotate(C: Array, v: Array) -> Array:
    """Rotate vectors, shape (n, 3), by matrices, shape (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", C, v))


def transpose(C: Array) -> Array:
    """Return the inverse rotations."""
    return np.swapaxes(C, -1, -2)


def rotation_vector(C: Array) -> Array:
    """Return the logarithm of rotations by less than a right angle, shape (n, 3)."""
    axis = 0.5 * np.stack(
        [C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], axis=1
    )
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    return np.asarray(axis * np.where(sine > 1e-9, np.arcsin(sine) / np.maximum(sine, 1e-12), 1.0))


def from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """Return the matrices of yaw, then pitch, then roll, which turn b into t."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(x), np.cos(x)) for x in (roll, pitch, yaw))
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def posed(roll: Function, pitch: Function, yaw: Function) -> Attitude:
    """Return an attitude given as functions of time: a vehicle at rest, or turned by hand."""
    return lambda t, vel, acc: from_euler(roll(t), pitch(t), yaw(t))


def multirotor(yaw: Function) -> Attitude:
    """Return the attitude that points the rotors' thrust where the path needs it."""

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        down = GRAVITY_T - acc
        ahead = np.stack([np.cos(yaw(t)), np.sin(yaw(t)), np.zeros_like(t)], axis=1)
        return _axes(down, np.cross(down, ahead))

    return attitude


def aeroplane(wind_t: Array, roll: Function | None = None) -> Attitude:
    """Return coordinated flight: nose into the air flow, lift along -z; then an extra roll."""

    def attitude(t: Array, vel: Array, acc: Array) -> Array:
        ahead = vel - wind_t
        right = np.cross(GRAVITY_T - acc, ahead)
        C = _axes(np.cross(ahead, right), right)
        if roll is None:
            return C
        return C @ from_euler(roll(t), np.zeros_like(t), np.zeros_like(t))

    return attitude


def _axes(down: Array, right: Array) -> Array:
    z = down / np.linalg.norm(down, axis=1, keepdims=True)
    y = right / np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=2)
