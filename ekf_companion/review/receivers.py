"""Which of two receivers a recording's fixes are of, as a note."""

from __future__ import annotations

import numpy as np

from ekf_companion.nav.measurements import GNSS_FLAGS, SILENT_NS, Events, GnssFlag, Kind

MOST = 3
"""Changes that are named one by one."""


class ReceiverCheck:
    """Finds from when to when only the second receiver has fixes."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._newest: list[int | None] = [None, None]  # fix of each receiver, ns
        self._used = 0
        self._changes: list[str] = []

    def add(self, events: Events) -> None:
        """Look at a block of events."""
        if self._first_ns is None and len(events):
            self._first_ns = int(events.t_ns.min())
        is_fix = events.kind == Kind.GNSS
        flags = events.values[:, GNSS_FLAGS]
        is_fix &= flags != GnssFlag.DERIVED
        for i in np.flatnonzero(is_fix).tolist():
            self._take(int(flags[i] >= GnssFlag.SECOND), int(events.t_ns[i]))

    def _take(self, receiver: int, t_ns: int) -> None:
        newest = self._newest[self._used]
        self._newest[receiver] = t_ns
        begun_ns = self._first_ns or t_ns
        if receiver == self._used or t_ns - (begun_ns if newest is None else newest) <= SILENT_NS:
            return
        self._used = receiver
        why = "has none" if newest is None else "has no more"
        other = "second" if receiver else "first"
        was = "first" if receiver else "second"
        seconds = (t_ns - begun_ns) * 1e-9
        self._changes.append(
            f"from {seconds:.0f} s on the {other} receiver's fixes are used: the {was} {why}"
        )

    def notes(self) -> list[str]:
        """Return a sentence for each change, of many for the first ones."""
        rest = len(self._changes) - MOST
        more = [f"and {rest} more changes of the receiver"] if rest > 0 else []
        return [*self._changes[:MOST], *more]
