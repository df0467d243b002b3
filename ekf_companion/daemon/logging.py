"""The log: to systemd's journal, with fields, if stderr leads there, else as text; rate limited.

A record may have fields of its own, which become fields of the journal::

    _log.warning("Reset: %s", reason, extra={"EKF_EVENT": "reset", "EKF_REASON": reason})

Fields: https://www.freedesktop.org/software/systemd/man/latest/systemd.journal-fields.html;
protocol: https://systemd.io/JOURNAL_NATIVE_PROTOCOL/, implemented by the library
logging-journald.
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
"""Seconds in which the same warning is logged once."""
BURST = 5
"""Number of times that the same line below a warning is logged in that time."""
KINDS = 256
"""Number of different lines that are tracked."""
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_OWN = "EKF_"
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def set_up(level: int) -> None:
    """Set up logging at this level and above."""
    if is_journal():
        inner: logging.Handler = JournalHandler()
    else:
        inner = logging.StreamHandler()
        inner.setFormatter(logging.Formatter(FORMAT))
    logging.basicConfig(level=level, handlers=[RateLimitHandler(inner)])


def flush(*, is_end: bool = False) -> None:
    """Log how many lines were left out, where their time is over; call it periodically.

    At the end all are due.
    """
    for handler in logging.root.handlers:
        if isinstance(handler, RateLimitHandler):
            handler.flush_all() if is_end else handler.flush()


def is_journal() -> bool:
    """Return whether stderr is the journal, whose device and inode JOURNAL_STREAM names.

    Source: systemd.exec(5), $JOURNAL_STREAM.
    """
    device, _, inode = os.environ.get("JOURNAL_STREAM", "").partition(":")
    try:
        there = os.fstat(sys.stderr.fileno())
        return (there.st_dev, there.st_ino) == (int(device), int(inode))
    except (OSError, ValueError):
        return False


class JournalHandler(logging.Handler):
    """Sends records as entries with fields; a slow or missing journal delays nobody."""

    def __init__(self, path: Path | None = None) -> None:
        """Open a socket to the journal, by default the usual one."""
        super().__init__()
        from logging_journald import JournaldTransport

        # Each entry is addressed, so that a restarted journal gets it too
        self._transport = JournaldTransport(path, connected=False)
        self._transport.socket.setblocking(False)
        self._lost = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Send one entry; if there is no journal, write it to stderr as text."""
        try:
            self._transport.send(self._fields(record))
            self._lost = 0
        except BlockingIOError:
            self._lost += 1  # reported with the next entry
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
    """Return syslog's number for a level."""
    return next((number for bound, number in _PRIORITIES if level >= bound), 7)


def _readable(text: str) -> str:
    """Return text that UTF-8 can encode: a lone surrogate in a file name would end the entry."""
    return text.encode(errors="replace").decode()


@dataclass(slots=True)
class _Line:
    """One line, and how often it came."""

    begin_s: float
    passed: int = 1
    left_out: int = 0
    last: logging.LogRecord | None = None
    """The last one that was left out."""


class RateLimitHandler(logging.Handler):
    """Passes records on, but the same warning once in ten seconds, with the number left out.

    Warnings are the same by their reason (EKF_REASON) if they have one, else by their text without
    its numbers, and five such texts of one format at most are told apart. Lines below a warning are
    the same by their whole text, and pass five times. Errors and debugging lines all pass. Call
    ``flush`` periodically: it logs what was left out when its time is over.
    """

    def __init__(self, inner: logging.Handler, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._inner, self._clock = inner, clock
        self._lines: dict[tuple[str, ...], _Line] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Pass one record on, or count it."""
        now_s = self._clock()
        if record.levelno < logging.INFO or record.levelno >= logging.ERROR:
            self._inner.handle(record)
            return
        key = self._key(record, now_s)
        line = self._lines.get(key)
        if line is not None and now_s - line.begin_s < SPAN:
            if line.passed >= (1 if record.levelno >= logging.WARNING else BURST):
                line.left_out += 1
                line.last = record
                return
            line.passed += 1
            self._inner.handle(record)
            return
        self._lines.pop(key, None)
        self._forget(now_s - SPAN)
        self._lines[key] = _Line(now_s)
        self._inner.handle(_counted(record, line.left_out if line else 0))

    def flush(self) -> None:
        """Log how many were left out, of all lines whose time is over."""
        self._flush(SPAN)

    def flush_all(self) -> None:
        """Log how many were left out, of all lines."""
        self._flush(0.0)

    def _flush(self, age_s: float) -> None:
        self.acquire()
        try:
            self._forget(self._clock() - age_s)
        finally:
            self.release()

    def close(self) -> None:
        """Log how many were left out, and close the inner handler."""
        self.flush_all()
        self._inner.close()
        super().close()

    def _key(self, record: logging.LogRecord, now_s: float) -> tuple[str, ...]:
        if record.levelno < logging.WARNING:
            return record.name, "", record.getMessage()
        pattern = record.name, str(record.msg)
        if reason := str(getattr(record, "EKF_REASON", "")):
            return *pattern, reason
        key = *pattern, _NUMBER.sub("#", record.getMessage())
        fresh = (known for known, line in self._lines.items() if now_s - line.begin_s < SPAN)
        is_flood = key not in self._lines and sum(it[:2] == pattern for it in fresh) >= BURST
        return pattern if is_flood else key

    def _forget(self, before_s: float) -> None:
        """Drop lines from before a time, and any too many; log how many were left out."""
        for key, line in list(self._lines.items()):
            if line.begin_s <= before_s or len(self._lines) >= KINDS:
                del self._lines[key]
                if line.last is not None:
                    self._inner.handle(_counted(line.last, line.left_out - 1))


def _counted(record: logging.LogRecord, left_out: int) -> logging.LogRecord:
    """Return a record whose text ends with the number of similar ones that were left out."""
    if not left_out:
        return record
    record = copy.copy(record)
    record.msg = f"{record.getMessage()} ({left_out} more like it before, left out)"
    record.args = None
    record.EKF_LEFT_OUT = left_out
    return record
