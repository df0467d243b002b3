"""The Earth: WGS-84 ellipsoid, its gravity and rate, and the local frame.

Source: NIMA TR8350.2, 3rd edition; Groves 2013, "Principles of GNSS, inertial, and multisensor
integrated navigation systems", 2nd edition, chapters 2 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array
from ekf_companion.nav.so3 import wrap

SEMI_MAJOR_AXIS = 6378137.0
"""m."""
FLATTENING = 1.0 / 298.257223563
ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)
ROTATION_RATE = 7.292115e-5
"""rad/s."""
GRAVITY_EQUATOR = 9.7803253359
"""m/s^2."""
SOMIGLIANA = 0.00193185265241
"""Somigliana's constant of the normal gravity on the ellipsoid."""
FREE_AIR = 3.0877e-6
"""Loss of gravity with height at mid latitude, 1/s^2 (Groves 2.139, first order, 45 deg)."""
STANDARD_GRAVITY = 9.80665
"""m/s^2: the unit g of accelerometers."""


def is_place(lat_deg: Any, lon_deg: Any) -> Any:
    """Return whether latitude and longitude can be a position; 0, 0 is sent where there is none.

    Takes the numbers of one message, or arrays.
    """
    is_within = (abs(lat_deg) <= 90.0) & (abs(lon_deg) <= 180.0)  # and known
    return is_within & ((lat_deg != 0.0) | (lon_deg != 0.0))


def radii(lat: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the meridian and the transverse radius of curvature, m, at a latitude (rad)."""
    sin2 = np.square(np.sin(np.asarray(lat, dtype=float)))
    w2 = 1.0 - ECCENTRICITY_SQUARED * sin2
    transverse = SEMI_MAJOR_AXIS / np.sqrt(w2)
    meridian = SEMI_MAJOR_AXIS * (1.0 - ECCENTRICITY_SQUARED) / (w2 * np.sqrt(w2))
    return np.asarray(meridian), np.asarray(transverse)


def gravity(lat: npt.ArrayLike, alt: npt.ArrayLike) -> Array:
    """Return the normal gravity, down, m/s^2, at a latitude (rad) and a height (m)."""
    sin2 = np.square(np.sin(np.asarray(lat, dtype=float)))
    surface = (
        GRAVITY_EQUATOR * (1.0 + SOMIGLIANA * sin2) / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)
    )
    return np.asarray(surface - FREE_AIR * np.asarray(alt, dtype=float))


def earth_rate_n(lat: npt.ArrayLike) -> Array:
    """Return the Earth's rotation in n, rad/s, at a latitude (rad), shape (..., 3)."""
    lat = np.asarray(lat, dtype=float)
    return ROTATION_RATE * np.stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)], axis=-1)


def transport_rate_n(lat: npt.ArrayLike, alt: npt.ArrayLike, vel_n: Array) -> Array:
    """Return the transport rate: of n relative to the Earth, by motion, rad/s, shape (..., 3)."""
    lat, alt = np.asarray(lat, dtype=float), np.asarray(alt, dtype=float)
    meridian, transverse = radii(lat)
    east = vel_n[..., 1] / (transverse + alt)
    return np.stack([east, -vel_n[..., 0] / (meridian + alt), -east * np.tan(lat)], axis=-1)


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Metres north, east and down of an origin, along the radii of curvature there.

    A curvilinear frame: equal down means equal altitude however far away, and equal north means
    equal latitude. It agrees with the tangent plane to 8 cm at 1 km (the curvature of the Earth).
    """

    lat: float
    """Latitude of the origin, rad."""
    lon: float
    """Longitude of the origin, rad."""
    alt: float
    """Altitude of the origin above mean sea level, m."""

    @property
    def scale(self) -> tuple[float, float]:
        """Return metres per radian of latitude, and of longitude, at the origin."""
        meridian, transverse = radii(self.lat)
        return (
            float(meridian) + self.alt,
            (float(transverse) + self.alt) * float(np.cos(self.lat)),
        )

    def to_ned(self, lat: npt.ArrayLike, lon: npt.ArrayLike, alt: npt.ArrayLike) -> Array:
        """Return north, east, down, m, shape (..., 3), of latitude, longitude (rad), altitude."""
        north, east = self.scale
        dlon = wrap(np.asarray(lon, dtype=float) - self.lon)
        return np.stack(
            np.broadcast_arrays(
                (np.asarray(lat, dtype=float) - self.lat) * north,
                dlon * east,
                self.alt - np.asarray(alt, dtype=float),
            ),
            axis=-1,
        )

    def to_geodetic(self, pos_n: Array) -> tuple[Array, Array, Array]:
        """Return latitude, longitude (rad, in [-pi, pi)) and altitude (m) of north, east, down."""
        north, east = self.scale
        pos_n = np.asarray(pos_n, dtype=float)
        lon = wrap(self.lon + pos_n[..., 1] / east)
        return self.lat + pos_n[..., 0] / north, lon, self.alt - pos_n[..., 2]


SIMULATED = LocalFrame(
    lat=float(np.radians(75.0)),
    lon=0.15,
    alt=float((gravity(np.radians(75.0), 160.0) - 9.81) / FREE_AIR),
)
"""Origin given to a simulation over a flat Earth that does not turn, with gravity of 9.81 m/s^2
(160 m above its sea), so that it can be read as a flight. So far north the Earth turns about nearly
the vertical, which a gyro bias explains, and an eastward speed adds little weight."""

SEA_LEVEL_PRESSURE = 101325.0
"""Pa."""
_SCALE_HEIGHT = 288.15 / 0.0065
"""Temperature at sea level over its lapse rate, m."""
_EXPONENT = 0.0065 * 287.05287 / 9.80665
TROPOSPHERE = -5_000.0, 11_000.0
"""m; where the standard atmosphere (ICAO Doc 7488) has this lapse rate: from the lowest altitude of
its tables to the tropopause. No other pressure is read as an altitude."""

Value = TypeVar("Value", float, Array)


def pressure_altitude(pressure: Value) -> Value:
    """Return the altitude, m, at which the standard atmosphere has a pressure (Pa, > 0)."""
    altitude: Value = _SCALE_HEIGHT * (1.0 - (pressure / SEA_LEVEL_PRESSURE) ** _EXPONENT)
    return altitude


def standard_pressure(altitude: float) -> float:
    """Return the pressure, Pa, that the standard atmosphere has at an altitude, m."""
    return float(SEA_LEVEL_PRESSURE * (1.0 - altitude / _SCALE_HEIGHT) ** (1.0 / _EXPONENT))


PRESSURES = standard_pressure(TROPOSPHERE[1]), standard_pressure(TROPOSPHERE[0])
"""Pa; of the troposphere, the least first: 226 to 1777 hPa. In hPa or in Pa: both cannot be."""
