"""Events of a long recording: each kind in the columns that it has, put together chunk by chunk.

A row of all kinds takes 120 bytes, and an inertial sample as a log has it 32. So the columns stay
as they are, and rows are made of those that are asked for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.measurements import WIDTH, Events, Kind


class EventColumns:
    """Events of one kind, as columns of any kind of number."""

    def __init__(self, t_ns: Stamps, kind: Kind, *columns: npt.ArrayLike) -> None:
        """Take stamps and columns in the order of the kind's ``row()``; numbers are of all rows."""
        self.t_ns, self.kind = np.asarray(t_ns, dtype=np.int64), kind
        self.columns = [np.asarray(column) for column in columns]

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, mask: Mask) -> EventColumns:
        """Return the events of a mask."""
        if mask.all():
            return self
        kept = [column[mask] if column.ndim else column for column in self.columns]
        return EventColumns(self.t_ns[mask], self.kind, *kept)

    def rotated(self, first: int, C: Array) -> EventColumns:
        """Return the events with three columns, from one on, multiplied by a matrix."""
        v = np.stack(self.columns[first : first + 3], axis=1).astype(np.float64)
        turned = [*self.columns[:first], *(v @ C.T).T, *self.columns[first + 3 :]]
        return EventColumns(self.t_ns, self.kind, *turned)


class LazyEvents(Events):
    """Events whose rows are made when they are used."""

    __slots__ = ("_whole",)
    _whole: Events | None

    def __init__(self) -> None:
        object.__setattr__(self, "_whole", None)  # the class is frozen

    def _make_all(self) -> Events:
        """Return all rows."""
        raise NotImplementedError

    def _all(self) -> Events:
        """Return all rows; from now on they stay in memory."""
        if self._whole is None:
            object.__setattr__(self, "_whole", self._make_all())
        assert self._whole is not None
        return self._whole

    @property
    def t_ns(self) -> Stamps:
        """Stamps, shape (n,)."""
        return self._all().t_ns

    @property
    def kind(self) -> Indices:
        """``Kind``, shape (n,)."""
        return self._all().kind

    @property
    def values(self) -> Array:
        """Rows in the layout of the measurements' ``row()``, shape (n, WIDTH)."""
        return self._all().values


class MergedEvents(LazyEvents):
    """Events of several kinds in the order of their arrival."""

    __slots__ = ("_firsts", "_order", "_tables")
    _firsts: Indices
    _order: npt.NDArray[np.integer]
    _tables: list[EventColumns]

    def __init__(self, tables: Sequence[EventColumns], arrivals: Sequence[npt.ArrayLike]) -> None:
        """Merge tables by arrival; ties keep the order of the tables."""
        super().__init__()
        found = list(tables)
        arrival = np.concatenate([np.asarray(one) for one in arrivals])
        is_small = len(arrival) < 1 << 31
        order = np.argsort(arrival, kind="stable")
        firsts = np.cumsum([0, *(len(table) for table in found)])
        set_once = object.__setattr__  # the class is frozen
        set_once(self, "_tables", found)
        set_once(self, "_order", order.astype(np.int32) if is_small else order)
        set_once(self, "_firsts", firsts)

    def __len__(self) -> int:
        return len(self._order)

    def take(self, index: npt.NDArray[np.integer] | Mask) -> Events:
        """Return the events of an index or a mask, in its order."""
        if self._whole is not None:
            return self._whole.take(index)
        order = self._order[index]
        t_ns, kind = np.empty(len(order), dtype=np.int64), np.empty(len(order), dtype=np.int64)
        values = np.zeros((len(order), WIDTH))
        number = np.searchsorted(self._firsts, order, side="right") - 1
        for n, table in enumerate(self._tables):
            rows = np.flatnonzero(number == n)
            at = order[rows] - self._firsts[n]
            t_ns[rows], kind[rows] = table.t_ns[at], int(table.kind)
            for column, numbers in enumerate(table.columns):
                values[rows, column] = numbers[at] if numbers.ndim else numbers
        return Events(t_ns=t_ns, kind=kind, values=values)

    def _make_all(self) -> Events:
        return self.take(np.arange(len(self)))
