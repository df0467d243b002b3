"""The numbers of one sender's frames: what is missing, what came late, what came twice."""

from __future__ import annotations

from ekf_companion.mavlink.stamp import SECOND_NS

_OVERTAKEN = 16
"""A number so little behind is a frame that came late; further behind, the numbers went round."""
_SILENCE_NS = 5 * SECOND_NS
"""After so long nobody knows how often the numbers went round."""


class Sequence:
    """Counts what the numbers, which go round at 256, say of the link."""

    def __init__(self) -> None:
        self.lost = 0
        """Frames that never came."""
        self.late = 0
        """Frames that came after their successors."""
        self.duplicate = 0
        """Frames that came twice in a row."""
        self._last: int | None = None
        self._last_ns = 0

    def begin(self) -> None:
        """Forget the last number: who sends has begun anew, or was not heard for long."""
        self._last = None

    def count(self, number: int, now_ns: int) -> None:
        """Take the number of a frame that arrived now."""
        if self._last is not None and now_ns - self._last_ns <= _SILENCE_NS:
            gap = (number - self._last - 1) & 0xFF
            if gap > 0xFF - _OVERTAKEN:
                if gap == 0xFF:
                    self.duplicate += 1
                else:
                    self.late += 1
                return
            self.lost += gap
        self._last = number
        self._last_ns = now_ns
