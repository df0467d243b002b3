"""Projections by which autopilots turn latitude and longitude into metres of a local frame.

They use a sphere, which differs from WGS-84 by 0.3 %, 2 m at 600 m. So positions that are sent to
an autopilot are in metres of its own projection.
"""

from __future__ import annotations

import math
from typing import Protocol

from ekf_companion.nav.so3 import wrap


class Projection(Protocol):
    """Metres north and east of an origin; angles in rad."""

    is_azimuthal: bool
    radius: float
    """m."""

    def to_metres(self, lat: float, lon: float, lat_0: float, lon_0: float) -> tuple[float, float]:
        """Return north and east of the origin, m."""
        ...

    def to_geodetic(
        self, north: float, east: float, lat_0: float, lon_0: float
    ) -> tuple[float, float]:
        """Return latitude and longitude of metres north and east of the origin."""
        ...


class EquirectangularSphere:
    """A degree of latitude has one length; that of longitude is its cosine at the middle latitude.

    Source: ArduPilot, ``Location::get_distance_NE``, ``Location::offset_latlng``.
    """

    is_azimuthal = False

    def __init__(self, radius: float) -> None:
        self.radius = radius
        """m."""

    def to_metres(self, lat: float, lon: float, lat_0: float, lon_0: float) -> tuple[float, float]:
        """Return north and east of the origin, m."""
        scale = math.cos(0.5 * (lat + lat_0))
        return self.radius * (lat - lat_0), self.radius * scale * float(wrap(lon - lon_0))

    def to_geodetic(
        self, north: float, east: float, lat_0: float, lon_0: float
    ) -> tuple[float, float]:
        """Return latitude and longitude of metres north and east of the origin."""
        lat = lat_0 + north / self.radius
        scale = math.cos(0.5 * (lat + lat_0))
        return lat, float(wrap(lon_0 + east / (self.radius * scale)))


class AzimuthalEquidistant:
    """Distance and direction from the origin are those of the great circle.

    Source: Snyder 1987, "Map projections: a working manual", USGS PP 1395, equations 25-1 to 25-4
    and 20-14, 20-15; PX4, ``lib/geo``, ``MapProjection``.
    """

    is_azimuthal = True

    def __init__(self, radius: float) -> None:
        self.radius = radius
        """m."""

    def to_metres(self, lat: float, lon: float, lat_0: float, lon_0: float) -> tuple[float, float]:
        """Return north and east of the origin, m."""
        dlon = lon - lon_0
        north = math.cos(lat_0) * math.sin(lat) - math.sin(lat_0) * math.cos(lat) * math.cos(dlon)
        east = math.cos(lat) * math.sin(dlon)
        along = math.sin(lat_0) * math.sin(lat) + math.cos(lat_0) * math.cos(lat) * math.cos(dlon)
        across = math.hypot(north, east)
        # by the angle's tangent: its cosine alone is one to the last digit a hundred metres away
        scale = math.atan2(across, along) / across if across > 0.0 else 1.0
        return self.radius * scale * north, self.radius * scale * east

    def to_geodetic(
        self, north: float, east: float, lat_0: float, lon_0: float
    ) -> tuple[float, float]:
        """Return latitude and longitude of metres north and east of the origin."""
        distance = math.hypot(north, east)
        if distance == 0.0:
            return lat_0, float(wrap(lon_0))
        c = distance / self.radius
        lat = math.asin(
            math.cos(c) * math.sin(lat_0) + north / distance * math.sin(c) * math.cos(lat_0)
        )
        dlon = math.atan2(
            east * math.sin(c),
            distance * math.cos(lat_0) * math.cos(c) - north * math.sin(lat_0) * math.sin(c),
        )
        return lat, float(wrap(lon_0 + dlon))


ARDUPILOT = EquirectangularSphere(6378100.0)
"""ArduPilot's ``LOCATION_SCALING_FACTOR``: 0.0111318845 m for 1e-7 deg."""
PX4 = AzimuthalEquidistant(6371000.0)
"""PX4's ``CONSTANTS_RADIUS_OF_EARTH``."""
