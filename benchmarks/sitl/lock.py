"""One flight at a time, where several programs on a machine fly."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def alone() -> Iterator[None]:
    """Hold the lock that SITL_LOCK names, if it names one."""
    path = os.environ.get("SITL_LOCK")
    if not path:
        yield
        return
    with Path(path).open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
