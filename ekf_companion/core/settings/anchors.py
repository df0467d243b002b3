"""Where the anchors of ranges are: the configuration's places in the rows of their ranges."""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.core.settings.settings import AnchorRangeSettings
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind, Row

_NUMBER, _PLACE = 1, slice(2, 6)
"""Columns of the row of an :class:`~ekf_companion.nav.measurements.AnchorSample`."""


class Anchors:
    """Adds the places of the anchors to their ranges, before any filter."""

    def __init__(self, settings: AnchorRangeSettings) -> None:
        is_geodetic = settings.places == "geodetic"
        size = math.radians(1.0) if is_geodetic else 1.0
        self._places = {
            round(number): (size * first, size * second, third, float(is_geodetic))
            for number, first, second, third in settings.anchors
        }
        self._biases = {round(number): bias for number, bias in settings.biases}
        self._unknown: set[int] = set()

    def complete(self, row: Row) -> Row:
        """Return a range without its bias, with the place of its anchor; its own place it keeps."""
        t_ns, kind, values = row
        if not math.isfinite(values[_NUMBER]):
            return row
        number, place = round(values[_NUMBER]), values[_PLACE]
        if math.isnan(place[0]):
            if number not in self._places:
                self._unknown.add(number)
                return row
            place = self._places[number]
        distance = values[0] - self._biases.get(number, 0.0)
        return t_ns, kind, (distance, values[_NUMBER], *place, *values[_PLACE.stop :])

    def complete_all(self, events: Events, values: Array) -> None:
        """Do the same for a table of events, in ``values``, shape (n, WIDTH)."""
        for i in np.flatnonzero(events.kind == Kind.ANCHOR):
            row = (int(events.t_ns[i]), int(Kind.ANCHOR), tuple(values[i].tolist()))
            values[i] = self.complete(row)[2]

    def oddities(self) -> list[str]:
        """Return which anchors have no place, and what to do."""
        return [
            f"anchor {number} has no place: its ranges are not used; add it to anchor_range.anchors"
            for number in sorted(self._unknown)
        ]
