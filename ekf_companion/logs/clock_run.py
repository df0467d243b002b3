"""The run of the clock that a log is read on: of several clocks the one with most rows.

What belongs to a clock is the rule of :mod:`ekf_companion.nav.stamps`, which also judges stamps as
they arrive. Here all stamps are known at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.logs.recording import Damage, counted, dropped, misfits
from ekf_companion.nav.arrays import Indices, Mask, Stamps
from ekf_companion.nav.stamps import BACK_NS, BACK_US, GAP_US, LONG_US, SHORT, goes_on, rounds

Spans = list[tuple[int, int]]
"""First and last stamp of each stretch of time, ns, ascending."""
Ranges = list[tuple[int, int]]
"""First row of each stretch, and the row behind it."""

FEW = 0.01
"""Share of all rows below which a stretch between two jumps counts as damage."""
MOST_STRETCHES = 1_000_000
"""Stretches, of which each jump begins one, beyond which only those side by side are compared: a
million takes 5 s."""
MOST_APART = 8
"""Runs of rows with damaged stamps that may follow each other before the clock continues."""


def of_stamps(t_ns: Stamps) -> tuple[Mask, Spans]:
    """Find the run of the clock that holds most rows.

    Rows are split into stretches where the clock jumps, either way, by more than stamps may be
    late. A stretch that goes on from an earlier one, with a few rows of other stamps in between,
    belongs to it: a damaged stamp costs its own row only. Stretches of few rows are dropped as
    damage. Of all chains of the others in which time ascends, the one with most rows is kept.

    Returns:
        Which rows belong to the run, and its stretches of time.
    """
    ranges, spans = of_parts([t_ns])
    return in_ranges(ranges, 0, len(t_ns)), spans


def in_ranges(ranges: Ranges, first: int, count: int) -> Mask:
    """Return which of consecutive rows, starting at a number, are in ranges."""
    mask = np.zeros(count, dtype=bool)
    for begin, end in ranges:
        mask[max(begin - first, 0) : max(end - first, 0)] = True
    return mask


def of_parts(parts: Iterable[Stamps]) -> tuple[Ranges, Spans]:
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
    spans: Spans = []
    for index in chain:
        begin = int(lows[index])
        if spans and goes_on((begin - spans[-1][1]) // 1000, GAP_US):
            begin = spans.pop()[0]
        spans.append((begin, int(highs[index])))
    return _joined([(int(first[place]), int(end[place])) for place in chosen]), spans


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
        cuts = np.flatnonzero(~goes_on(step // 1000, BACK_US))
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
    """Return for each stretch the number of the first one that it belongs to.

    It belongs to the one that it goes on from, though a few rows with damaged stamps stand between
    them, such as a single row of stamp 0. Two of many rows side by side stay apart: either may be
    of another clock, which the chain decides.
    """
    low_us, high_us = low // 1000, high // 1000
    reach = _reach(low_us, high_us, rows)
    if len(low) > MOST_STRETCHES:
        follows = goes_on(low_us[1:] - high_us[:-1], np.minimum(reach[1:], reach[:-1]))
        cuts = np.append(0, np.flatnonzero(~follows) + 1)
        return [int(one) for one in np.repeat(cuts, np.diff(np.append(cuts, len(low))))]
    # Lists: the numbers are read one by one
    lows, highs, far, sizes = (one.tolist() for one in (low_us, high_us, reach, rows))
    group: list[int] = []
    weight = sizes[:]  # rows of each group
    for here, begin in enumerate(lows):
        best, between, least = -1, 0, 0
        for place in range(here - 1, max(here - 1 - MOST_APART, -1), -1):
            step = begin - highs[place]
            is_time = bool(lows[place] or highs[place])
            is_sure = place == here - 1 and min(sizes[here], sizes[place]) >= few
            follows = is_time and goes_on(step, min(far[here], far[place])) and not is_sure
            if follows and (best < 0 or abs(step) < least):
                best, least = place, abs(step)
            between += sizes[place]
            if between > few:
                break
        if best >= 0:
            # What is between is the damage, if it is the lighter one
            others = set(group[best + 1 :]) - {group[best]}
            best = best if sum(weight[one] for one in others) <= weight[group[best]] else -1
        if best < 0:
            group.append(here)
            continue
        group.append(group[best])
        weight[group[best]] += weight[here]
        for place in range(best + 1, here):
            weight[group[place]] -= sizes[place]
            group[place], weight[place] = place, sizes[place]
    return group


def _reach(low_us: Stamps, high_us: Stamps, rows: Stamps) -> Stamps:
    """Return how far the stretches before and after each one may be, us.

    A row by itself that is far from all others proves nothing, unless all rows come so seldom.
    """
    far = LONG_US
    if 2 * len(rows) > rows.sum() and len(rows) > 1:
        far = max(far, int(2.0 * np.median(low_us[1:] - high_us[:-1])))
    return np.where(rows > 1, GAP_US, min(far, GAP_US))


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
    """Return the chain of stretches with most rows in which each begins after the one before.

    One that goes on from the stretch just before it in the file is of the same boot. It follows an
    earlier one only at once, or if those between, whose stamps are wrong alike, took the time.
    """
    # At most 1 / FEW stretches, so the square is small.
    weight = [int(count) for count in rows]
    before = [-1] * len(weight)
    low_us, high_us = low // 1000, high // 1000
    spent_us = np.cumsum(high_us - low_us)
    for here in range(len(weight)):
        is_of_last = here > 0 and goes_on(low_us[here] - high_us[here - 1], GAP_US)
        for there in range(here):
            step_us = low_us[here] - high_us[there]
            skipped_us = spent_us[here - 1] - spent_us[there]
            is_near = abs(step_us - skipped_us) <= BACK_US or step_us <= BACK_US
            if step_us < -BACK_US or (is_of_last and there < here - 1 and not is_near):
                continue
            if weight[there] + int(rows[here]) > weight[here]:
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
            near = [(t_ns >= a - BACK_NS) & (t_ns <= b + BACK_NS) for a, b in self.spans]
            mask &= np.any(near, axis=0)
        return mask


def common(
    stamps: Mapping[str, Iterable[Stamps]], main: str, apart: Sequence[str] = ()
) -> dict[str, CommonRun]:
    """Return by name which rows are on the clock run of the table ``main``.

    Rows off it are damaged, or of another boot of the autopilot.

    Args:
        stamps: Of each table, part by part.
        main: The table that decides; without it each table keeps its own run.
        apart: Tables that may lie outside the time of ``main``.
    """
    runs = {name: of_parts(parts) for name, parts in stamps.items()}
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
) -> tuple[list[str], Damage]:
    """Return notes on rows that are not used because of their stamps, and how many were dropped.

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
        were = "was" if outside == 1 else "were"
        words = f"{counted(outside, 'row')} before or after the inertial samples {were} left out"
        found.append(words)
    return found, dropped(lost, whole)


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


