"""The status of an estimate over time as bands: since when, until when, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.analysis.gaps import GAP_NS
from ekf_companion.nav.arrays import Mask, Stamps
from ekf_companion.nav.state import COLUMNS, Reason, Status, Table

NO_SAMPLES = "no inertial samples"
REASONS = "reasons"
"""The column with the sum of the reasons' bits, where a table has one."""


class Band(NamedTuple):
    """A row of bands over time."""

    name: str
    """What held: a status, or a reason for one."""
    status: Status | None
    """None: nothing was estimated."""
    spans_ns: tuple[tuple[int, int], ...]
    """From when to when, ascending."""

    @property
    def seconds(self) -> float:
        """How long it held in all."""
        return sum(end - begin for begin, end in self.spans_ns) * 1e-9


def bands(table: Table) -> tuple[Band, ...]:
    """Return a band for each status that occurs and, below the statuses, for each reason."""
    if not len(table):
        return ()
    t_ns = table.stamp_ns
    status = np.nan_to_num(table.column("status"))
    found = [
        Band(one.words, one, _spans(t_ns, status == one)) for one in Status if (status == one).any()
    ]
    for reason in Reason if REASONS in COLUMNS else ():
        holds = (np.nan_to_num(table.column(REASONS)).astype(np.int64) & reason) != 0
        if holds.any():
            made = int(status[holds].min())  # by itself: others may have made it worse
            found.append(Band(words_of(reason), Status(made), _spans(t_ns, holds)))
    gaps = np.flatnonzero(np.diff(t_ns) > GAP_NS)
    if len(gaps):
        spans = zip(t_ns[gaps].tolist(), t_ns[gaps + 1].tolist(), strict=True)
        found.append(Band(NO_SAMPLES, None, tuple(spans)))
    return tuple(found)


def joined(spans_ns: Sequence[tuple[int, int]], least_ns: int) -> list[tuple[int, int]]:
    """Return ascending spans with those put together between which there is less."""
    found: list[tuple[int, int]] = []
    for begin, end in spans_ns:
        if found and begin - found[-1][1] < least_ns:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def words_of(reason: Reason) -> str:
    """Return a reason in words, without numbers."""
    return (reason.name or "").lower().replace("_", " ")


def _spans(t_ns: Stamps, holds: Mask) -> tuple[tuple[int, int], ...]:
    """Return from when to when something held: until the next estimate, but over no gap."""
    until = np.append(t_ns[1:], t_ns[-1])
    until = np.where(until - t_ns > GAP_NS, t_ns, until)
    begins = holds & ~np.append(False, holds[:-1] & (np.diff(t_ns) <= GAP_NS))
    ends = holds & np.append(~holds[1:] | begins[1:], True)
    return tuple(zip(t_ns[begins].tolist(), until[ends].tolist(), strict=True))
