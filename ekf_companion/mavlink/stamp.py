"""Times of arrival on our clock, as coarse as a .tlog holds them."""

from __future__ import annotations

import math
from typing import TypeAlias

SECOND_NS = 1_000_000_000
BOARD_LINK = 3
"""Number of the link in a .tlog, of four, by which software of this board is told apart."""
Stamp: TypeAlias = int
"""Where it is compiled, still any number of Python's: a message may state what C could not hold."""


def quantise(now_ns: int) -> int:
    """Return a time, ns, as a .tlog holds it: whole microseconds, the low two bits cleared.

    Those two bits hold the number of the link.
    """
    return now_ns // 4000 * 4000


def seconds_since(since_ns: int | None, now_ns: int) -> float:
    """Return the seconds since a time on our clock; NaN if it never was."""
    return math.nan if since_ns is None else max(now_ns - since_ns, 0) * 1e-9
