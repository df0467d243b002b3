"""Events of a long recording in a temporary file: only those asked for are in memory."""

from __future__ import annotations

import numpy as np

from ekf_companion.logs.spool import Spool
from ekf_companion.nav.event_columns import LazyEvents
from ekf_companion.nav.measurements import WIDTH, Events

_STAMP, _KIND, _VALUES = 0, 1, slice(2, 2 + WIDTH)


class SpooledEvents(LazyEvents):
    """Events in the order of their arrival."""

    __slots__ = ("_spool",)
    _spool: Spool

    def __init__(self) -> None:
        """Begin without events."""
        super().__init__()
        object.__setattr__(self, "_spool", Spool(2 + WIDTH))  # the class is frozen

    def __len__(self) -> int:
        return len(self._spool)

    def append(self, events: Events) -> None:
        """Append events.

        Raises:
            LogError: There is no room for the temporary file.
        """
        rows = np.empty((len(events), 2 + WIDTH))
        rows[:, _STAMP] = events.t_ns.view(np.float64)  # its bits
        rows[:, _KIND] = events.kind
        rows[:, _VALUES] = events.values
        self._spool.append(rows)

    def _read(self, first: int, count: int) -> Events:
        rows = self._spool.read(first, count)
        return Events(
            t_ns=rows[:, _STAMP].copy().view(np.int64),
            kind=rows[:, _KIND].astype(np.int64),
            values=np.ascontiguousarray(rows[:, _VALUES]),
        )
