"""Stamped columns: their clock run, thinning, changes, nearest rows, and assumed accuracies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ekf_companion.logs.recording import misfits
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps

Spans = list[tuple[int, int]]
"""First and last stamp of each stretch of time, ns, ascending."""
Ranges = list[tuple[int, int]]
"""First row of each stretch, and the row behind it."""

BACK_NS = 2_000_000_000
"""Step back of the stamps beyond which the clock has restarted, or a stamp is damaged."""
GAP_NS = 60_000_000_000
"""Step forward beyond which the same is true."""
FEW = 0.01
"""Share of all rows below which a stretch between two jumps counts as damage."""
MOST_STRETCHES = 100_000
"""Stretches beyond which the stamps are not a clock's, since each jump begins another."""
MOST_APART = 8
"""Runs of rows with damaged stamps that may follow each other before the clock continues."""
MARGIN_NS = 2_000_000_000
"""Margin around the inertial samples' time within which other rows belong to the same clock run."""
LATEST_US = 2**62 // 1000
"""us; a later stamp is damaged."""
FIX_3D = 3
"""Lowest GNSS fix type with a position, in all formats."""
GNSS_HEADING_STD = float(np.deg2rad(5.0))
"""rad, where the receiver gives a heading and no accuracy of it."""
HEADING_STD = float(np.deg2rad(5.0))
"""rad, of the autopilot's own heading: that of a calibrated compass in flight."""
HEADING_RATE = 10.0
"""Hz at most, of the autopilot's own heading: its errors are correlated, so more rows add
nothing."""


def nanoseconds(stamps_us: npt.NDArray[Any]) -> Stamps:
    """Convert microseconds to ns; values that would overflow are damage, and stay huge.

    Damaged stamps of other types: negative and non-finite ones become 0.
    """
    if stamps_us.dtype.kind != "u":
        stamps_us = np.where(stamps_us > 0, stamps_us, 0)
    return np.asarray(np.minimum(stamps_us, np.uint64(LATEST_US)), dtype=np.int64) * 1000


def clock_run(t_ns: Stamps) -> tuple[Mask, Spans]:
    """Find the run of the clock that holds most rows.

    Rows are split into stretches where the clock jumps, back by more than ``BACK_NS`` or forward
    by more than ``GAP_NS``. A stretch that continues an earlier one, with a few rows of other
    stamps in between, belongs to it: a damaged stamp costs its own row only. Stretches of few rows
    are dropped as damage. Of all chains of the others in which time ascends, the one with most
    rows is kept.

    Returns:
        Which rows belong to the run, and its stretches of time.
    """
    ranges, spans = clock_run_of_parts([t_ns])
    return in_ranges(ranges, 0, len(t_ns)), spans


def in_ranges(ranges: Ranges, first: int, count: int) -> Mask:
    """Return which of consecutive rows, starting at a number, are in ranges."""
    mask = np.zeros(count, dtype=bool)
    for begin, end in ranges:
        mask[max(begin - first, 0) : max(end - first, 0)] = True
    return mask


def clock_run_of_parts(parts: Iterable[Stamps]) -> tuple[Ranges, Spans]:
    """Find the clock run in stamps that come part by part; return ranges of rows, and of time."""
    first, low, high, rows = _stretches(parts)
    if not rows:
        return [], []
    end = np.append(first[1:], rows)
    group = _groups(low, high, end - first, max(FEW * rows, 1.0))
    places: dict[int, list[int]] = {}
    for place, number in enumerate(group):
        places.setdefault(number, []).append(place)
    weights = {one: int((end[of] - first[of]).sum()) for one, of in places.items()}
    # 0 is no time where others are far from it
    timed = [one for one in weights if low[one] or high[one]] or list(weights)
    enough = [one for one in timed if weights[one] >= FEW * rows]
    enough = enough or [max(timed, key=lambda one: weights[one])]
    lows = np.array([low[one] for one in enough])
    highs = np.array([high[places[one][-1]] for one in enough])
    chain = _heaviest_chain(lows, highs, np.array([weights[one] for one in enough]))
    chosen = sorted(place for index in chain for place in places[enough[index]])
    return (
        _joined([(int(first[place]), int(end[place])) for place in chosen]),
        [(int(lows[index]), int(highs[index])) for index in chain],
    )


