"""The journal's own protocol against a real socket, and what keeps a flood out of it."""

import logging
import os
import socket
import subprocess
import sys

import pytest

from ekf_companion.daemon.logging import (
    KINDS,
    JournalHandler,
    RateLimitHandler,
    flush,
    is_journal,
    priority,
)
from tests.daemon.test_daemon import free_port
from tests.daemon.waiting import LIMIT


class Journal:
    """Listens as systemd's does."""

    def __init__(self, path):
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(LIMIT)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    def entry(self):
        """Return the fields of the next entry."""
        data, descriptors, _, _ = socket.recv_fds(self._socket, 1 << 20, 1)
        for descriptor in descriptors:
            with os.fdopen(descriptor, "rb") as file:
                file.seek(0)
                data += file.read()
        return parse(data)


def parse(data):
    """Read an entry: ``NAME=value``, or NAME, the length in 8 bytes and what may hold newlines."""
    fields = {}
    while data:
        name, _, data = data.partition(b"\n")
        if b"=" in name:
            name, _, value = name.partition(b"=")
        else:
            size = int.from_bytes(data[:8], "little")
            value, data = data[8 : 8 + size], data[8 + size + 1 :]
        fields[name.decode()] = value.decode()
    return fields


@pytest.fixture
def journal(tmp_path):
    with Journal(tmp_path / "socket") as journal:
        yield journal


@pytest.fixture
def log(journal):
    handler = JournalHandler(journal.path)
    log = logging.Logger("ekf_companion.test")  # noqa: LOG001  # it leaves none behind
    log.addHandler(handler)
    yield log
    handler.close()


def test_an_entry_has_its_fields(log, journal):
    about = {"EKF_EVENT": "reset", "EKF_REASON": "inertial gap"}
    log.warning("Reset %d: %s", 3, "inertial gap", extra=about)
    entry = journal.entry()
    assert entry["MESSAGE"] == "Reset 3: inertial gap"
    assert entry["PRIORITY"] == "4"
    assert entry["SYSLOG_IDENTIFIER"] == "ekf-companion"
    assert entry["LOGGER"] == "ekf_companion.test"
    assert entry["CODE_FILE"] == __file__
    assert entry["CODE_FUNC"] == "test_an_entry_has_its_fields"
    assert int(entry["CODE_LINE"]) > 0
    assert (entry["EKF_EVENT"], entry["EKF_REASON"]) == ("reset", "inertial gap")


def test_a_traceback_keeps_its_lines(log, journal):
    try:
        1 // 0  # noqa: B018
    except ZeroDivisionError:
        log.exception("Ended by a bug")
    entry = journal.entry()
    assert entry["MESSAGE"].startswith("Ended by a bug\nTraceback (most recent call last):\n")
    assert entry["MESSAGE"].endswith("ZeroDivisionError: integer division or modulo by zero")
    assert entry["PRIORITY"] == "3"


@pytest.mark.parametrize(
    "text", ["über\U0001f6f8", "half \udc80 a name", "a=b\nMESSAGE=forged", ""]
)
def test_no_text_breaks_an_entry(log, journal, text):
    log.info("%s", text, extra={"EKF_REASON": text})
    entry = journal.entry()
    expected = text.replace("\udc80", "?")
    assert (entry["MESSAGE"], entry["EKF_REASON"]) == (expected, expected)


def test_an_entry_larger_than_a_datagram_arrives(log, journal):
    log.info("%s", "x" * 1_000_000)
    assert journal.entry()["MESSAGE"] == "x" * 1_000_000


def test_a_journal_that_does_not_read_holds_up_nobody(log, journal):
    for number in range(3000):
        log.info("%d", number)
    # All of them returned, while nobody has read one
    first = journal.entry()
    assert first["MESSAGE"] == "0"
    log.info("again")
    entry = first
    while entry["MESSAGE"] != "again":
        entry = journal.entry()
    assert int(entry["EKF_LOST"]) > 1000


def test_a_journal_that_was_started_anew_is_found_again(log, journal, capsys):
    log.info("one")
    assert journal.entry()["MESSAGE"] == "one"
    journal.path.unlink()
    log.info("two")
    assert capsys.readouterr().err == "INFO ekf_companion.test: two\n"
    with Journal(journal.path) as other:
        log.info("three")
        assert other.entry()["MESSAGE"] == "three"


def test_levels_have_the_priorities_of_syslog():
    levels = (logging.CRITICAL, logging.ERROR, logging.WARNING, logging.INFO, logging.DEBUG, 25)
    assert [priority(level) for level in levels] == [2, 3, 4, 6, 7, 6]


@pytest.mark.parametrize("stream", ["", "none", "1:2", "8:", ":"])
def test_stderr_that_leads_elsewhere_is_no_journal(monkeypatch, stream):
    monkeypatch.setenv("JOURNAL_STREAM", stream)
    assert not is_journal()


