"""Why ODOMETRY did not go out: the link had no room, this board had no time, or it came late."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ekf_companion.link.backlog import FRESH_NS


class Mark(NamedTuple):
    """What was counted until one moment, and the loop's lag since the moment before."""

    unsent: int
    """ODOMETRY that did not go out, for any reason."""
    stale: int
    """Of these, such as were too old when they could be sent."""
    lag_ns: int
    """The longest wait of the loop since the mark before."""


class Losses(NamedTuple):
    """ODOMETRY that did not go out, by who held it up."""

    link: int
    """The link took no more."""
    board: int
    """The loop was held up for as long as a message may wait."""
    late: int
    """The samples had come too late, while the loop ran."""


def apportion(marks: Sequence[Mark]) -> Losses:
    """Return what was lost between the first mark and the last, by its cause.

    A loop that is held up for as long as a message may wait for room explains by itself all that is
    lost in that half second. The wait is noted when the loop goes on, which can be a mark before
    the loss or a mark after it.
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
