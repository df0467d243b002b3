"""The local frame of an autopilot: an origin of its own, and metres by its own projection.

Neither autopilot uses the ellipsoid: ArduPilot takes a degree as 111318.8 m, on a sphere with the
equator's radius, PX4 a plane on a sphere of the mean radius. The same position has different metres
in each: they differ from each other and from the Earth by 2 m at 600 m, 10 m at 3 km.

Sources: ArduPilot, ``Location::get_distance_NE``, ``Location::offset_latlng``,
``LOCATION_SCALING_FACTOR``; PX4, ``MapProjection::project`` and ``reproject``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array
from sim_autopilot.personality import Kind

_EQUATOR = 0.011131884502145034 * 1e7 * 180.0 / math.pi
"""m per radian: ``LATLON_TO_M`` is per 1e-7 degrees."""
_NARROWEST = 0.01
"""Least cosine of a latitude (``longitude_scale``)."""
_MEAN = 6371000.0
"""m (``CONSTANTS_RADIUS_OF_EARTH``)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalFrame:
    """Positions as metres north, east and down of an origin, by one autopilot's projection."""

    kind: Kind
    lat: float
    """rad."""
    lon: float
    """rad."""
    alt: float
    """Above mean sea level, m."""

    def to_ned(self, lat: float, lon: float, alt: float) -> Array:
        """Return the metres of a geodetic position."""
        down = self.alt - alt
        if self.kind is Kind.ARDUPILOT:
            narrow = max(math.cos(0.5 * (lat + self.lat)), _NARROWEST)
            north, east = (lat - self.lat) * _EQUATOR, (lon - self.lon) * narrow * _EQUATOR
            return np.array([north, east, down])
        # Azimuthal equidistant
        apart = math.cos(lon - self.lon)
        rise = math.sin(self.lat) * math.sin(lat) + math.cos(self.lat) * math.cos(lat) * apart
        c = math.acos(min(1.0, max(-1.0, rise)))
        k = _MEAN * (c / math.sin(c) if c > 0.0 else 1.0)
        north = k * (
            math.cos(self.lat) * math.sin(lat) - math.sin(self.lat) * math.cos(lat) * apart
        )
        return np.array([north, k * math.cos(lat) * math.sin(lon - self.lon), down])

    def to_geodetic(self, pos_n: Array) -> tuple[float, float, float]:
        """Return latitude, longitude (rad) and altitude (m) of metres."""
        north, east, down = (float(value) for value in pos_n)
        alt = self.alt - down
        if self.kind is Kind.ARDUPILOT:
            lat = self.lat + north / _EQUATOR
            narrow = max(math.cos(0.5 * (lat + self.lat)), _NARROWEST)
            return lat, self.lon + east / (_EQUATOR * narrow), alt
        x, y = north / _MEAN, east / _MEAN
        c = math.hypot(x, y)
        if c == 0.0:
            return self.lat, self.lon, alt
        sin, cos = math.sin(c), math.cos(c)
        lat = math.asin(cos * math.sin(self.lat) + x * sin * math.cos(self.lat) / c)
        away = math.atan2(y * sin, c * math.cos(self.lat) * cos - x * math.sin(self.lat) * sin)
        return lat, self.lon + away, alt