def _stretches(parts: Iterable[Stamps]) -> tuple[Indices, Stamps, Stamps, int]:
    """Return for each stretch without a jump its first row, first and last stamp; and the rows."""
    firsts: list[Stamps] = []
    lows: list[Stamps] = []
    highs: list[Stamps] = []
    rows, last = 0, np.int64(0)
    for t_ns in parts:
        if not len(t_ns):
            continue
        step = np.diff(t_ns, prepend=last if rows else t_ns[0])
        cuts = np.flatnonzero(np.abs(step) > BACK_NS)
        if rows:
            highs.append(np.where(cuts > 0, t_ns[cuts - 1], last))
        else:
            highs.append(t_ns[cuts - 1])
            cuts = np.append(0, cuts)
        firsts.append(rows + cuts)
        lows.append(t_ns[cuts])
        rows, last = rows + len(t_ns), t_ns[-1]
    if not rows:
        nothing = np.zeros(0, dtype=np.int64)
        return nothing, nothing, nothing, 0
    high = np.append(np.concatenate(highs), last)
    return np.concatenate(firsts), np.concatenate(lows), high, rows


def _groups(low: Stamps, high: Stamps, rows: Stamps, few: float) -> list[int]:
    """Return for each stretch the number of the first one that it continues.

    It continues the one before if it follows within ``GAP_NS``, or an earlier one that only a few
    rows with damaged stamps separate from it, such as a single row of stamp 0.
    """
    if len(low) > MOST_STRETCHES:
        step = low[1:] - high[:-1]
        cuts = np.append(0, np.flatnonzero((step < -BACK_NS) | (step > GAP_NS)) + 1)
        return [int(one) for one in np.repeat(cuts, np.diff(np.append(cuts, len(low))))]
    group: list[int] = []
    for here, begin in enumerate(low.tolist()):
        best, between = -1, 0
        for place in range(here - 1, max(here - 1 - MOST_APART, -1), -1):
            is_time = bool(low[place] or high[place])
            goes_on = is_time and -BACK_NS <= begin - high[place] <= GAP_NS
            if goes_on and (best < 0 or abs(begin - high[place]) < abs(begin - high[best])):
                best = place
            between += int(rows[place])
            if between > few:
                break
        group.append(here if best < 0 else group[best])
        if best >= 0:
            group[best + 1 : here] = range(best + 1, here)
    return group


def _joined(ranges: Ranges) -> Ranges:
    """Return ascending ranges with adjacent ones joined."""
    found: Ranges = []
    for begin, end in ranges:
        if found and found[-1][1] == begin:
            found[-1] = (found[-1][0], end)
        else:
            found.append((begin, end))
    return found


def _heaviest_chain(low: Stamps, high: Stamps, rows: Stamps) -> list[int]:
    """Return the chain of stretches with most rows in which each begins after the one before."""
    # At most 1 / FEW stretches, so the square is small.
    weight = [int(count) for count in rows]
    before = [-1] * len(weight)
    for here in range(len(weight)):
        for there in range(here):
            if low[here] >= high[there] and weight[there] + int(rows[here]) > weight[here]:
                weight[here], before[here] = weight[there] + int(rows[here]), there
    chain, here = [], int(np.argmax(weight))
    while here >= 0:
        chain.append(here)
        here = before[here]
    return chain[::-1]


class CommonRun(NamedTuple):
    """Rows of a table that are on the clock run of another."""

    ranges: Ranges
    """Of the rows on the table's own run."""
    spans: Spans
    """Of the other's run; empty: any."""
    own: Spans
    """Of the table's own run."""

    def holds(self, first: int, t_ns: Stamps) -> Mask:
        """Return which of consecutive rows, from ``first`` on, are on the run, by their stamps."""
        mask = in_ranges(self.ranges, first, len(t_ns))
        if self.spans:
            near = [(t_ns >= a - MARGIN_NS) & (t_ns <= b + MARGIN_NS) for a, b in self.spans]
            mask &= np.any(near, axis=0)
        return mask


def common_run(
    stamps: Mapping[str, Iterable[Stamps]], main: str, apart: Sequence[str] = ()
) -> dict[str, CommonRun]:
    """Return by name which rows are on the clock run of the table ``main``.

    Rows off it are damaged, or of another boot of the autopilot.

    Args:
        stamps: Of each table, part by part.
        main: The table that decides; without it each table keeps its own run.
        apart: Tables that may lie outside the time of ``main``.
    """
    runs = {name: clock_run_of_parts(parts) for name, parts in stamps.items()}
    spans = runs[main][1] if main in runs else []
    return {
        name: CommonRun(ranges, [] if name in apart else spans, own)
        for name, (ranges, own) in runs.items()
    }


Extent = tuple[int, int]
"""First and last stamp of a log, ns."""


