"""End of the processes that a flight needs."""

from __future__ import annotations

import subprocess
from typing import Any

_STOP = 5.0
"""Longest time to an orderly end, s."""


def end(process: subprocess.Popen[Any] | None) -> None:
    """End a process, if there is one: orderly, or by force where that takes too long."""
    if process is None:
        return
    process.terminate()
    try:
        process.wait(_STOP)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
