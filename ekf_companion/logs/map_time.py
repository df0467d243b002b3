"""Times in the notation of map formats."""

from __future__ import annotations

import re
from typing import NamedTuple
from xml.sax.saxutils import escape

import numpy as np

from ekf_companion.logs.recording import CLOCK_SET_S
from ekf_companion.nav.arrays import Stamps


class Label(NamedTuple):
    """Name of a track on a map, and how its times become UTC."""

    name: str = "estimate"
    """The log's name."""
    zero_ns: int | None = None
    """UTC at which the log's clock was zero, ns since 1970; None: not known."""

    @property
    def text(self) -> str:
        """The name as text of an XML file, which may hold no control characters."""
        return escape(_NO_XML.sub("\ufffd", self.name))


_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML may not hold, XML 1.0, 2.2."""
UNNAMED = Label()


def utc(stamp_ns: Stamps, zero_ns: int | None = None) -> list[str]:
    """Return stamps as ``2026-11-22T19:00:00.123456Z``.

    A stamp that counts from the autopilot's boot becomes a time in 1970 if the time of the boot is
    not known.
    """
    if zero_ns is not None:
        is_set = stamp_ns > CLOCK_SET_S * 1_000_000_000  # UTC already
        stamp_ns = np.where(is_set, stamp_ns, stamp_ns + zero_ns)
    texts = np.datetime_as_string(stamp_ns.astype("datetime64[ns]"), unit="us")
    return [f"{text}Z" for text in texts.tolist()]
