"""Times of arrival, as coarse as a .tlog holds them."""

from __future__ import annotations

SECOND_NS = 1_000_000_000


def quantise(now_ns: int) -> int:
    """Return a time, ns, as a .tlog holds it: whole microseconds, the low two bits cleared.

    Those two bits hold the number of the link.
    """
    return now_ns // 4000 * 4000
