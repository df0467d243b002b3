"""Reading of the arrays that a user gives: shape, unit, and which rows can be used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import ConfigError, DataError
from ekf_companion.nav.arrays import Array, Mask, Stamps, known_rows
from ekf_companion.nav.earth import STANDARD_GRAVITY
from ekf_companion.replay.moments import LAST_NS, are_dates, since_1970
from ekf_companion.review import plausibility

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0},
    "gyro": {"rad/s": 1.0, "deg/s": float(np.deg2rad(1.0)), "dps": float(np.deg2rad(1.0))},
    "accel": {"m/s2": 1.0, "g": STANDARD_GRAVITY},
    "mag": {"gauss": 1.0, "uT": 1e-2, "mG": 1e-3, "nT": 1e-5},
}
"""Units that may be named, and their size in ns, rad/s, m/s^2 and gauss."""
MARGIN_NS = 2_000_000_000
"""Time before and behind the inertial samples in which other rows may count, ns."""


class Reader:
    """Reads what the user gives into arrays of the right shape and unit, or says what is wrong."""

    def __init__(
        self, given: Mapping[str, Any] | None, check: bool, delay: float | Literal["auto"] = "auto"
    ) -> None:
        if given is not None and not isinstance(given, Mapping):
            raise ConfigError(f"units: {given!r}: name the array too, as {{'gyro': 'deg/s'}}")
        units = dict(given or {})
        for name, unit in units.items():
            if unit not in UNITS.get(name, {}):
                known = {key: list(values) for key, values in UNITS.items()}
                raise ConfigError(f"units: {name}: {unit!r}: known are {known}")
        self._units, self.check, self.delay = units, check, delay
        self.notes: list[str] = []
        """What one should know of the arrays, one sentence each."""
        self.dropped: dict[str, int] = {}
        """Rows that were not used, by array."""

    def drop(self, name: str, is_bad: Mask, why: str, then: str = "they were not used") -> None:
        """Count and note the rows of an array that are not used."""
        if is_bad.any():
            self.dropped[name] = self.dropped.get(name, 0) + int(np.count_nonzero(is_bad))
            self.note(name, is_bad, why, then)

    def note(self, name: str, is_bad: Mask, why: str, then: str) -> None:
        """Note rows of an array, if there are any."""
        if not is_bad.any():
            return
        rows = np.flatnonzero(is_bad)
        self.notes.append(
            f"{name}: {len(rows)} of {len(is_bad)} rows {why}, the first is row {rows[0]}; {then}"
        )

    def note_rough(self, name: str, values: Array) -> None:
        """Count and note samples that no sensor measures, and those that are far from the rest."""
        largest, unit = plausibility.LARGEST[name]
        beyond = plausibility.beyond_sensors(name, values)
        self.drop(name, beyond, f"hold more than {largest:g} {unit}, which no sensor measures")
        is_spike, usual = plausibility.spikes(name, values)
        why = f"are spikes: far larger than the others, which stay below {usual:.3g} {unit}"
        then = "they were used, and the estimate may be wrong from there on: leave them out"
        self.note(name, is_spike, why, then)

    def times(
        self, name: str, given: npt.ArrayLike, *, is_inertial: bool = False, unit: str = ""
    ) -> Stamps:
        """Return stamps, ns: floats are s and integers ns, unless the unit is named.

        Dates count from 1970 in UTC; those that name no zone are taken as they are.
        """
        if np.ma.isMaskedArray(given) and np.ma.getmaskarray(given).any():
            raise DataError(f"{name}: holds masked rows; leave such rows out")
        values = np.asarray(given)
        if are_dates(values) and values.ndim == 1:
            return self.times(name, since_1970(name, values), is_inertial=is_inertial, unit="ns")
        if values.ndim == 1 and not len(values):
            raise DataError(f"{name}: is empty; there is nothing to estimate from")
        if values.ndim != 1 or values.dtype.kind not in "iuf":
            raise DataError(
                f"{name}: must be numbers or datetime64 in one row, shape (n,), not "
                f"{_shape(values)}"
            )
        unit = unit or self._units.get("time", "s" if values.dtype.kind == "f" else "ns")
        if not np.isfinite(values).all():
            raise DataError(f"{name}: holds NaN or infinity; leave such rows out")
        size = UNITS["time"][unit]
        exact = values.dtype.kind != "f" and size == 1.0
        if not exact and np.abs(values).max() * size > LAST_NS:
            raise DataError(
                f"{name}: taken as {unit}, {values[-1]:.6g} is beyond every clock; name its unit, "
                "units={'time': 'ms'} or 'us' or 'ns'"
            )
        t_ns = values.astype(np.int64) if exact else np.rint(values * size).astype(np.int64)
        if self.check:
            plausibility.check_times(name, t_ns, unit, is_inertial=is_inertial)
        is_again = np.diff(t_ns, prepend=t_ns[0] - 1) == 0
        self.note(name, is_again, "have the time of the row before", "equal rows count once")
        return t_ns

    def array(self, name: str, given: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
        """Return an array in SI; of sigmas a number stands for all rows."""
        values = _numbers(name, given)
        if values.ndim == 0 and ".std" in name:
            values = np.full(shape, float(values))
        elif values.ndim == 0:
            raise DataError(f"{name}: is one number for {shape[0]} rows; give the shape {shape}")
        if values.shape != shape:
            hint = "; transpose it" if values.shape == shape[::-1] else ""
            raise DataError(f"{name}: must have the shape {shape}, not {_shape(values)}{hint}")
        plausibility.check_known(name, values)
        if not name.startswith("gnss.vel_n") and ".std" not in name:
            unknown = ~known_rows(values.reshape(len(values), -1))
            self.drop(name, unknown, "hold NaN or infinity")
        quantity = name.rpartition(".")[2]
        unit = self._units.get("mag" if quantity == "field" else quantity)
        table = UNITS.get("mag" if quantity == "field" else quantity, {})
        return values * table[unit] if unit is not None and quantity != "time" else values

    def columns(
        self, name: str, given: Mapping[str, npt.ArrayLike], known: Sequence[str], imu_ns: Stamps
    ) -> Stamps:
        """Return the stamps of a table; refuse columns that are not known."""
        # A data frame has keys, too
        if not hasattr(given, "keys"):
            columns = ", ".join(f"'{one}': ..." for one in ("time", *known))
            raise DataError(f"{name}: must be a dict of arrays, {{{columns}}}, not one array")
        for column in given:
            if column not in ("time", *known):
                raise ConfigError(f"{name}: {column}: known are time, {', '.join(known)}")
        if "time" not in given:
            raise DataError(f"{name}: needs the times of its rows: time")
        if name != "gnss" and not any(one in given for one in known if one != "std"):
            raise DataError(f"{name}: needs {' or '.join(one for one in known if one != 'std')}")
        t_ns = self.times(f"{name}.time", given["time"])
        if self.check:
            plausibility.check_overlap(imu_ns, t_ns, name)
        outside = (t_ns < imu_ns[0] - MARGIN_NS) | (t_ns > imu_ns[-1] + MARGIN_NS)
        self.drop(f"{name}.time", outside, "lie outside the time of the inertial samples")
        return t_ns

    def std(self, name: str, given: npt.ArrayLike, count: tuple[int]) -> Array:
        """Return one sigma for each row, which must be positive.

        Raises:
            DataError: None is.
        """
        values = self.array(name, given, count)
        is_bad = ~(values > 0.0)
        if is_bad.all():
            raise DataError(
                f"{name}: one sigma must be greater than 0, and is {values[0]:g}, so no row could "
                "be used; leave it out where it is not known"
            )
        self.drop(name, is_bad, "are not greater than 0")
        return values


def _shape(values: npt.NDArray[Any]) -> str:
    return f"{values.shape}" + ("" if values.dtype.kind in "iuf" else f" of {values.dtype}")


def _numbers(name: str, given: Any) -> Array:
    """Return what was given as floats; what is masked, null or NA is NaN.

    Raises:
        DataError: It holds something else than numbers.
    """
    if np.ma.isMaskedArray(given):
        return np.ma.filled(given.astype(np.float64), np.nan)
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    try:
        # pandas writes NA where a value lacks
        return np.asarray(given.to_numpy(dtype=np.float64, na_value=np.nan))
    except (AttributeError, TypeError, ValueError):
        kind = type(given).__name__
        raise DataError(
            f"{name}: holds something else than numbers, or rows of different lengths ({kind})"
        ) from None
