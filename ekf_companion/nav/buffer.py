"""Events in the order of their arrival, collected row by row."""

from __future__ import annotations

import numpy as np

from ekf_companion.nav.measurements import WIDTH, Events, Row

MARGIN = 64
"""Rows beyond the limit for which there is room: as many as one message gives, and more."""


class EventBuffer:
    """Collects rows in arrays, into which a fast caller may write directly."""

    def __init__(self, limit: int) -> None:
        """Begin empty."""
        self.limit = limit
        """Rows up to which it is to be filled."""
        self._begin()

    def _begin(self) -> None:
        self.size = 0
        """Rows so far."""
        room = self.limit + MARGIN
        self.t_ns = np.empty(room, dtype=np.int64)
        self.kind = np.empty(room, dtype=np.int64)
        self.values = np.empty((room, WIDTH))

    def __len__(self) -> int:
        return self.size

    @property
    def is_full(self) -> bool:
        """Whether it is filled up to its limit."""
        return self.size >= self.limit

    def append(self, row: Row) -> None:
        """Append a row."""
        if self.size == len(self.t_ns):
            self.grow()
        self.t_ns[self.size], self.kind[self.size], self.values[self.size] = row
        self.size += 1

    def grow(self) -> None:
        """Replace the arrays by larger ones."""
        room = np.empty_like(self.values)
        self.t_ns = np.concatenate([self.t_ns, np.empty_like(self.t_ns)])
        self.kind = np.concatenate([self.kind, np.empty_like(self.kind)])
        self.values = np.concatenate([self.values, room])

    def take(self) -> Events:
        """Return the rows, and begin empty again."""
        n = self.size
        events = Events(t_ns=self.t_ns[:n], kind=self.kind[:n], values=self.values[:n])
        self._begin()
        return events
