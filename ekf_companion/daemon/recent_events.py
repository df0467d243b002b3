"""The last lines of the log, for the page."""

from __future__ import annotations

import logging
from collections import deque
from typing import Any

import msgspec

KEPT = 60


class RecentEvents(logging.Handler):
    """Keeps the last lines, of level INFO and above."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self._lines: deque[dict[str, Any]] = deque(maxlen=KEPT)
        self.count = 0
        """How many there were."""

    def emit(self, record: logging.LogRecord) -> None:
        """Keep one line."""
        line = {
            "unix_s": record.created,
            "level": record.levelname.lower(),
            "text": record.getMessage(),
        }
        self._lines.append(line)
        self.count += 1

    def to_json(self) -> bytes:
        """Return the lines, the oldest first."""
        return msgspec.json.encode(list(self._lines))