def test_the_daemon_logs_with_fields_where_stderr_is_the_journal(journal, tmp_path):
    code = (
        "from pathlib import Path\n"
        "from logging_journald import JournaldTransport\n"
        f"JournaldTransport.SOCKET_PATH = Path({str(journal.path)!r})\n"
        "from ekf_companion.cli import app\n"
        f"app(['run', '--link', 'udpin:127.0.0.1:{free_port()}'])\n"
    )
    stderr = tmp_path / "stderr"
    with stderr.open("wb") as file:
        there = os.fstat(file.fileno())
        environment = {**os.environ, "JOURNAL_STREAM": f"{there.st_dev}:{there.st_ino}"}
        command = [sys.executable, "-c", code]
        with subprocess.Popen(command, stderr=file, env=environment) as process:
            entry = journal.entry()
            process.terminate()
            assert process.wait(60.0) == 0
    assert entry["MESSAGE"].endswith(": open")
    assert entry["LOGGER"] == "ekf_companion.link"
    assert entry["PRIORITY"] == "6"
    assert stderr.read_text() == ""


# Never a flood


class Kept(logging.Handler):
    def __init__(self):
        super().__init__()
        self.words = []

    def emit(self, record):
        self.words.append(self.format(record))


class Calm:
    """A log behind the handler, on a clock that is said."""

    def __init__(self):
        self.now_s = 100.0
        self.kept = Kept()
        self.handler = RateLimitHandler(self.kept, lambda: self.now_s)
        self.log = logging.Logger("ekf_companion.test")  # noqa: LOG001  # it leaves none behind
        self.log.addHandler(self.handler)

    @property
    def words(self):
        return self.kept.words


@pytest.fixture
def calm():
    return Calm()


def test_a_warning_is_said_once_in_ten_seconds_with_the_number_left_out(calm):
    for _ in range(100):
        calm.log.warning("Autopilot rebooted")
        calm.now_s += 0.25
    left_out = "Autopilot rebooted (39 more like it before, left out)"
    assert calm.words == ["Autopilot rebooted", left_out, left_out]


def test_numbers_make_no_other_warning_but_another_reason_does(calm):
    for number in range(5):
        calm.log.warning("Reset %d: %s", number, "clock", extra={"EKF_REASON": "clock"})
    calm.log.warning("Reset %d: %s", 5, "height", extra={"EKF_REASON": "height"})
    assert calm.words == ["Reset 0: clock", "Reset 5: height"]


def test_different_sentences_of_one_pattern_are_all_said(calm):
    for name, why in (("a", "No space left"), ("a.parameters", "No space"), ("a.signing", "slow")):
        calm.log.warning("%s: %s", name, why)
        calm.log.warning("%s: %s", name, why)
    assert calm.words == ["a: No space left", "a.parameters: No space", "a.signing: slow"]


def test_a_pattern_floods_with_no_texts_either(calm):
    for k in range(100):
        calm.log.warning("%s is not heard", "a" * k)
    assert len(calm.words) == 6
    calm.handler.close()
    assert calm.words[-1].endswith("a is not heard (93 more like it before, left out)")


def test_what_was_left_out_is_told_when_its_time_is_over_though_nothing_comes(calm):
    for number in range(3):
        calm.log.warning("Reset %d", number)
    calm.now_s += 9.0
    calm.handler.flush()
    assert calm.words == ["Reset 0"]
    calm.now_s += 1.0
    calm.handler.flush()
    calm.handler.flush()
    assert calm.words == ["Reset 0", "Reset 2 (1 more like it before, left out)"]


def test_what_was_left_out_is_told_with_whatever_comes_next(calm):
    for number in range(3):
        calm.log.warning("Reset %d", number)
    calm.now_s += 11.0
    calm.log.info("Stopped")
    assert calm.words == ["Reset 0", "Reset 2 (1 more like it before, left out)", "Stopped"]


def test_what_was_left_out_is_told_at_the_end(calm):
    for number in range(4):
        calm.log.warning("Reset %d", number)
    calm.handler.close()
    assert calm.words == ["Reset 0", "Reset 3 (2 more like it before, left out)"]


def test_what_was_left_out_is_told_before_the_last_word(calm, monkeypatch):
    """Else the journal of a run that ended well ends with an old warning."""
    monkeypatch.setattr(logging.root, "handlers", [calm.handler])
    for number in range(4):
        calm.log.warning("Reset %d", number)
    flush()
    flush(is_end=True)
    calm.log.info("Stopped")
    assert calm.words[1:] == ["Reset 3 (2 more like it before, left out)", "Stopped"]


def test_news_pass_a_few_times_and_errors_always(calm):
    for _ in range(20):
        calm.log.info("Request for %s: accepted", "ATTITUDE")
        calm.log.error("Ended by a bug")
    for name in ("HIGHRES_IMU", "GPS_RAW_INT"):
        calm.log.info("Request for %s: accepted", name)
    assert len([words for words in calm.words if "ATTITUDE" in words]) == 5
    assert calm.words.count("Ended by a bug") == 20
    assert calm.words[-2:] == [
        "Request for HIGHRES_IMU: accepted",
        "Request for GPS_RAW_INT: accepted",
    ]


def test_the_memory_for_sentences_is_bounded(calm):
    for number in range(10 * KINDS):
        calm.log.info("%d", number)
    assert len(calm.words) == 10 * KINDS
    assert len(calm.handler._lines) == KINDS
