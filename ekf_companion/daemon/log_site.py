"""Serves the page of one log."""

from __future__ import annotations

from http import HTTPStatus

from ekf_companion.daemon.feed import Feed
from ekf_companion.daemon.pages import Answer


class LogSite:
    """The page with the data of a log, which does not change."""

    source = "log"

    def __init__(self, data: bytes) -> None:
        """Serve this JSON."""
        self.feed: Feed | None = None
        self._data = data

    def page(self, path: str, accept: str) -> Answer | None:
        """Return the data."""
        return (HTTPStatus.OK, "application/json", self._data) if path == "/log.json" else None
