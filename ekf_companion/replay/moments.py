"""Times as users have them: numbers, ``datetime64``, ``datetime`` with or without a zone."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import DataError
from ekf_companion.nav.arrays import Stamps

LAST_NS = 9e18
"""Time that 64 bits hold, ns: the year 2255."""

Moment = float | np.integer[Any] | np.floating[Any] | np.datetime64 | datetime
"""Floats are s, whole numbers ns, on the clock of all others; dates count from 1970 in UTC."""


def are_dates(values: npt.NDArray[Any]) -> bool:
    """Return whether an array holds dates."""
    if values.dtype.kind == "M":
        return True
    return values.dtype.kind == "O" and bool(values.size) and isinstance(values.flat[0], datetime)


def since_1970(name: str, values: npt.NDArray[Any]) -> Stamps:
    """Return dates as ns since 1970; those that name no zone are taken as they are.

    Raises:
        DataError: One is NaT, or some name a zone and others do not.
    """
    if values.dtype.kind == "O":
        zones = {getattr(one, "tzinfo", None) is not None for one in values.flat}
        if len(zones) > 1:
            raise DataError(f"{name}: some times name a zone and others do not; give all of a kind")
        values = np.array([_without_zone(name, one) for one in values.flat], dtype="datetime64[ns]")
    if np.isnat(values).any():
        raise DataError(f"{name}: holds NaT; leave such rows out")
    return values.astype("datetime64[ns]").astype(np.int64)


def _without_zone(name: str, one: Any) -> Any:
    """Return a ``datetime`` as one of UTC that names no zone."""
    # pandas.Timestamp has ns, which datetime has not
    if (convert := getattr(one, "to_datetime64", None)) is not None:
        return convert()
    if not isinstance(one, datetime):
        raise DataError(f"{name}: holds {one!r} among times; give all of a kind")
    return one if one.tzinfo is None else one.astimezone(timezone.utc).replace(tzinfo=None)


def stamp_ns(name: str, t: Moment) -> int:
    """Return one time in ns.

    Raises:
        DataError: It is no time, or beyond every clock.
    """
    value = np.asarray(t)
    if value.ndim == 0 and are_dates(value):
        return int(since_1970(name, value.reshape(1))[0])
    if value.ndim or value.dtype.kind not in "iuf" or not np.isfinite(value):
        raise DataError(f"{name}: {t!r} is no time; give s as a float, ns as an integer, or a date")
    t_ns = int(value) if value.dtype.kind in "iu" else float(value) * 1e9
    if not abs(t_ns) < LAST_NS:
        raise DataError(
            f"{name}: {t!r} is beyond every clock; floats are s and whole numbers ns: divide ms, "
            "us, ns"
        )
    return round(t_ns)
