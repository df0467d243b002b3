"""Positions on the Earth, and the projections by which each autopilot computes them.

All tracks are compared as metres north, east and down of ``HOME``, by the ellipsoid's radii there:
the same for all of them, so that only a difference of latitude, longitude or altitude is an error.

Source: ArduPilot ``Location::offset_latlng``, ``longitude_scale`` (a sphere of 6378100 m, the
longitude by the cosine of the mean latitude); PX4 ``MapProjection::reproject`` (azimuthal
equidistant, a sphere of 6371000 m).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ekf_companion.nav import earth
from ekf_companion.nav.arrays import Array


class Places(NamedTuple):
    """One position or several."""

    lat: Array
    """deg."""
    lon: Array
    """deg."""
    alt: Array
    """m above mean sea level."""


HOME = Places(np.float64(47.397743), np.float64(8.545594), np.float64(489.4))
"""Where the simulators start."""
ARDUPILOT_RADIUS = 6378100.0
"""m."""
PX4_RADIUS = 6371000.0
"""m."""


def from_home(places: Places) -> Array:
    """Return metres north, east and down of ``HOME``, shape (n, 3)."""
    meridian, transverse = earth.radii(np.deg2rad(HOME.lat))
    north = np.deg2rad(places.lat - HOME.lat) * (meridian + HOME.alt)
    east = np.deg2rad(places.lon - HOME.lon) * (transverse + HOME.alt)
    east = east * np.cos(np.deg2rad(HOME.lat))
    return np.stack([north, east, HOME.alt - places.alt], axis=-1)


def by_ardupilot(pos_n: Array, origin: Places) -> Places:
    """Return the positions of metres about an origin, shape (n, 3), by ArduPilot's projection."""
    lat = origin.lat + np.rad2deg(pos_n[:, 0] / ARDUPILOT_RADIUS)
    scale = np.maximum(np.cos(np.deg2rad(0.5 * (origin.lat + lat))), 0.01)
    lon = origin.lon + np.rad2deg(pos_n[:, 1] / ARDUPILOT_RADIUS / scale)
    return Places(lat, lon, origin.alt - pos_n[:, 2])


def by_px4(pos_n: Array, origin: Places) -> Places:
    """Return the positions of metres about an origin, shape (n, 3), by PX4's projection."""
    north, east = pos_n[:, 0] / PX4_RADIUS, pos_n[:, 1] / PX4_RADIUS
    c = np.hypot(north, east)
    share = np.sinc(c / np.pi)  # sin(c) / c
    lat0 = np.deg2rad(origin.lat)
    lat = np.arcsin(np.cos(c) * np.sin(lat0) + north * share * np.cos(lat0))
    lon = np.arctan2(east * share, np.cos(lat0) * np.cos(c) - north * share * np.sin(lat0))
    return Places(np.rad2deg(lat), origin.lon + np.rad2deg(lon), origin.alt - pos_n[:, 2])


def latest(t: Array, stamps: Array, places: Places) -> Places:
    """Return for each time the last position stated; before the first, the first."""
    rows = np.maximum(np.searchsorted(stamps, t, side="right") - 1, 0)
    return Places(places.lat[rows], places.lon[rows], places.alt[rows])
