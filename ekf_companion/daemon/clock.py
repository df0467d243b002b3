"""The clocks of this board."""

from __future__ import annotations

import time
import uuid
from functools import cache
from pathlib import Path

from ekf_companion.engine.checkpoint import Clocks

_BOOT_NS = time.time_ns() - time.monotonic_ns()
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def unix_clock() -> int:
    """Return unix time, ns, without steps: the monotonic clock, set once."""
    return time.monotonic_ns() + _BOOT_NS


def unix_offset() -> int:
    """Return unix time less the monotonic clock of now, ns, by the quickest of a few readings."""
    found = []
    for _ in range(3):
        before, unix, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        found.append((after - before, unix - before))
    return min(found)[1]


def read_clocks() -> Clocks:
    """Return what a checkpoint needs to know its age after a restart."""
    if not (boot_id := _boot_id()):
        return Clocks(time.time_ns())
    return Clocks(time.time_ns(), time.clock_gettime_ns(time.CLOCK_BOOTTIME), boot_id)


@cache
def _boot_id() -> bytes:
    """Return the 16 bytes that Linux draws at boot; empty: there are none, unix time must do."""
    try:
        return uuid.UUID(_BOOT_ID.read_text(encoding="ascii").strip()).bytes
    except (OSError, ValueError):
        return b""
