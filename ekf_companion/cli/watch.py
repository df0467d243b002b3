"""Show a page on a terminal periodically, as much of it as fits; keys scroll it."""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType, RenderResult

_UP, _DOWN, _PAGE_UP, _PAGE_DOWN, _FIRST, _LAST = range(6)
_KEYS = {
    b"\x1b[A": _UP,
    b"k": _UP,
    b"\x1b[B": _DOWN,
    b"j": _DOWN,
    b"\x1b[5~": _PAGE_UP,
    b"\x1b[6~": _PAGE_DOWN,
    b" ": _PAGE_DOWN,
    b"\x1b[H": _FIRST,
    b"\x1b[1~": _FIRST,
    b"g": _FIRST,
    b"\x1b[F": _LAST,
    b"\x1b[4~": _LAST,
    b"G": _LAST,
}
"""Sequences of terminals, and the letters of ``less``."""


_INTERRUPT, _OTHER_SIGNAL = b"\x03", b"\x00"
"""Pseudo-keys for Ctrl-C, and for a signal that only redraws, such as a resize."""
_KEY = re.compile(rb"\x1b\[[0-?]*[ -/]*[@-~]|\x1bO.|\x1b(?!\[|O|$)|[^\x1b]", re.DOTALL)
"""A key as a terminal sends it: a sequence of ECMA-48, or a byte."""
_BEGUN = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*|O)?")
"""Beginning of a sequence."""
_LONGEST = 32
"""Bytes of a sequence; no key sends more."""


class Keys:
    """Finds keys in the input of a terminal: several may come together, and one in two parts."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the keys that are complete, in order."""
        data, self._rest = self._rest + data, b""
        found, place = [], 0
        while place < len(data):
            if (key := _KEY.match(data, place)) is None:
                if _BEGUN.fullmatch(data, place) and len(data) - place < _LONGEST:
                    self._rest = data[place:]
                    break
                place += 1
                continue
            found.append(_as_cursor(key[0]))
            place = key.end()
        return found


def _as_cursor(key: bytes) -> bytes:
    """Return a key of the application mode (ESC O A) as it comes without (ESC [ A)."""
    return b"\x1b[" + key[2:] if key[:2] == b"\x1bO" else key


class Window:
    """The lines of a page that fit the terminal, and a last line that says which."""

    def __init__(self) -> None:
        self._offset = self._count = self._rows = 0
        self._page: RenderableType = ""

    def show(self, page: RenderableType) -> None:
        """Take another page; the scroll position stays."""
        self._page = page

    def scroll(self, key: bytes) -> None:
        """Scroll by a key; others do nothing."""
        steps = {
            _UP: self._offset - 1,
            _DOWN: self._offset + 1,
            _PAGE_UP: self._offset - self._rows,
            _PAGE_DOWN: self._offset + self._rows,
            _FIRST: 0,
            _LAST: self._count,
        }
        if (step := _KEYS.get(key)) is not None:
            self._offset = self._clipped(steps[step])

    def _clipped(self, offset: int) -> int:
        return max(0, min(offset, self._count - self._rows))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the lines; rich calls this to draw."""
        from rich.segment import Segment
        from rich.style import Style

        lines = console.render_lines(self._page, options.update(height=None), pad=False)
        self._count, self._rows = len(lines), max(console.size.height - 1, 1)
        self._offset = self._clipped(self._offset)
        last = min(self._offset + self._rows, self._count)
        for line in lines[self._offset : last]:
            yield from line
            yield Segment.line()
        where = f"lines {self._offset + 1} to {last} of {self._count}"
        keys = "q ends" if self._count <= self._rows else "arrows, space scroll, q ends"
        yield Segment(f"{where}; {keys}"[: options.max_width], Style(dim=True))


def watch(fetch: Callable[[], RenderableType], period: float) -> None:
    """Show what ``fetch`` returns every ``period`` seconds, until ``q`` or Ctrl-C."""
    from rich.console import Console
    from rich.live import Live

    window = Window()
    window.show(fetch())
    with _keys() as wait, Live(window, screen=True, auto_refresh=False, console=Console()) as live:
        while True:
            due_s = time.monotonic() + period
            live.refresh()
            while (left_s := due_s - time.monotonic()) > 0.0:
                keys = wait(left_s)
                for key in keys:
                    if key in (b"q", _INTERRUPT):
                        return
                    window.scroll(key)
                if keys:
                    live.refresh()
            window.show(fetch())


@contextmanager
def _keys() -> Iterator[Callable[[float], list[bytes]]]:
    """Yield a function that waits for keys, so many seconds at most; Ctrl-C is one too."""
    import termios
    import tty

    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    # No exception ends it: one that comes in a finaliser is lost
    handler = signal.signal(signal.SIGINT, lambda *_: None)
    wakeup = signal.set_wakeup_fd(writer)
    resized = signal.signal(signal.SIGWINCH, lambda *_: None)
    terminal = sys.stdin.fileno() if sys.stdin.isatty() else None
    before: list[Any] | None = None
    if terminal is not None:
        before = termios.tcgetattr(terminal)
        tty.setcbreak(terminal)
    sources = [reader] if terminal is None else [reader, terminal]

    keys = Keys()

    def wait(seconds: float) -> list[bytes]:
        ready, _, _ = select.select(sources, [], [], seconds)
        if reader in ready:
            return [_INTERRUPT if signal.SIGINT in os.read(reader, 64) else _OTHER_SIGNAL]
        if terminal is None or terminal not in ready:
            return []
        try:
            data = os.read(terminal, 4096)
        except OSError:
            data = b""
        # A terminal that is gone is ready for ever
        return keys.feed(data) if data else [_INTERRUPT]

    try:
        yield wait
    finally:
        if terminal is not None and before is not None:
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        signal.set_wakeup_fd(wakeup)
        signal.signal(signal.SIGINT, handler)
        signal.signal(signal.SIGWINCH, resized)
        os.close(reader)
        os.close(writer)
