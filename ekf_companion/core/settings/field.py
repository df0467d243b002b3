"""The Earth's magnetic field at a fix, and the removal of the vehicle's own from a magnetometer."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from ekf_companion.core.settings.settings import HeadingSettings
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.magnetic import magnetic_field
from ekf_companion.nav.measurements import GNSS_DECLINATION, GNSS_FLAGS, Events, Kind, Row

Axis = TypeVar("Axis", float, Array)


class Field:
    """Adds the Earth's field to fixes and removes hard and soft iron, before any filter."""

    def __init__(self, heading: HeadingSettings) -> None:
        self._heading = heading
        iron = (heading.hard_iron, heading.soft_iron)
        self._has_iron = iron != (HeadingSettings().hard_iron, HeadingSettings().soft_iron)

    def complete(self, row: Row) -> Row:
        """Add the Earth's field to a fix; remove the vehicle's own from a magnetometer's."""
        t_ns, kind, values = row
        if kind == Kind.MAG and self._has_iron:
            return t_ns, kind, (*self._bare(*values[:3]), *values[3:])
        if kind != Kind.GNSS or not math.isnan(values[GNSS_DECLINATION]):
            return row
        lat, lon = values[:2]
        if not (abs(lat) < math.pi / 2 and abs(lon) <= math.pi):
            return row
        here, *field = magnetic_field(lat, lon, self._heading.year)
        if self._heading.declination != "auto":
            here = self._heading.declination
        return t_ns, kind, (*values[:GNSS_DECLINATION], here, values[GNSS_FLAGS], *field)

    def complete_all(self, events: Events) -> Array:
        """Do the same for a table of events; return a copy."""
        values = np.array(events.values, dtype=np.float64, order="C")
        for i in np.flatnonzero(events.kind == Kind.GNSS):
            row = (int(events.t_ns[i]), int(Kind.GNSS), tuple(values[i].tolist()))
            values[i] = self.complete(row)[2]
        if self._has_iron:
            mag = events.kind == Kind.MAG
            with np.errstate(invalid="ignore", over="ignore"):  # refused where rows are judged
                values[mag, :3] = np.stack(self._bare(*values[mag, :3].T), axis=1)
        return values

    def _bare(self, x: Axis, y: Axis, z: Axis) -> tuple[Axis, Axis, Axis]:
        """Return a field without hard and soft iron; columns and numbers agree to the bit."""
        hard, soft = self._heading.hard_iron, self._heading.soft_iron
        x, y, z = x - hard[0], y - hard[1], z - hard[2]
        a, b, c = ((row[0] * x + row[1] * y) + row[2] * z for row in soft)
        return a, b, c
