"""What processes are asked to do with a log; in a file that they import soon."""

import os
import resource
import signal
import tempfile
from pathlib import Path

import numpy as np

from ekf_companion.fleet import build
from ekf_companion.logs import source

_BUILD_NAME = build.build_name


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


def cut_at_b(log: Path) -> dict[str, str]:
    """Read a mapped file that somebody cuts short meanwhile."""
    if log.name == "b":
        source.LARGE = 1
        with tempfile.NamedTemporaryFile() as file:
            file.write(bytes(1 << 20))
            file.flush()
            mapped = source.MappedFile(Path(file.name), "log")
            file.truncate(10)
            return {"why": f"{sum(mapped.data)} bytes"}
    return {"why": "examined"}


def double(number: int) -> int:
    """Return twice a number."""
    return 2 * number


def die_once(number: int, folder: Path) -> int:
    """Return twice a number; at 5, die the first time."""
    mark = folder / f"{number}-died"
    if number == 5 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def pretend(version: str | None) -> None:
    """Call this process's build by another name; None: by its own again."""
    build.build_name = _BUILD_NAME if version is None else lambda: version


def faults_and_pages(size):
    """Take, write and free so many bytes a hundred times; return the faults, and pages written."""
    np.ones(size // 8)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    for _ in range(100):
        np.ones(size // 8)
    faults = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before
    return faults, 100 * size // resource.getpagesize()
