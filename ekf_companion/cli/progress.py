"""Progress on one line of the standard error, once a command has printed nothing for a while."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import TextIO

QUIET_S = 2.0
"""Seconds without output after which a user wonders whether anything happens."""
REDRAW_S = 0.5
_CLEAR = "\r\x1b[2K"
"""Moves to the beginning of the terminal's line, and clears it."""


class Progress:
    """A task, and how much of it is done; called with the parts done, and with all."""

    def __init__(
        self, title: str, *, is_terminal: bool, width: int = 80, in_seconds: bool = False
    ) -> None:
        """Begin.

        Args:
            title: Name of the task.
            is_terminal: Whether a line can be overwritten; else lines follow, more and more rarely.
            width: Of the terminal, characters.
            in_seconds: Whether the parts are milliseconds.
        """
        self._title, self._is_terminal = title, is_terminal
        self._width, self._in_seconds = width, in_seconds
        self._done = self._total = 0
        self._next_s = QUIET_S

    def __call__(self, done: int, total: int) -> None:
        """Note how many parts of how many are done."""
        self._done, self._total = done, total

    def stage(self, title: str) -> None:
        """Begin another stage of unknown length."""
        self._title = title
        self._done = self._total = 0

    def text(self, seconds: float) -> str:
        """Return the line after so many seconds."""
        done, total = self._done, self._total
        if total <= 0:
            return f"{self._title}: {seconds:.0f} s"
        if self._in_seconds:
            return f"{self._title}: {done * 1e-3:.0f} of {total * 1e-3:.0f} s"
        share = min(done / total, 1.0)
        # What has begun and is not done yet counts as nothing: at first the rest seems longer
        rest = f", {_in_words(seconds * (1.0 / share - 1.0))} left" if 0.0 < share < 1.0 else ""
        return f"{self._title}: {share:.0%}, {seconds:.0f} s{rest}"

    def due(self, seconds: float) -> str:
        """Return the text to write after so many seconds; empty: nothing."""
        if seconds < self._next_s:
            return ""
        if self._is_terminal:
            # The cursor stays in front, so that what others write does not follow the line
            return f"{_CLEAR}{self.text(seconds)[: self._width - 1]}\r"
        self._next_s = 2.0 * seconds
        return f"{self.text(seconds)}\n"


def _in_words(seconds: float) -> str:
    """Return a time to wait: ``40 s``, ``7 min``, ``3.2 h``."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


@contextmanager
def progress_line(title: str, *, in_seconds: bool = False) -> Iterator[Progress]:
    """Show a task's progress while nothing else is printed; on a terminal the line vanishes.

    In a file or a pipe the lines stay: after 2 s, 4 s, 8 s and so on.
    """
    stream, width = sys.stderr, shutil.get_terminal_size().columns
    is_terminal = stream.isatty()
    progress = Progress(title, is_terminal=is_terminal, width=width, in_seconds=in_seconds)
    end = Event()
    writer = Thread(target=_write, args=(progress, stream, end), name="progress", daemon=True)
    writer.start()
    try:
        yield progress
    finally:
        end.set()
        writer.join(REDRAW_S)  # a reader that has stopped does not hold up the command
        if is_terminal:
            with suppress(OSError, ValueError):
                stream.write(_CLEAR)
                stream.flush()


def _write(progress: Progress, stream: TextIO, end: Event) -> None:
    begin_s, pause_s = time.monotonic(), QUIET_S
    # The stream may be closed, or lead to somebody who is gone
    with suppress(OSError, ValueError):
        while not end.wait(pause_s):
            stream.write(progress.due(time.monotonic() - begin_s))
            stream.flush()
            pause_s = REDRAW_S
