"""Events of a long recording: each kind in its own columns, merged part by part.

A row for any kind takes 120 bytes, an inertial sample as a log has it 32. So the columns stay where
they are, in memory or in a file, and rows are made only when they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps
from ekf_companion.nav.measurements import WIDTH, Events, Kind

PART = 1 << 14
"""Rows of the longest source that are looked at together."""


class EventColumns:
    """Events of one kind, as columns of any kind of number."""

    def __init__(self, t_ns: Stamps, kind: Kind, *columns: npt.ArrayLike) -> None:
        """Take stamps and columns in the order of the kind's ``row()``; numbers are of all rows."""
        self.t_ns, self.kind = np.asarray(t_ns, dtype=np.int64), kind
        self.columns = [np.asarray(column) for column in columns]

    def __len__(self) -> int:
        return len(self.t_ns)

    def take(self, index: Mask | slice) -> EventColumns:
        """Return the events that a mask or a slice selects."""
        if not isinstance(index, slice) and index.all():
            return self
        kept = [column[index] if column.ndim else column for column in self.columns]
        return EventColumns(self.t_ns[index], self.kind, *kept)

    def rotated(self, first: int, C: Array) -> EventColumns:
        """Return the events with three columns, from ``first`` on, multiplied by a matrix."""
        v = np.stack(self.columns[first : first + 3], axis=1).astype(np.float64)
        turned = [*self.columns[:first], *(v @ C.T).T, *self.columns[first + 3 :]]
        return EventColumns(self.t_ns, self.kind, *turned)


Arrivals = list[tuple[EventColumns, Stamps]]
"""Events of some kinds and when each arrived: its place in a file or its time."""


class EventSource(NamedTuple):
    """Rows that give events of one kind, read part by part."""

    rows: int
    """How many."""
    read: Callable[[int, int], Arrivals]
    """Returns the events of the rows from one number to before another."""


def sources_of(arrivals: Arrivals) -> list[EventSource]:
    """Return the sources of events that are in memory."""

    def source(events: EventColumns, arrival: Stamps) -> EventSource:
        # A column of a table would keep all of the table in memory
        columns = [column.copy() for column in events.columns]
        events, arrival = EventColumns(events.t_ns.copy(), events.kind, *columns), arrival.copy()

        def read(first: int, end: int) -> Arrivals:
            return [(events.take(slice(first, end)), arrival[first:end])]

        return EventSource(len(events), read)

    return [source(*one) for one in arrivals]


