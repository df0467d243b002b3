"""A trajectory with its sigmas as arrays, as a DataFrame or as a file of TUM's format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import ConfigError
from ekf_companion.logs.tum_writer import Writer
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.state import (
    ACCEL_BIAS,
    COLUMNS,
    EULER,
    GYRO_BIAS,
    POSITION,
    QUATERNION,
    SIGMA,
    VELOCITY,
    Status,
    Table,
)


class Estimates:
    """A trajectory with its sigmas: an estimate per inertial sample, as arrays.

    Attributes are NaN where nothing is known yet; ``status`` says since when what is.
    """

    def __init__(self, table: Table, notes: tuple[str, ...] = ()) -> None:
        self.table = table
        """All columns, as ``convert`` writes them."""
        self.notes = notes
        """What one should know of the run, one sentence each."""

    def __len__(self) -> int:
        return len(self.table)

    def __repr__(self) -> str:
        status, count = self.status, len(self)
        good = float(np.mean(status >= Status.OK)) if count else 0.0
        span = (self.t_ns[-1] - self.t_ns[0]) * 1e-9 if count else 0.0
        return f"<Estimates: {count} in {span:.1f} s, {good:.0%} with a position>"

    @property
    def t_ns(self) -> Stamps:
        """Times of validity, on the clock that was given, ns, shape (n,)."""
        return self.table.stamp_ns

    @property
    def time(self) -> Array:
        """The same in s, shape (n,)."""
        return np.asarray(self.t_ns * 1e-9)

    @property
    def lat_deg(self) -> Array:
        """WGS-84 latitude, degrees, shape (n,)."""
        return self.table.column("lat_deg")

    @property
    def lon_deg(self) -> Array:
        """Longitude, degrees, shape (n,)."""
        return self.table.column("lon_deg")

    @property
    def alt(self) -> Array:
        """Height above mean sea level, m, shape (n,)."""
        return self.table.column("alt_m")

    @property
    def pos_n(self) -> Array:
        """Position north, east, down of the first, m, shape (n, 3)."""
        return self.table.columns(POSITION)

    @property
    def vel_n(self) -> Array:
        """Velocity north, east, down, m/s, shape (n, 3)."""
        return self.table.columns(VELOCITY)

    @property
    def q_nb(self) -> Array:
        """Attitude, quaternion (w, x, y, z) from body to north-east-down, shape (n, 4)."""
        return self.table.columns(QUATERNION)

    @property
    def euler(self) -> Array:
        """Roll, pitch and yaw, rad, shape (n, 3)."""
        return self.table.columns(EULER)

    @property
    def gyro_bias(self) -> Array:
        """rad/s, shape (n, 3)."""
        return self.table.columns(GYRO_BIAS)

    @property
    def accel_bias(self) -> Array:
        """m/s^2, shape (n, 3)."""
        return self.table.columns(ACCEL_BIAS)

    @property
    def sigma(self) -> Array:
        """One sigma of position, velocity (n, e, d) and roll, pitch, yaw, shape (n, 9)."""
        return self.table.columns(SIGMA)

    @property
    def status(self) -> npt.NDArray[np.int64]:
        """``ekf_companion.nav.state.Status`` of each, shape (n,): from 3 on there is a position."""
        return self.table.column("status").astype(np.int64)

    def to_dataframe(self, library: str = "pandas") -> Any:
        """Return all columns as a DataFrame of ``pandas`` or ``polars``.

        Raises:
            ConfigError: That library is not installed, or is neither of the two.
        """
        columns: dict[str, npt.NDArray[Any]] = {"time_ns": self.t_ns}
        columns |= {name: self.table.column(name) for name in COLUMNS[1:]}
        try:
            if library == "pandas":
                import pandas

                return pandas.DataFrame(columns)
            if library == "polars":
                import polars

                return polars.DataFrame(columns)
        except ImportError:
            raise ConfigError(f"{library} is not installed: pip install {library}") from None
        raise ConfigError(f"to_dataframe: {library!r}: use 'pandas' or 'polars'")

    def to_tum(self, path: Path | str) -> None:
        """Write the trajectory in TUM's format, which evo and others read.

        A line is ``time x y z qx qy qz qw``: s, m east, north and up of the first position, and the
        attitude from body (forward, left, up) to these axes. Times without a position are left out.

        Raises:
            LogError: The file cannot be written.
        """
        known = self.status >= Status.OK
        with Writer(Path(path)) as writer:
            writer.write(Table(stamp_ns=self.t_ns[known], values=self.table.values[known]))
