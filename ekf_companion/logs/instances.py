"""Which of several sensors of a kind is used, over time.

The one that the autopilot uses, where the log names it. Otherwise, or where that one has no good
rows, the present one until it has no good rows and another has. It changes back only for the same
reason, never because of the sensor's number.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ekf_companion.logs.recording import counted
from ekf_companion.nav.arrays import Array, Indices, Mask, Stamps

Key = int
"""Identifies a sensor."""
Wanted = Sequence[tuple[int, Key]]
"""Start, ns, and sensor of each time in which the autopilot uses it; ascending."""
OVERLAP_NS = 30_000_000_000
"""Time over which two sensors are compared before a change from one to the other: long enough to
average vibration and noise, short enough that the drift is below the noise."""
ENOUGH = 20
"""Fewest rows side by side by which the difference is measured."""
MOST = 3
"""Changes that are reported one by one."""


class Good:
    """Times in which a sensor measures, collected as its rows are read part by part."""

    def __init__(self, patience_ns: int) -> None:
        """Bridge gaps of this length, or of three samples of a slow sensor."""
        self.spans: list[tuple[int, int]] = []
        """First and last good stamp of each, ns, ascending once :meth:`finish` was called."""
        self.patience_ns = patience_ns
        self._is_timed = False

    def add(self, t_ns: Stamps, is_good: Mask) -> None:
        """Take the next rows."""
        if not len(t_ns):
            return
        if not self._is_timed and len(t_ns) > 1:
            # Of all rows: a sensor that fails now and then is not slow
            steps = np.diff(t_ns)
            self._is_timed = True
            if (steps > 0).any():
                self.patience_ns = max(self.patience_ns, 3 * int(np.median(steps[steps > 0])))
        t_ns = t_ns[is_good]
        if not len(t_ns):
            return
        steps = np.diff(t_ns)
        cuts = np.flatnonzero((steps > self.patience_ns) | (steps < 0))
        first = t_ns[np.append(0, cuts + 1)].tolist()
        last = t_ns[np.append(cuts, len(t_ns) - 1)].tolist()
        for low, high in zip(first, last, strict=True):
            if self.spans and 0 <= low - self.spans[-1][1] <= self.patience_ns:
                self.spans[-1] = (self.spans[-1][0], high)
            else:
                self.spans.append((low, high))

    def finish(self) -> None:
        """Sort the stretches; overlapping ones, of several boots, are joined."""
        spans: list[tuple[int, int]] = []
        for low, high in sorted(self.spans):
            if spans and low - spans[-1][1] <= self.patience_ns:
                spans[-1] = (spans[-1][0], max(high, spans[-1][1]))
            else:
                spans.append((low, high))
        self.spans = spans


class Stretch(NamedTuple):
    """A time in which one sensor is used; the first one begins with the log."""

    from_ns: int
    key: Key
    is_wanted: bool
    """Whether the log names it as the one that the autopilot uses."""


def choose(good: Mapping[Key, Good], wanted: Wanted = ()) -> list[Stretch]:
    """Return the sensor in use over time; of equally good ones, the first given."""
    spans = {key: _lasting(key, good) for key in good}
    first = min((some[0][0] for some in spans.values() if some), default=0)
    last = max((some[-1][1] for some in spans.values() if some), default=0)
    for key, some in spans.items():
        # Who begins a little later than the first begins with it, and so at the end
        if some and some[0][0] - first <= good[key].patience_ns:
            some[0] = (first, some[0][1])
        if some and last - some[-1][1] <= good[key].patience_ns:
            some[-1] = (some[-1][0], last)
    starts = {key: [low for low, _ in some] for key, some in spans.items()}
    times = {t_ns for t_ns, _ in wanted}
    for some in spans.values():
        times |= {low for low, _ in some} | {high + 1 for _, high in some}
    since = [t_ns for t_ns, _ in wanted]
    used: list[Stretch] = []
    for t_ns in sorted(times):
        here = []
        for key, some in spans.items():
            place = bisect_right(starts[key], t_ns) - 1
            if place >= 0 and t_ns <= some[place][1]:
                here.append(key)
        if not here:
            continue
        # What the autopilot uses first is not said before it does
        choice = wanted[max(bisect_right(since, t_ns) - 1, 0)][1] if wanted else None
        current = used[-1].key if used else None
        key = choice if choice in here else current if current in here else here[0]
        if not used or key != current:
            used.append(Stretch(t_ns, key, key == choice))
    return used


def _lasting(key: Key, good: Mapping[Key, Good]) -> list[tuple[int, int]]:
    """Return the stretches of a sensor without short ones in which another is good throughout."""
    patience_ns = good[key].patience_ns
    others = [
        [low for low, _ in one.spans] for name, one in good.items() if name != key and one.spans
    ]
    ends = [
        [high for _, high in one.spans] for name, one in good.items() if name != key and one.spans
    ]

    def is_covered(low: int, high: int) -> bool:
        for starts, highs in zip(others, ends, strict=True):
            place = bisect_right(starts, low) - 1
            if place >= 0 and high <= highs[place]:
                return True
        return False

    return [
        (low, high)
        for low, high in good[key].spans
        if high - low >= patience_ns or not is_covered(low, high)
    ]


def place_of(used: Sequence[Stretch], t_ns: Stamps) -> Indices:
    """Return the number of the stretch at each time."""
    starts = np.array([one.from_ns for one in used[1:]], dtype=np.int64)
    return np.asarray(np.searchsorted(starts, t_ns, side="right"))


def steps(
    used: Sequence[Stretch], rows_of: Callable[[Key, int, int], tuple[Stamps, Array]]
) -> Array:
    """Return what to add to the values of each stretch so that they continue those before.

    It is the median difference of both sensors in the ``OVERLAP_NS`` before the change: a bias
    learnt of the first sensor then holds for the next too.

    Args:
        used: The stretches.
        rows_of: Returns the good rows of a sensor between two times: their stamps, ascending,
            and their values, shape (n, k).

    Returns:
        Shape (stretches, k). A sensor that is used again keeps its offset; one without rows
        beside those of the sensor before it keeps its values.
    """
    added: dict[Key, Array] = {}
    found: list[Array] = []
    for place, one in enumerate(used):
        if place == 0:
            _, values = rows_of(one.key, one.from_ns, one.from_ns + 1)
            added[one.key] = np.zeros(values.shape[1])
        elif one.key not in added:
            before = used[place - 1].key
            span = one.from_ns - OVERLAP_NS, one.from_ns
            (t_ns, values), (other_ns, others) = (rows_of(key, *span) for key in (before, one.key))
            step = np.zeros(values.shape[1])
            if len(other_ns) > 1:
                both = (t_ns >= other_ns[0]) & (t_ns <= other_ns[-1])
                if both.sum() >= ENOUGH:
                    beside = [np.interp(t_ns[both], other_ns, column) for column in others.T]
                    step = np.median(values[both] - np.stack(beside, axis=1), axis=0)
            added[one.key] = added[before] + step
        found.append(added[one.key])
    return np.array(found)


def describe(
    used: Sequence[Stretch], kind: str, names: Mapping[Key, str], lack: str, begun_ns: int
) -> list[str]:
    """Return a note for each change of the sensor; of many, for the first ones.

    Args:
        used: At least two.
        kind: Of the sensors.
        names: Of each.
        lack: What a sensor that is left lacks, as ``has no fix``.
        begun_ns: First stamp of the log.
    """
    notes = []
    for before, one in itertools.pairwise(used[: MOST + 1]):
        seconds = (one.from_ns - begun_ns) * 1e-9
        why = "the autopilot uses it" if one.is_wanted else f"{names[before.key]} {lack}"
        notes.append(f"{kind}: {names[one.key]} is used from {seconds:.1f} s on: {why}")
    if (rest := len(used) - 1 - len(notes)) > 0:
        notes.append(f"{kind}: the sensor in use changes {counted(rest, 'more time')}")
    return notes
