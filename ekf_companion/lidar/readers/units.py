"""Units by likelihood: of units a thousand apart, the one whose value is nearest to what is usual.

Where nothing else is known the logarithm of a rate is as likely on either side of the usual one,
so that the nearest on the logarithmic scale is the most likely, without a threshold.
"""

from __future__ import annotations

import numpy as np

SECONDS = {1.0: "seconds", 1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds"}
"""Units of time, s."""
ACCELERATION = {1.0: "m/s2", 9.80665: "g", 9.80665e-3: "mg", 1e-2: "cm/s2"}
"""Units of specific force, m/s2."""
SPEED = {1.0: "m/s", 1 / 3.6: "km/h", 1e-2: "cm/s", 1e-3: "mm/s"}
"""Units of radial speeds, m/s."""
LENGTH = {1.0: "metres", 1e-3: "millimetres"}
"""Units of points, m."""


def nearest(value: float, usual: float, units: dict[float, str]) -> float:
    """Return the unit in which a value is nearest to the usual one, as a ratio."""
    return min(units, key=lambda unit: abs(np.log(value * unit / usual)))
