"""The status of an estimate over time as bands: from when, until when, and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.analysis.gaps import GAP_NS
from ekf_companion.nav.arrays import Mask, Stamps
from ekf_companion.nav.reason import ORDER, WORDS, foremost_of, seconds_by_reason
from ekf_companion.nav.state import Status, Table

NO_SAMPLES = "no inertial samples"


class Band(NamedTuple):
    """A row of bands over time."""

    name: str
    """Its status, or status and foremost reason."""
    status: Status | None
    """None: nothing was estimated."""
    spans_ns: tuple[tuple[int, int], ...]
    """Begin and end of each span, ascending."""
    seconds: float
    """Total duration, as the summary counts it: the reasons of a status add up to it."""


def bands(table: Table) -> tuple[Band, ...]:
    """Return a band for each status that occurs and, below the statuses, for each of its reasons.

    Where several reasons hold, the foremost is shown.
    """
    if not len(table):
        return ()
    t_ns = table.stamp_ns
    status = np.nan_to_num(table.column("status"))
    reasons = foremost_of(table.column("reasons"))
    spent = seconds_by_reason(table)
    found, below = [], []
    for one in Status:
        is_one, by_reason = status == one, spent.get(one, {})
        if is_one.any():
            found.append(Band(one.words, one, spans(t_ns, is_one), sum(by_reason.values())))
        for reason in ORDER:
            holds = is_one & (reasons == int(reason))
            if holds.any():
                name, seconds = f"{one.words}: {WORDS[reason]}", by_reason.get(reason, 0.0)
                below.append(Band(name, one, spans(t_ns, holds), seconds))
    gaps = np.flatnonzero(np.diff(t_ns) > GAP_NS)
    if len(gaps):
        parts = zip(t_ns[gaps].tolist(), t_ns[gaps + 1].tolist(), strict=True)
        seconds = float(np.diff(t_ns)[gaps].sum() * 1e-9)
        below.append(Band(NO_SAMPLES, None, tuple(parts), seconds))
    return (*found, *below)


def joined(spans_ns: Sequence[tuple[int, int]], least_ns: int) -> list[tuple[int, int]]:
    """Return ascending spans, joined where less than a gap lies between them."""
    found: list[tuple[int, int]] = []
    for begin, end in spans_ns:
        if found and begin - found[-1][1] < least_ns:
            found[-1] = found[-1][0], max(end, found[-1][1])
        else:
            found.append((begin, end))
    return found


def spans(t_ns: Stamps, holds: Mask, gap_ns: int = GAP_NS) -> tuple[tuple[int, int], ...]:
    """Return the spans in which something holds: from a row to the next, but not over gaps."""
    until = np.append(t_ns[1:], t_ns[-1])
    until = np.where(until - t_ns > gap_ns, t_ns, until)
    begins = holds & ~np.append(False, holds[:-1] & (np.diff(t_ns) <= gap_ns))
    ends = holds & np.append(~holds[1:] | begins[1:], True)
    return tuple(zip(t_ns[begins].tolist(), until[ends].tolist(), strict=True))