def merged(arrivals: Arrivals) -> Events:
    """Return events by arrival; ties keep the order in which they are given."""
    order = np.argsort(np.concatenate([arrival for _, arrival in arrivals]), kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    events = _empty(len(order))
    events.values[:] = 0.0
    first = 0
    for table, _ in arrivals:
        rows = place[first : first + len(table)]
        first += len(table)
        events.t_ns[rows], events.kind[rows] = table.t_ns, int(table.kind)
        for column, numbers in enumerate(table.columns):
            events.values[rows, column] = numbers
    return events


class LazyEvents(Events):
    """Events whose rows are made when they are used."""

    __slots__ = ("_whole",)
    _whole: Events | None

    def __init__(self) -> None:
        object.__setattr__(self, "_whole", None)  # the class is frozen

    def take(self, index: npt.NDArray[np.integer] | Mask) -> Events:
        """Return the events of an index or a mask, in its order."""
        is_one_run = index.dtype != np.bool_ and len(index) and bool((np.diff(index) == 1).all())
        if self._whole is None and is_one_run:
            return self._read(int(index[0]), len(index))
        return self._all().take(index)

    def _read(self, first: int, count: int) -> Events:
        """Return the events of a run of rows."""
        raise NotImplementedError

    def _all(self) -> Events:
        """Return all rows; from now on they stay in memory."""
        if self._whole is None:
            object.__setattr__(self, "_whole", self._read(0, len(self)))
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


class _Part(NamedTuple):
    """Rows of a source that have events."""

    source: EventSource
    first: int
    end: int
    low: int
    """Of the arrivals."""
    high: int
    events: int


class MergedEvents(LazyEvents):
    """Events of several sources in the order of their arrival; ties keep the order of the sources.

    Arrivals are divided into spans, at those with which parts of the longest source begin. The
    parts that have arrivals in a span are read and sorted together: few, as arrivals mostly ascend
    in each source, and all that are needed, where they do not.
    """

    __slots__ = ("_begins", "_edges", "_kept", "_parts")
    _begins: Indices
    """First event of each span, and the number of all."""
    _edges: Stamps
    """At which the spans but the first begin."""
    _kept: tuple[int, Events]
    """The span that was read last."""
    _parts: list[list[tuple[_Part, bool]]]
    """Of each span, and whether all of their events are in it."""

    def __init__(self, sources: Sequence[EventSource]) -> None:
        """Look at all arrivals."""
        super().__init__()
        longest = max(sources, key=lambda source: source.rows, default=EventSource(0, _none))
        pieces = max(1, -(-longest.rows // PART))
        parts = [part for source in sources for part in _parts_of(source, pieces)]
        edges = np.unique([part.low for part in parts if part.source is longest])[1:]
        counts = np.zeros(len(edges) + 1, dtype=np.int64)
        spans: list[list[tuple[_Part, bool]]] = [[] for _ in counts]
        for part in parts:
            low, high = np.searchsorted(edges, (part.low, part.high), side="right").tolist()
            for span in range(low, high + 1):
                spans[span].append((part, low == high))
            if low == high:
                counts[low] += part.events
                continue
            for _, arrival in part.source.read(part.first, part.end):
                found = np.searchsorted(edges, arrival, side="right")
                counts += np.bincount(found, minlength=len(counts))
        set_once = object.__setattr__  # the class is frozen
        set_once(self, "_edges", edges)
        set_once(self, "_parts", spans)
        set_once(self, "_begins", np.cumsum([0, *counts]))
        set_once(self, "_kept", (-1, _empty(0)))

    def __len__(self) -> int:
        return int(self._begins[-1])

    def _read(self, first: int, count: int) -> Events:
        events = _empty(count)
        done = 0
        while done < count:
            span = int(np.searchsorted(self._begins, first + done, side="right")) - 1
            found, at = self._span(span), first + done - int(self._begins[span])
            n = min(count - done, len(found) - at)
            into, of = slice(done, done + n), slice(at, at + n)
            events.t_ns[into], events.kind[into] = found.t_ns[of], found.kind[of]
            events.values[into] = found.values[of]
            done += n
        return events

    def _span(self, span: int) -> Events:
        """Return the events of a span."""
        if self._kept[0] != span:
            found: Arrivals = []
            for part, is_whole in self._parts[span]:
                for events, arrival in part.source.read(part.first, part.end):
                    if is_whole:
                        found.append((events, arrival))
                        continue
                    is_in = np.searchsorted(self._edges, arrival, side="right") == span
                    found.append((events.take(is_in), arrival[is_in]))
            object.__setattr__(self, "_kept", (span, merged(found)))
        return self._kept[1]


def _parts_of(source: EventSource, pieces: int) -> Iterator[_Part]:
    """Yield a source's parts that have events: so many, and of so many rows, at most."""
    step = max(1, -(-source.rows // pieces))
    for first in range(0, source.rows, step):
        end = min(first + step, source.rows)
        for _, arrival in source.read(first, end):
            if len(arrival):
                low, high = int(arrival.min()), int(arrival.max())
                yield _Part(source, first, end, low, high, len(arrival))


def _none(first: int, end: int) -> Arrivals:
    return []


def _empty(count: int) -> Events:
    """Return events to be written."""
    return Events(
        t_ns=np.empty(count, dtype=np.int64),
        kind=np.empty(count, dtype=np.int64),
        values=np.empty((count, WIDTH)),
    )
