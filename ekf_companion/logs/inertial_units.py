"""The samples in use of a log's inertial units, judged as they are live (:mod:`.nav.lanes`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ekf_companion.logs.instances import MOST, Wanted
from ekf_companion.logs.recording import counted
from ekf_companion.logs.stored_rows import AT_ONCE, Column, StoredRows
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.lanes import CHOSEN, Lanes, used_rows

STDS = ("gyro_std", "accel_std", "turned", "gained")
"""Columns of the samples beside rates and forces, as ``ImuSample`` has them."""


class Samples:
    """Chooses among the samples of all units, part by part."""

    def __init__(self, first: int, wanted: Wanted) -> None:
        """Begin with a unit; ``wanted``: what the autopilot uses from then on, over time."""
        self.lanes = Lanes(first)
        self._wanted = [*wanted]
        self._at = 0

    def take(
        self, number: Indices, t_ns: Stamps, values: Array, is_bad: Mask
    ) -> tuple[Indices, Stamps, Array]:
        """Return the samples in use of the next rows of all units, as ``used_rows`` does."""
        number, t_ns = (np.ascontiguousarray(one, dtype=np.int64) for one in (number, t_ns))
        found = []
        first = 0
        while first < len(t_ns):
            while self._at < len(self._wanted) and self._wanted[self._at][0] <= t_ns[first]:
                self.lanes.want(self._wanted[self._at][1])
                self._at += 1
            end = len(t_ns)
            if self._at < len(self._wanted):
                later = np.flatnonzero(t_ns[first:] >= self._wanted[self._at][0])
                end = first + int(later[0]) if len(later) else end
            some = slice(first, end)
            at, *rest = used_rows(
                self.lanes, number[some], t_ns[some], values[some], is_bad[some].copy()
            )
            found.append((at + first, *rest))
            first = end
        if not found:
            return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6 + len(STDS)))
        rows, times, samples = (np.concatenate(each) for each in zip(*found, strict=True))
        return rows, times, samples

    def notes(self, kind: str, names: Mapping[int, str], begun_ns: int) -> list[str]:
        """Return a note for each unit that was left, and for each spare one that failed.

        Args:
            kind: Of the sensors.
            names: Of each unit.
            begun_ns: First stamp of the log.
        """
        notes = []
        changes = self.lanes.changes
        for one in changes[:MOST]:
            seconds = (one.t_ns - begun_ns) * 1e-9
            why = (
                "the autopilot uses it" if one.why == CHOSEN else f"{names[one.left]} is {one.why}"
            )
            notes.append(f"{kind}: {names[one.used]} is used from {seconds:.1f} s on: {why}")
        if (rest := len(changes) - len(notes)) > 0:
            notes.append(f"{kind}: the sensor in use changes {counted(rest, 'more time')}")
        for unit in self.lanes.units:
            if unit.faults and not any(one.left == unit.number for one in changes):
                seconds = (unit.fault_ns - begun_ns) * 1e-9
                often = "" if unit.faults == 1 else f", the first of {unit.faults} times"
                notes.append(
                    f"{kind}: {names[unit.number]}, which stands by, is {unit.why} at "
                    f"{seconds:.1f} s{often}"
                )
        return notes


def by_time(tables: Sequence[StoredRows], column: str) -> Iterator[tuple[Indices, Column]]:
    """Yield the rows of several tables of one type by their stamps, part by part.

    Each part is the number of the table of each row, and the rows; ``column`` holds the stamps.
    """
    first = [0] * len(tables)
    while True:
        heads = [rows.read(at, at + AT_ONCE) for rows, at in zip(tables, first, strict=True)]
        known = [head[column][-1] for head in heads if len(head)]
        if not known:
            return
        parts = []
        for place, head in enumerate(heads):
            # One table is read to the end of its part at least, whatever its stamps are
            beyond = np.flatnonzero(head[column] > min(known))
            is_whole = not len(beyond) or head[column][-1] == min(known)
            parts.append(head if is_whole else head[: int(beyond[0])])
            first[place] += len(parts[-1])
        rows = np.concatenate(parts)
        number = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        order = np.argsort(rows[column], kind="stable")
        yield number[order], rows[order]
