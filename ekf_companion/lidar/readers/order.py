"""Put stamps in order, or keep one run of a clock that was set back: which gives even steps."""

from __future__ import annotations

import numpy as np

from ekf_companion.nav.arrays import Array, Indices


def untangle(stamp: Array, what: str) -> tuple[Indices, list[str]]:
    """Return which stamps to keep, in order, and a sentence where they did not rise.

    A queue or a thread that delivers late leaves each stamp a place of its own: sorted, the steps
    are even. A clock that was set back tells some times twice: sorted, two runs lie in each
    other, and only one of them is kept.
    """
    steps = np.diff(stamp)
    back = np.flatnonzero(steps < 0)
    in_order = np.argsort(stamp, kind="stable")
    if not len(back):
        return in_order, []
    if len(back) == len(steps):
        return in_order, [f"{what} are stored last first: read in the order of their stamps"]
    usual = float(np.median(np.abs(steps[steps != 0])))
    ends = np.concatenate(([0], back + 1, [len(stamp)]))
    longest = int(np.argmax(np.diff(ends)))
    run = np.arange(ends[longest], ends[longest + 1])
    sorted_steps = np.diff(stamp[in_order])
    usual_sorted = float(np.median(sorted_steps))
    if _evenness(sorted_steps, usual_sorted) >= 0.9 * _evenness(np.diff(stamp[run]), usual):
        return in_order, [
            f"stamps of {what} go back {len(back)} times (first at number {back[0] + 1}): sorted"
        ]
    return run, [
        f"the clock of {what} was set back {len(back)} times (first at number {back[0] + 1}, by "
        f"{-steps[back[0]]:.3g}): only the longest run is read, {len(run)} of {len(stamp)}"
    ]


def _evenness(steps: Array, usual: float) -> float:
    """Return the share of steps that are as long as usual, to a half."""
    if not len(steps) or usual <= 0:
        return 0.0
    return float((np.abs(steps / usual - 1.0) < 0.5).mean())
