"""A trajectory with its sigmas as arrays, as a DataFrame or as a file of TUM's format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.engine.faults import NO_EVIDENCE, FaultEvidence, FoundFault
from ekf_companion.errors import ConfigError
from ekf_companion.logs.csv_writer import Writer as CsvWriter
from ekf_companion.logs.tum_writer import Writer as TumWriter
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.reason import Seconds, seconds_by_reason
from ekf_companion.nav.state import (
    ACCEL_BIAS,
    COLUMNS,
    EULER,
    GEODETIC,
    GYRO_BIAS,
    POSITION,
    QUATERNION,
    SIGMA,
    VELOCITY,
    Status,
    Table,
)
from ekf_companion.review.account import resets_of


class Origin(NamedTuple):
    """The place from which ``pos_n`` counts."""

    lat_deg: float
    """WGS-84 latitude, degrees."""
    lon_deg: float
    """Longitude, degrees."""
    alt: float
    """Height above mean sea level, m."""


class Estimates:
    """A trajectory with its sigmas: an estimate per inertial sample, as arrays.

    Attributes are NaN where nothing is known yet; ``status`` says since when what is.
    """

    def __init__(
        self,
        table: Table,
        notes: tuple[str, ...] = (),
        *,
        dropped: Mapping[str, int] | None = None,
        faults: tuple[FoundFault, ...] = (),
        evidence: FaultEvidence = NO_EVIDENCE,
    ) -> None:
        self.table = table
        """All columns, as ``convert`` writes them."""
        self.notes = notes
        """What one should know of the run, one sentence each: read them where there are any."""
        self.dropped: Mapping[str, int] = dict(dropped or {})
        """Rows that were not used, by array; ``notes`` say why."""
        self.faults = faults
        """What was wrong beyond doubt, where the settings' ``weigh_faults`` asks for it."""
        self.evidence = evidence
        """How probable it was over time that each source was wrong, and the protection levels."""

    def __len__(self) -> int:
        return len(self.table)

    def __repr__(self) -> str:
        count, span = len(self), (self.t_ns[-1] - self.t_ns[0]) * 1e-9 if len(self) else 0.0
        lost = ", ".join(f"{name} {rows}" for name, rows in self.dropped.items()) or "0"
        parts = [
            f"{count} in {span:.1f} s",
            ", ".join(f"{name} {_percent(one)}" for name, one in self.shares.items()) or "empty",
            self._accuracy(),
            f"resets {self.resets}",
            f"rows dropped {lost}",
            f"notes {len(self.notes)}",
        ]
        return f"<Estimates: {'; '.join(parts)}>"

    def _accuracy(self) -> str:
        std = np.hypot(self.sigma[:, 0], self.sigma[:, 1])[self.status >= Status.OK]
        if not np.isfinite(std).any():
            return "no position"
        return f"{np.nanmedian(std):.1f} m by its own sigma"

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the estimates by status, in its order; see :attr:`status`."""
        status = self.status
        return {
            each.words: float(np.mean(status == each)) for each in Status if (status == each).any()
        }

    @property
    def resets(self) -> int:
        """How often the estimate jumped on purpose; ``notes`` say when, two at once are two."""
        return resets_of(self.table)

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
    def origin(self) -> Origin | None:
        """The place from which ``pos_n`` counts; None: there is no position.

        Of ``eskf`` it is the fix at which it began to navigate, as a heading was known; of
        ``euler``, ``iterated`` and ``ukf`` the first fix. So compare two filters by ``lat_deg``,
        ``lon_deg`` and ``alt``.
        """
        places = np.hstack([self.table.columns(GEODETIC), self.pos_n])
        known = np.flatnonzero(np.isfinite(places).all(axis=1))
        return _origin(places[known[0]]) if len(known) else None

    @property
    def pos_n(self) -> Array:
        """Position north, east, down of :attr:`origin`, m, shape (n, 3)."""
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
        """Roll, pitch and yaw (from true north, clockwise), rad, shape (n, 3)."""
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

    @property
    def reasons(self) -> npt.NDArray[np.int64]:
        """Why each is worse than OK, shape (n,): sums of ``ekf_companion.nav.state.Reason``."""
        return self.table.column("reasons").astype(np.int64)

    @property
    def seconds(self) -> Seconds:
        """Seconds by status, and of each by the foremost of its reasons: they add up to it."""
        return seconds_by_reason(self.table)

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

    def to_csv(self, path: Path | str) -> None:
        """Write all columns as ``convert`` does, for ``ekf-companion compare``.

        Raises:
            LogError: The file cannot be written.
        """
        with CsvWriter(Path(path)) as writer:
            writer.write(self.table)

    def to_tum(self, path: Path | str) -> None:
        """Write the trajectory in TUM's format, which evo and others read.

        A line is ``time x y z qx qy qz qw``: s, m east, north and up of :attr:`origin`, and the
        attitude from body (forward, left, up) to these axes. Times without a position are left out.

        Raises:
            LogError: The file cannot be written.
        """
        known = np.isfinite(self.pos_n).all(axis=1) & np.isfinite(self.q_nb).all(axis=1)
        known &= self.status >= Status.OK
        with TumWriter(Path(path)) as writer:
            writer.write(Table(stamp_ns=self.t_ns[known], values=self.table.values[known]))


def _origin(place: Array) -> Origin:
    """Return the origin of a local frame by one point in it.

    Its latitude, longitude (degrees), altitude, and position north, east, down (m), shape (6,).
    """
    lat, lon = np.deg2rad(place[:2])
    alt = float(place[2] + place[5])
    origin = LocalFrame(float(lat), float(lon), alt)
    # The radii are those of the origin, which is sought: each step is 1e-2 of the one before
    for _ in range(8):
        back = origin.scale
        lat_0, lon_0 = float(lat - place[3] / back[0]), float(lon - place[4] / back[1])
        origin = LocalFrame(lat_0, float(so3.wrap(lon_0)), alt)
    return Origin(float(np.rad2deg(origin.lat)), float(np.rad2deg(origin.lon)), alt)


def _percent(share: float) -> str:
    return "<1%" if share < 0.01 else f"{share:.0%}"
