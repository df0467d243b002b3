"""The estimates of the last two minutes, for a page that opens: one a second, whoever watches."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from ekf_companion.mavlink.stamp import SECOND_NS

KEPT = 120
"""How many: 0.2 MB."""


class Past:
    """Keeps the newest estimate of each second, as the page takes it."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, bytes]] = deque(maxlen=KEPT)

    def keep(self, now_ns: int, make: Callable[[], bytes]) -> None:
        """Keep what ``make`` returns, unless that of less than a second ago is kept."""
        if not self._kept or now_ns - self._kept[-1][0] >= SECOND_NS:
            self._kept.append((now_ns, make()))

    def to_json(self, now_ns: int) -> bytes:
        """Return a list of ``[age in s, estimate]``, the oldest first."""
        rows = (b"[%.1f,%s]" % ((now_ns - at_ns) * 1e-9, text) for at_ns, text in self._kept)
        return b"[%s]" % b",".join(rows)
