"""Why ODOMETRY was not sent: a full link, a stalled loop, or samples that came late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ekf_companion.link.backlog import FRESH_NS


class Mark(NamedTuple):
    """Counters at one moment, and the loop's longest delay since the mark before."""

    unsent: int
    """ODOMETRY that was not sent, for any reason."""
    stale: int
    """Of these, those that were too old when they could be sent."""
    lag_ns: int
    """Longest delay of the loop since the mark before."""


class Losses(NamedTuple):
    """ODOMETRY that was not sent, by cause."""

    link: int
    """The link had no room."""
    board: int
    """The loop stalled for longer than a message may wait."""
    late: int
    """The samples came too late, while the loop ran."""


def apportion(marks: Sequence[Mark]) -> Losses:
    """Return the losses between the first mark and the last, by cause.

    A loop that stalls for longer than a message may wait explains all that is lost in that half
    second. The stall is noted when the loop runs again, which can be a mark before the loss or a
    mark after it.
    """
    link = board = late = 0
    for place in range(1, len(marks)):
        unsent = marks[place].unsent - marks[place - 1].unsent
        stale = min(marks[place].stale - marks[place - 1].stale, max(unsent, 0))
        if max(mark.lag_ns for mark in marks[place - 1 : place + 2]) >= FRESH_NS:
            board += unsent
        else:
            late += stale
            link += unsent - stale
    return Losses(link, board, late)
