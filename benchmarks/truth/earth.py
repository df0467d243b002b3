"""WGS-84: geodetic and ECEF positions, axes of north, east and down, gravity.

Source: NIMA TR8350.2, 3rd ed., ch. 3 and 4; B. R. Bowring, Survey Review 23 (1976), p. 323.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

A = 6378137.0
"""Equatorial radius, m."""
F = 1.0 / 298.257223563
"""Flattening."""
B = A * (1.0 - F)
"""Polar radius, m."""
E2 = F * (2.0 - F)
"""First eccentricity squared."""
GM = 3.986004418e14
"""Gravitational constant of the Earth, m3/s2."""
RATE = 7.292115e-5
"""Rate of rotation, rad/s, about the z axis of ECEF."""
RATE_E = np.array([0.0, 0.0, RATE])
GRAVITY_EQUATOR, GRAVITY_POLE = 9.7803253359, 9.8321849378
"""Normal gravity on the ellipsoid, m/s2."""


def to_ecef(lat: Array, lon: Array, alt: Array) -> Array:
    """Return ECEF positions, shape (..., 3), of latitudes, longitudes and heights."""
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    level = (n + alt) * np.cos(lat)
    up = ((1.0 - E2) * n + alt) * np.sin(lat)
    return np.stack([level * np.cos(lon), level * np.sin(lon), up], axis=-1)


def to_geodetic(pos_e: Array) -> tuple[Array, Array, Array]:
    """Return latitude, longitude and height; exact to nanometres near the ground (Bowring)."""
    x, y, z = np.moveaxis(pos_e, -1, 0)
    p = np.hypot(x, y)
    reduced = np.arctan2(z * A, p * B)
    lat = np.arctan2(
        z + E2 / (1.0 - E2) * B * np.sin(reduced) ** 3, p - E2 * A * np.cos(reduced) ** 3
    )
    n = A / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    alt = p * np.cos(lat) + z * np.sin(lat) - A**2 / n
    return lat, np.arctan2(y, x), alt


def to_dcm(lat: Array, lon: Array) -> Array:
    """Return C_en, which turns north, east, down into ECEF, shape (..., 3, 3)."""
    s_lat, c_lat, s_lon, c_lon = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    north = np.stack([-s_lat * c_lon, -s_lat * s_lon, c_lat], axis=-1)
    east = np.stack([-s_lon, c_lon, np.zeros_like(s_lon)], axis=-1)
    down = np.stack([-c_lat * c_lon, -c_lat * s_lon, -s_lat], axis=-1)
    return np.stack([north, east, down], axis=-1)


def gravity(lat: Array, alt: Array) -> Array:
    """Return normal gravity along down, centrifugal part included, m/s2.

    Somigliana's formula on the ellipsoid, to the second order of the height above it.
    """
    s2 = np.sin(lat) ** 2
    k = B * GRAVITY_POLE / (A * GRAVITY_EQUATOR) - 1.0
    on_ellipsoid = GRAVITY_EQUATOR * (1.0 + k * s2) / np.sqrt(1.0 - E2 * s2)
    m = (RATE * A) ** 2 * B / GM
    free_air = 1.0 - 2.0 / A * (1.0 + F + m - 2.0 * F * s2) * alt + 3.0 * (alt / A) ** 2
    return np.asarray(on_ellipsoid * free_air)
