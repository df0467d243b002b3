"""The kind of log that a file is, by its first bytes and not by its suffix."""

from __future__ import annotations

import re
from codecs import BOM_UTF8
from pathlib import Path
from typing import NamedTuple

from ekf_companion.errors import LogError
from ekf_companion.logs.source import PACKED, head_of

HEAD = 1024
"""Bytes that are examined."""
HOUR_US = 3_600_000_000
"""Consecutive frames of a telemetry log are closer in time than this, us."""


_TEXT = re.compile(rb"^\s*FMT\s*,\s*128\s*,", re.MULTILINE)
"""A line that declares the records that declare records; a dump may begin with other lines."""


class Content(NamedTuple):
    """A kind of log."""

    words: str
    suffix: str


ULOG = Content("a ULog of PX4", ".ulg")
DATAFLASH = Content("a DataFlash log of ArduPilot", ".bin")
TLOG = Content("a telemetry log (stamped MAVLink)", ".tlog")


def content_of(head: bytes) -> Content | None:
    """Return the kind of log by its first bytes; None: not known."""
    if head.startswith(b"ULog\x01\x12"):
        return ULOG
    if head.startswith(b"\xa3\x95\x80"):  # the record that declares records
        return DATAFLASH
    second = _frame(head, 0)
    if second and _frame(head, second):
        stamps = (int.from_bytes(head[at : at + 8], "big") for at in (0, second))
        first_us, next_us = stamps
        return TLOG if abs(next_us - first_us) < HOUR_US else None
    return None


def _frame(head: bytes, place: int) -> int:
    """Return where a stamped MAVLink frame ends; 0: there is none."""
    frame = head[place + 8 : place + 11]
    if len(frame) < 3 or frame[0] not in (0xFD, 0xFE):
        return 0
    size = 8 if frame[0] == 0xFE else 25 if frame[2] & 1 else 12
    return place + 8 + frame[1] + size


def check_suffix(path: Path, suffix: str) -> None:
    """Refuse a log whose suffix is that of another kind.

    Raises:
        LogError: The file is of another kind than its suffix says; it names the remedy.
    """
    if not path.is_file():
        return
    head = head_of(path, HEAD)
    if _TEXT.search(head.removeprefix(BOM_UTF8)):
        raise LogError(
            f"{path}: holds {DATAFLASH.words} as text, which is not read; name the .bin that it "
            "was made from"
        )
    if path.suffix.lower() in PACKED:
        return
    found = content_of(head)
    if found is not None and found.suffix != suffix:
        raise LogError(
            f"{path}: holds {found.words}, whose suffix is {found.suffix}; rename it to "
            f"{path.with_suffix(found.suffix).name}"
        )