def extent(runs: Mapping[str, CommonRun], names: Iterable[str], main: str) -> Extent:
    """Return the first and last stamp of tables on a clock with the table ``main``, ns.

    A table whose own run touches the time of ``main`` shows when the log began and ended, even
    though only its rows within that time are used.
    """
    spans = runs[main].own if main in runs else []
    near = [
        span
        for name in names
        if name in runs and touches(runs[name].own, spans)
        for span in runs[name].own
    ]
    near += spans
    return min((a for a, _ in near), default=0), max((b for _, b in near), default=0)


def touches(spans: Spans, others: Spans) -> bool:
    """Return whether two sets of stretches overlap in time."""
    return any(a <= d and c <= b for a, b in spans for c, d in others)


def left_out(
    runs: Mapping[str, CommonRun],
    rows: Mapping[str, tuple[int, int]],
    stamps: Callable[[str], Iterable[Stamps]],
) -> list[str]:
    """Return notes on rows that are not used because of their stamps.

    Args:
        runs: Of the tables.
        rows: Of each table by name: the number of rows, and of those in use.
        stamps: Returns those of a table by its name, part by part.
    """
    whole, used = (sum(of[index] for of in rows.values()) for index in (0, 1))
    outside = sum(
        sum(end - first for first, end in runs[name].ranges) - used_of
        for name, (_, used_of) in rows.items()
        if name in runs and runs[name].spans and touches(runs[name].own, runs[name].spans)
    )
    lost, zeros = whole - used - outside, 0
    for name in rows if lost else ():
        zeros += zeros_off(stamps(name), runs[name].holds) if name in runs else 0
    words = "whose time stamps do not fit the log's clock"
    found = misfits(lost, whole, words, min(zeros, lost))
    if outside:
        found.append(f"{outside} rows before or after the inertial samples were left out")
    return found


def zeros_off(parts: Iterable[Stamps], holds: Callable[[int, Stamps], Mask]) -> int:
    """Return how many rows are stamped 0 and off the run.

    Args:
        parts: Their stamps, part by part.
        holds: Returns which rows of a part are on the run, by the number of the first.
    """
    first = found = 0
    for t_ns in parts:
        found += int(((t_ns == 0) & ~holds(first, t_ns)).sum())
        first += len(t_ns)
    return found


def ascending(t_ns: Stamps) -> Mask:
    """Return which rows are later than every row before them."""
    if len(t_ns) == 0:
        return np.zeros(0, dtype=bool)
    newest = np.maximum.accumulate(t_ns)
    return np.concatenate([[True], newest[1:] > newest[:-1]])


def thinned(t_ns: Stamps, rate: float) -> slice:
    """Return the stride that thins a steady series to a rate, Hz; it may be exceeded by 10 %."""
    if len(t_ns) < 3:
        return slice(None)
    period_ns = max(float(np.median(np.diff(t_ns))), 1.0)
    return slice(None, None, max(1, int(np.ceil(1e9 / (rate * period_ns) - 0.1))))


def changed(*columns: npt.ArrayLike) -> Mask:
    """Return in which rows a column differs from the row before; the first row counts."""
    first = np.asarray(columns[0])
    mask = np.zeros(len(first), dtype=bool)
    mask[:1] = True
    for column in columns:
        column = np.asarray(column)
        # NaN differs from NaN: a missing value after a missing value is no change.
        both_nan = np.isnan(column[1:]) & np.isnan(column[:-1])
        mask[1:] |= (column[1:] != column[:-1]) & ~both_nan
    return mask


def nearest(t_ns: Stamps, others_ns: Stamps) -> Stamps:
    """Return for each stamp the index of the nearest of others (sorted, not empty)."""
    right = np.clip(np.searchsorted(others_ns, t_ns), 1, max(len(others_ns) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(others_ns) - 1)
    nearer = np.abs(others_ns[right] - t_ns) < np.abs(t_ns - others_ns[left])
    return np.where(nearer, right, left)


def accuracy(value: npt.ArrayLike, otherwise: npt.ArrayLike) -> Array:
    """Return accuracies where they are known (finite, positive), defaults elsewhere."""
    value = np.asarray(value, dtype=float)
    return np.where(np.isfinite(value) & (value > 0.0), value, otherwise)


def stack(table: Mapping[str, npt.NDArray[Any]] | npt.NDArray[np.void], *names: str) -> Array:
    """Return columns of a table as rows of floats, shape (n, k)."""
    return np.stack([table[name] for name in names], axis=1).astype(float)
