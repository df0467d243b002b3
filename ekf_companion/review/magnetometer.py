"""Whether a log's magnetometer is plainly declared wrong: in another unit, or along other axes.

The estimate's attitude turns the Earth's field at the place into the body; a magnetometer that is
declared right measures about that. One along other axes measures it after a rotation by right
angles, or a reflection, which no iron of a vehicle does.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, known_rows, median
from ekf_companion.nav.magnetic import magnetic_field
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import QUATERNION, Status, Table
from ekf_companion.review.turns import SIGNED, spelled

FEWEST = 200
"""Samples with an attitude."""
WRONG, RIGHT = 0.5, 0.9
"""Mean cosine between what is measured and expected: below as it is declared, and above with other
axes, the declaration is wrong. Iron as strong as a third of the field leaves 0.94."""
_APART = 4.0
"""Factor from the Earth's strength beyond which the unit is wrong."""
_UNITS = {"microtesla": 1e2, "milligauss": 1e3, "nanotesla": 1e5, "tesla": 1e-4}


class MagnetometerCheck:
    """Compares the magnetometer of a log with the Earth's field, block by block."""

    def __init__(self, year: float) -> None:
        self._year = year
        self._field_n: Array | None = None
        self._product = np.zeros((3, 3))
        """Sum of measured times expected unit vectors."""
        self._count = 0
        self._norms: list[float] = []
        """Median strength of each block, gauss."""

    def add(self, events: Events, table: Table) -> None:
        """Add the events of a block, and the estimates that follow from it."""
        fixes = events.values[events.kind == Kind.GNSS, :2]
        if self._field_n is None and len(fixes):
            declination, dip, strength = magnetic_field(
                float(fixes[0, 0]), float(fixes[0, 1]), self._year
            )
            level = strength * np.cos(dip)
            north, east = level * np.cos(declination), level * np.sin(declination)
            self._field_n = np.array([north, east, strength * np.sin(dip)])
        is_mag = (events.kind == Kind.MAG) & known_rows(events.values[:, :3])
        mag, t_ns = events.values[is_mag, :3], events.t_ns[is_mag]
        norm = np.linalg.norm(mag, axis=1)
        mag, t_ns, norm = mag[norm > 0.0], t_ns[norm > 0.0], norm[norm > 0.0]
        if not len(mag):
            return
        self._norms.append(median(norm))
        is_good = table.column("status") >= Status.OK
        if self._field_n is None or not is_good.any():
            return
        at_ns = table.stamp_ns[is_good]
        near = np.clip(np.searchsorted(at_ns, t_ns), 0, len(at_ns) - 1)
        is_near = np.abs(at_ns[near] - t_ns) < 100_000_000
        q_nb = np.stack([table.column(name)[is_good] for name in QUATERNION], axis=1)[near[is_near]]
        expected_b = so3.rotate(so3.conjugate(q_nb), np.tile(self._field_n, (len(q_nb), 1)))
        expected_b /= np.linalg.norm(self._field_n)
        self._product += (mag[is_near] / norm[is_near, None]).T @ expected_b
        self._count += len(q_nb)

    def notes(self) -> list[str]:
        """Return a sentence for each thing that is plainly wrong."""
        return [note for note in (self._of_unit(), self._of_axes()) if note]

    def _of_unit(self) -> str:
        if self._field_n is None or not self._norms:
            return ""
        found, earth = median(self._norms), float(np.linalg.norm(self._field_n))
        if 1.0 / _APART < found / earth < _APART:
            return ""
        unit, factor = min(_UNITS.items(), key=lambda one: abs(np.log(found / earth / one[1])))
        is_it = 1.0 / _APART < found / earth / factor < _APART
        advice = f"it looks like {unit}" if is_it else "check its unit and its scale"
        return (
            f"the magnetometer measures {found:.3g} gauss as it is declared, where the Earth's "
            f"field has {earth:.2f}: {advice}"
        )

    def _of_axes(self) -> str:
        if self._count < FEWEST or np.trace(self._product) / self._count > WRONG:
            return ""
        scores = [float(np.trace(turn @ self._product)) for turn in SIGNED]
        if max(scores) / self._count < RIGHT:
            return ""
        return (
            "the magnetometer's axes are not forward, right, down as declared: it fits the Earth's "
            f"field as {spelled(SIGNED[int(np.argmax(scores))])} of what is declared as (x, y, z)"
        )
