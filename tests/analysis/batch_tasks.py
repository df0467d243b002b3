"""What processes are asked to do with a log; in a file that they import soon."""

import os
import signal
from pathlib import Path


def kill_at_b(log: Path) -> dict[str, str]:
    """Die at one log, as a process does for want of memory."""
    if log.name == "b":
        os.kill(os.getpid(), signal.SIGKILL)
    return {"why": "examined"}


def stumble_at_b(log: Path) -> dict[str, str]:
    """Fail by a bug at one log."""
    if log.name == "b":
        raise ZeroDivisionError("by nothing")
    return {"why": "examined"}
