"""The sequence numbers of one sender's frames: what was lost, late or sent twice (compiled)."""

from __future__ import annotations

from ekf_companion.mavlink.stamp import SECOND_NS

_NEAR = 16
"""Frames that may be lost before one whose checksum nobody can test; no larger gap is believed."""
_OVERTAKEN = 16
"""A number so little behind is that of a late frame; further behind, the numbers wrapped."""
_SILENCE_NS = 5 * SECOND_NS
"""After so long it is not known how often the numbers wrapped."""


class Sequence:
    """Counts lost and late frames by the sequence numbers, which wrap at 256."""

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
        """Forget the last number: the sender has restarted, or was not heard for long."""
        self._last = None

    def count(self, number: int, now_ns: int) -> None:
        """Count the number of a frame that arrived now."""
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

    def count_unverified(self, number: int, now_ns: int) -> None:
        """Count the number of a frame whose checksum nobody can test, if it is near the last."""
        if self._last is not None and (number - self._last - 1) & 0xFF <= _NEAR:
            self.count(number, now_ns)