def widened(t_ns: Stamps, reference_ns: Stamps, per_count: int) -> Stamps:
    """Return the stamps of a counter of 32 bits with the rounds that they lack.

    Args:
        t_ns: The stamps, ns.
        reference_ns: Stamps near to them, with all their rounds.
        per_count: ns of each count.
    """
    period = SHORT * per_count
    turns = rounds(t_ns, reference_ns, period, LONG_US * 1000)
    return np.asarray(t_ns + period * np.where((t_ns >= 0) & (t_ns < period), turns, 0))


class Unwinder:
    """Makes the stamps of a counter of 32 bits those of one that does not go round."""

    def __init__(self, per_count: int) -> None:
        """Begin with none; a count is so many ns."""
        self._per_count, self._period = per_count, SHORT * per_count
        self._last: int | None = None
        self._turns = 0

    def take(self, t_ns: Stamps) -> Stamps:
        """Return the next stamps, ns, with the rounds of the counter since the first."""
        if not len(t_ns):
            return t_ns
        before = np.append(t_ns[0] if self._last is None else self._last, t_ns[:-1])
        is_narrow = (before >= 0) & (before < self._period)
        step = (widened(t_ns, before, self._per_count) - t_ns) // self._period
        turns = self._turns + np.cumsum(np.where(is_narrow, step, 0))
        self._last, self._turns = int(t_ns[-1]), int(turns[-1])
        # Before the first there was none: a row that came late
        return np.asarray(t_ns + self._period * np.maximum(turns, 0))
