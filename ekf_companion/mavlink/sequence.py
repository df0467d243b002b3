"""The sequence numbers of one sender's frames: what was lost, late or sent twice (compiled)."""

from __future__ import annotations

from ekf_companion.mavlink.stamp import SECOND_NS, Stamp

_NEAR = 16
"""Frames that may be lost before one whose checksum nobody can test; no larger gap is believed."""
_OVERTAKEN = 16
"""A number so little behind is that of a late frame; further behind, the numbers wrapped."""
_AGAIN_NS = SECOND_NS // 2
"""Frames that come again come with others."""
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
        self._last_ns: Stamp = 0
        self._again: int | None = None
        self._again_ns: Stamp = 0
        self._before: int | None = None
        self._gap = 0

    def begin(self) -> None:
        """Forget the last number: the sender has restarted, or was not heard for long."""
        self._last = self._again = self._before = None

    def count(self, number: int, now_ns: Stamp, is_behind: bool = False) -> bool:
        """Count the number of a frame that arrived now; return whether it came again.

        That is known only of frames near others that did. One whose stamp is behind is late, and
        not lost.
        """
        if self._last is not None and now_ns - self._last_ns <= _SILENCE_NS:
            gap = (number - self._last - 1) & 0xFF
            if gap > 0xFF - _OVERTAKEN:
                if gap == 0xFF:
                    self.duplicate += 1
                else:
                    self.late += 1
                return False
            if gap > _NEAR and is_behind:
                self.late += 1
                self.lost = max(self.lost - 1, 0)
                self.note_again(number, now_ns)
                return False
            if gap > 0 and self._is_again(number, gap, now_ns):
                return True
            self.lost += gap
            if gap > _NEAR:
                self._before, self._gap = self._last, gap
        self._last = number
        self._last_ns = now_ns
        return False

    def note_again(self, number: int, now_ns: Stamp) -> None:
        """Note the number of a frame that was heard before, which counts no more.

        Nor does one without a stamp that came just before it, and seemed to end a gap.
        """
        self._again, self._again_ns = number, now_ns
        if self._before is not None and self._last is not None:
            if (number - self._last - 1) & 0xFF <= _NEAR:
                self.lost -= min(self._gap, self.lost)
                self._last = self._before
            self._before = None

    def _is_again(self, number: int, gap: int, now_ns: Stamp) -> bool:
        """Whether a number rather goes on from that of a frame that was heard before."""
        if self._again is None or now_ns - self._again_ns > _AGAIN_NS:
            return False
        ahead = (number - self._again - 1) & 0xFF
        if ahead >= min(gap, _NEAR + 1):
            return False
        self._again = number
        return True

    def count_unverified(self, number: int, now_ns: Stamp) -> None:
        """Count the number of a frame whose checksum nobody can test, if it is near the last."""
        if self._last is not None and (number - self._last - 1) & 0xFF <= _NEAR:
            self.count(number, now_ns)
