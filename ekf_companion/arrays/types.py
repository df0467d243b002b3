"""Types of what a user gives: for editors and type checkers, which then know columns and names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypedDict

import numpy.typing as npt


class _Timed(TypedDict):
    time: npt.ArrayLike
    """Shape (m,): floats in s, integers in ns, or dates."""


class Fixes(_Timed, total=False):
    """Fixes of a GNSS receiver; ``lat_deg`` and ``lon_deg``, or ``lat_rad`` and ``lon_rad``."""

    lat_deg: npt.ArrayLike
    lon_deg: npt.ArrayLike
    lat_rad: npt.ArrayLike
    lon_rad: npt.ArrayLike
    alt: npt.ArrayLike
    """m above mean sea level, shape (m,); needed."""
    vel_n: npt.ArrayLike
    """North, east, down, m/s, shape (m, 3)."""
    std_h: npt.ArrayLike
    """One sigma, m: a number or shape (m,)."""
    std_v: npt.ArrayLike
    """m."""
    std_vel: npt.ArrayLike
    """m/s."""


class Headings(_Timed, total=False):
    """Headings of a dual-antenna receiver or of another estimator."""

    heading: npt.ArrayLike
    """From true north, clockwise, rad, shape (m,); needed."""
    std: npt.ArrayLike
    """One sigma, rad."""


class MagneticField(_Timed):
    """Readings of a magnetometer."""

    field: npt.ArrayLike
    """Body axes, gauss, shape (m, 3)."""


class Heights(_Timed, total=False):
    """Readings of a barometer: one of the two."""

    alt: npt.ArrayLike
    """m, shape (m,)."""
    pressure: npt.ArrayLike
    """Pa, shape (m,)."""


class Units(TypedDict, total=False):
    """Units that are not ns or s, rad/s, m/s^2 and gauss."""

    time: Literal["s", "ms", "us", "ns"]
    gyro: Literal["rad/s", "deg/s", "dps"]
    accel: Literal["m/s2", "g"]
    mag: Literal["gauss", "uT", "mG", "nT"]


Columns = Mapping[str, npt.ArrayLike]
"""A dict that was not declared as one of the above, or the columns of a data frame."""
