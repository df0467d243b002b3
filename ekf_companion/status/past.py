"""The estimates of the last two minutes, one a second, for a page that is opened."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from ekf_companion.mavlink.stamp import SECOND_NS

_log = logging.getLogger(__name__)

KEPT = 120
"""Number of estimates: 0.2 MB."""


class Past:
    """Keeps one estimate a second, in the form that the page takes."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, bytes]] = deque(maxlen=KEPT)
        self._has_complained = False

    def keep(self, now_ns: int, make: Callable[[], bytes]) -> None:
        """Store what ``make`` returns, unless one of less than a second ago is stored."""
        if self._kept and now_ns - self._kept[-1][0] < SECOND_NS:
            return
        try:
            text = make()
        except Exception:  # noqa: BLE001  # a bug in what a page shows must not end a flight
            if not self._has_complained:
                _log.exception("The past cannot be sent to the page")
            self._has_complained, text = True, b"null"
        self._kept.append((now_ns, text))

    def to_json(self, now_ns: int) -> bytes:
        """Return a list of ``[age in s, estimate]``, the oldest first."""
        rows = (b"[%.1f,%s]" % ((now_ns - at_ns) * 1e-9, text) for at_ns, text in self._kept)
        return b"[%s]" % b",".join(rows)
