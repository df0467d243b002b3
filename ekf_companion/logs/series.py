"""Stamped columns: keep the course of time, thin, let values count when they change."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Stamps = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]
Spans = list[tuple[int, int]]
"""First and last stamp of each stretch of time, ns, ascending."""

BACK_NS = 1_000_000_000
"""A clock that goes back further than this began anew, or the stamp is damaged."""
GAP_NS = 60_000_000_000
"""A clock that goes forward further than this in one step did so, or the stamp is damaged."""
FEW = 0.01
"""Share of all rows below which a stretch between two jumps is taken for damage."""
MARGIN_NS = 2_000_000_000
"""How far outside the inertial samples' time other rows are still of the same course."""


def course(t_ns: Stamps) -> tuple[Mask, Spans]:
    """Find the one course of time that most rows agree on.

    Rows are split into stretches where the clock jumps, back by more than ``BACK_NS`` or forward
    by more than ``GAP_NS``; of all chains of stretches in which time ascends, the one with most
    rows is kept, without stretches that are too few to be more than damage.

    Returns:
        Which rows belong to it, and its stretches of time.
    """
    if len(t_ns) == 0:
        return np.zeros(0, dtype=bool), []
    step = np.diff(t_ns)
    cuts = np.flatnonzero((step < -BACK_NS) | (step > GAP_NS)) + 1
    edges = np.concatenate([[0], cuts, [len(t_ns)]])
    first, last = edges[:-1], edges[1:]
    enough = (last - first) >= FEW * len(t_ns)
    if not enough.any():
        enough[np.argmax(last - first)] = True
    first, last = first[enough], last[enough]
    low, high = t_ns[first], t_ns[last - 1]
    chain = _heaviest_chain(low, high, last - first)
    mask = np.zeros(len(t_ns), dtype=bool)
    spans: Spans = []
    for index in chain:
        mask[first[index] : last[index]] = True
        spans.append((int(low[index]), int(high[index])))
    return mask, spans


def _heaviest_chain(low: Stamps, high: Stamps, rows: Stamps) -> list[int]:
    """Give the chain of stretches with most rows in which each begins after the one before."""
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


def inside(t_ns: Stamps, spans: Spans, margin_ns: int = MARGIN_NS) -> Mask:
    """Say which stamps lie within the stretches, or at most a margin outside."""
    mask = np.zeros(len(t_ns), dtype=bool)
    for low, high in spans:
        mask |= (t_ns >= low - margin_ns) & (t_ns <= high + margin_ns)
    return mask


def ascending(t_ns: Stamps) -> Mask:
    """Say which rows are later than every row before them."""
    if len(t_ns) == 0:
        return np.zeros(0, dtype=bool)
    newest = np.maximum.accumulate(t_ns)
    return np.concatenate([[True], newest[1:] > newest[:-1]])


def thinned(t_ns: Stamps, rate: float) -> slice:
    """Give the stride that brings a steady series to at most a rate, Hz (10 % more passes)."""
    if len(t_ns) < 3:
        return slice(None)
    period_ns = max(float(np.median(np.diff(t_ns))), 1.0)
    return slice(None, None, max(1, int(np.ceil(1e9 / (rate * period_ns) - 0.1))))


def changed(*columns: npt.ArrayLike) -> Mask:
    """Say in which rows at least one column differs from the row before; the first row counts."""
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
    """Give for each stamp the index of the nearest of others (sorted, not empty)."""
    right = np.clip(np.searchsorted(others_ns, t_ns), 1, max(len(others_ns) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(others_ns) - 1)
    nearer = np.abs(others_ns[right] - t_ns) < np.abs(t_ns - others_ns[left])
    return np.where(nearer, right, left)
