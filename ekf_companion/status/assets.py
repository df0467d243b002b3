"""The files of the page that the browser loads, read from the installed package."""

from __future__ import annotations

from functools import cache
from html import escape
from importlib.resources import files
from typing import NamedTuple

from ekf_companion.core.memory.enums import Aid

_KINDS = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
    "txt": "text/plain; charset=utf-8",
}
CHARTS = ("uPlot.js", "uPlot.css")
"""The charting library, which is put beside the page when the package is built."""
NO_CHARTS = "This installation lacks the charting library uPlot: build it where npm is installed."
"""Said on the page in place of the charts."""


class Asset(NamedTuple):
    """One file, as it is sent."""

    kind: str
    """Content type."""
    body: bytes


@cache
def asset(name: str) -> Asset | None:
    """Return a file of the page by its name, without a path; None: there is none of that name."""
    folder = files("ekf_companion.status").joinpath("page")
    if name not in {entry.name for entry in folder.iterdir() if entry.is_file()}:
        return None
    kind = _KINDS.get(name.rpartition(".")[2], "application/octet-stream")
    return Asset(kind, folder.joinpath(name).read_bytes())


@cache
def index(source: str, tiles: str = "", credit: str = "") -> bytes:
    """Return the page itself.

    Args:
        source: Where its data comes from: ``live`` or ``log``.
        tiles: Address of the tiles of a map; empty: there is none.
        credit: What is written on the map.
    """
    page = asset("index.html")
    assert page is not None
    missing = "" if all(asset(name) for name in CHARTS) else NO_CHARTS
    text = page.body.decode().replace("{{source}}", source).replace("{{missing}}", missing)
    text = text.replace("{{aids}}", " ".join(aid.name.lower() for aid in Aid))
    text = text.replace("{{tiles}}", escape(tiles)).replace("{{credit}}", escape(credit))
    if missing:
        lines = text.splitlines(keepends=True)
        text = "".join(line for line in lines if "uPlot." not in line)
    return text.encode()
