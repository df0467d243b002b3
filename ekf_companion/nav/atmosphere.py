"""The standard atmosphere: pressure as an altitude.

Source: ICAO Doc 7488, Manual of the ICAO Standard Atmosphere, troposphere.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt

SEA_LEVEL_PRESSURE = 101325.0
"""Pa."""
_SCALE_HEIGHT = 288.15 / 0.0065
"""Temperature at sea level over its lapse rate, m."""
_EXPONENT = 0.0065 * 287.05287 / 9.80665

Value = TypeVar("Value", float, npt.NDArray[np.float64])


def pressure_altitude(pressure: Value) -> Value:
    """Give the altitude, m, at which the standard atmosphere has a pressure (Pa, > 0)."""
    altitude: Value = _SCALE_HEIGHT * (1.0 - (pressure / SEA_LEVEL_PRESSURE) ** _EXPONENT)
    return altitude
