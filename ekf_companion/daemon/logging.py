"""The log: with fields to systemd's journal where stderr leads there, else as text; never a flood.

A record may carry fields of its own, which become the journal's::

    _log.warning("Reset: %s", reason, extra={"EKF_EVENT": "reset", "EKF_REASON": reason})

Fields: https://www.freedesktop.org/software/systemd/man/latest/systemd.journal-fields.html;
protocol: https://systemd.io/JOURNAL_NATIVE_PROTOCOL/, spoken by the library logging-journald.
"""

from __future__ import annotations

import copy
import logging
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

FORMAT = "%(levelname)s %(name)s: %(message)s"
IDENTIFIER = "ekf-companion"
SPAN = 10.0
"""Seconds in which one warning is said once."""
BURST = 5
"""Of what is no warning, so often in that time: it is news, until it repeats itself."""
KINDS = 256
"""Different sentences that are remembered."""
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_OWN = "EKF_"
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def set_up(level: int) -> None:
    """Log from now on, at this level and above."""
    if is_journal():
        inner: logging.Handler = JournalHandler()
    else:
        inner = logging.StreamHandler()
        inner.setFormatter(logging.Formatter(FORMAT))
    logging.basicConfig(level=level, handlers=[CalmHandler(inner)])


def flush() -> None:
    """Log how many lines were left out, where their time is over; to be called now and then."""
    for handler in logging.root.handlers:
        if isinstance(handler, CalmHandler):
            handler.flush()


def is_journal() -> bool:
    """Whether stderr is connected to the journal: JOURNAL_STREAM then names its device and inode.

    Source: systemd.exec(5), $JOURNAL_STREAM.
    """
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        there = os.fstat(sys.stderr.fileno())
        return (there.st_dev, there.st_ino) == (int(device), int(inode))
    except (OSError, ValueError):
        return False


class JournalHandler(logging.Handler):
    """Sends records as entries with fields; a journal that is slow or away holds up nobody."""

    def __init__(self, path: Path | None = None) -> None:
        """Open a socket.

        Args:
            path: Where the journal listens; None: where it does by default.
        """
        super().__init__()
        from logging_journald import JournaldTransport

        # Each entry is addressed, so that a journal that was started anew is found again
        self._transport = JournaldTransport(path, connected=False)
        self._transport.socket.setblocking(False)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send one entry; where there is no journal, write it to stderr as text."""
        try:
            self._transport.send(self._fields(record))
            self._lost = 0
        except BlockingIOError:
            self._lost += 1  # told with the next that gets through
        except OSError:
            sys.stderr.write(f"{record.levelname} {record.name}: {self.format(record)}\n")

    def close(self) -> None:
        """Close the socket."""
        self._transport.socket.close()
        super().close()

    def _fields(self, record: logging.LogRecord) -> Iterator[tuple[str, str]]:
        yield "MESSAGE", _readable(self.format(record))
        yield "PRIORITY", str(priority(record.levelno))
        yield "SYSLOG_IDENTIFIER", IDENTIFIER
        yield "LOGGER", record.name
        yield "CODE_FILE", record.pathname
        yield "CODE_LINE", str(record.lineno)
        yield "CODE_FUNC", record.funcName or ""
        yield "THREAD_NAME", record.threadName or ""
        if self._lost:
            yield "EKF_LOST", str(self._lost)
        for name, value in record.__dict__.items():
            if name.startswith(_OWN):
                yield name, _readable(str(value))


def priority(level: int) -> int:
    """Give syslog's number for a level."""
    return next((number for bound, number in _PRIORITIES if level >= bound), 7)


def _readable(text: str) -> str:
    """Give text that UTF-8 can hold: half a surrogate in a file's name would else end the entry."""
    return text.encode(errors="replace").decode()


@dataclass(slots=True)
class _Said:
    """One sentence, and how often it came."""

    begin_s: float
    passed: int = 1
    left_out: int = 0
    last: logging.LogRecord | None = None
    """Of those left out."""


class CalmHandler(logging.Handler):
    """Hands records on, but the same warning once in ten seconds, with the number left out.

    Warnings are the same by their reason (EKF_REASON) where they give one, and else by their text
    without its numbers, of which a pattern may give five; what is less than a warning by its whole
    text, five times. Errors, and what is for debugging, all pass. Whoever has a loop calls
    ``flush``: what was left out is then told at the end of its time, though nothing else comes.
    """

    def __init__(self, inner: logging.Handler, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._inner, self._clock = inner, clock
        self._said: dict[tuple[str, ...], _Said] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Hand one record on, or count it."""
        now_s = self._clock()
        if record.levelno < logging.INFO or record.levelno >= logging.ERROR:
            self._inner.handle(record)
            return
        key = self._key(record, now_s)
        said = self._said.get(key)
        if said is not None and now_s - said.begin_s < SPAN:
            if said.passed >= (1 if record.levelno >= logging.WARNING else BURST):
                said.left_out += 1
                said.last = record
                return
            said.passed += 1
            self._inner.handle(record)
            return
        self._said.pop(key, None)
        self._settle(now_s - SPAN)
        self._said[key] = _Said(now_s)
        self._inner.handle(_counted(record, said.left_out if said else 0))

    def flush(self) -> None:
        """Say what was left out, of all whose time is over."""
        self.acquire()
        try:
            self._settle(self._clock() - SPAN)
        finally:
            self.release()

    def close(self) -> None:
        """Say what was left out, and close what is behind."""
        self._settle(self._clock())
        self._inner.close()
        super().close()

    def _key(self, record: logging.LogRecord, now_s: float) -> tuple[str, ...]:
        if record.levelno < logging.WARNING:
            return record.name, "", record.getMessage()
        pattern = record.name, str(record.msg)
        if reason := str(getattr(record, "EKF_REASON", "")):
            return *pattern, reason
        key = *pattern, _NUMBER.sub("#", record.getMessage())
        fresh = (known for known, said in self._said.items() if now_s - said.begin_s < SPAN)
        is_flood = key not in self._said and sum(it[:2] == pattern for it in fresh) >= BURST
        return pattern if is_flood else key

    def _settle(self, before_s: float) -> None:
        """Forget what began before a time, or is too much; say of it what was left out."""
        for key, said in list(self._said.items()):
            if said.begin_s <= before_s or len(self._said) >= KINDS:
                del self._said[key]
                if said.last is not None:
                    self._inner.handle(_counted(said.last, said.left_out - 1))


def _counted(record: logging.LogRecord, left_out: int) -> logging.LogRecord:
    """Give a record that says how many like it were not handed on."""
    if not left_out:
        return record
    record = copy.copy(record)
    record.msg = f"{record.getMessage()} ({left_out} more like it before, left out)"
    record.args = None
    record.EKF_LEFT_OUT = left_out
    return record
