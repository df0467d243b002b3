"""Readings of a sensor that is frozen: the same numbers go on for longer than chance allows.

Noise changes the last digit of a sensor that works. One that counts whole pixels repeats a reading
now and then, and no motion for a while; for a second it does not.
"""

from __future__ import annotations

import numpy as np

from ekf_companion.nav.arrays import Array, Mask, Stamps

HELD_NS = 1_000_000_000
"""Time after which equal readings are of a frozen sensor. Of a counter of pixels, 84 times a second
on a flight of 50 s between 0.3 and 1.6 m up, the longest run of equal ones lasted 0.04 s."""


class HeldReading:
    """Finds out, reading by reading, that a sensor is frozen."""

    def __init__(self) -> None:
        """Begin with nothing read."""
        self._last: tuple[float, ...] = ()
        self._first_ns = 0

    def is_held(self, t_ns: int, reading: tuple[float, ...]) -> bool:
        """Return whether this reading has been the same for so long."""
        if reading != self._last or t_ns < self._first_ns:
            self._last, self._first_ns = reading, t_ns
        return t_ns - self._first_ns >= HELD_NS


def held(t_ns: Stamps, *columns: Array) -> Mask:
    """Return in which rows the columns have been the same for so long, shape (n,)."""
    if not len(t_ns):
        return np.zeros(0, dtype=bool)
    is_new = np.ones(len(t_ns), dtype=bool)
    is_new[1:] = t_ns[1:] < t_ns[:-1]
    for column in columns:
        is_new[1:] |= column[1:] != column[:-1]
    first = np.maximum.accumulate(np.where(is_new, np.arange(len(t_ns)), 0))
    return np.asarray(t_ns - t_ns[first] >= HELD_NS)
