"""The Earth's magnetic field by the World Magnetic Model 2025."""

from __future__ import annotations

import math
from functools import lru_cache

from pygeomag import GeoMag

CELL = 0.01
"""Side of the squares of latitude and longitude that share one field, deg: about 1 km."""


@lru_cache(maxsize=1)
def _model() -> GeoMag:
    return GeoMag(coefficients_file="wmm/WMM_2025.COF")


def magnetic_field(lat: float, lon: float, year: float) -> tuple[float, float, float]:
    """Return declination (rad, east +), inclination (rad, down +) and strength (gauss).

    The field is that at sea level, constant over a square of 0.01 deg, at a decimal year from
    2025.0 to 2030.0.

    Source: NOAA NCEI, The US/UK World Magnetic Model for 2025-2030.
    """
    return _cell(round(math.degrees(lat) / CELL), round(math.degrees(lon) / CELL), year)


@lru_cache(maxsize=4096)
def _cell(row: int, column: int, year: float) -> tuple[float, float, float]:
    field = _model().calculate(
        glat=max(-90.0, min(90.0, row * CELL)), glon=column * CELL, alt=0.0, time=year
    )
    return math.radians(field.d), math.radians(field.i), field.f * 1e-5
