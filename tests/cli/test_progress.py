"""Progress on one line of the standard error: what is written, by a time that is said, and when."""

import os
import pty
import sys
import time

from ekf_companion.cli.progress import QUIET_S, Progress, progress_line
from tests.daemon.waiting import LIMIT


def test_nothing_is_written_while_nobody_wonders():
    progress = Progress("a.bin", is_terminal=False)
    assert [progress.due(seconds) for seconds in (0.0, 0.5, QUIET_S - 0.01)] == [""] * 3


def test_a_terminal_s_line_is_written_again_in_its_place():
    progress = Progress("a.bin", is_terminal=True)
    progress(30, 120)
    assert progress.due(2.0) == "\r\x1b[2Ka.bin: 25%, 2 s, 6 s left\r"
    progress(60, 120)
    assert progress.due(2.5) == "\r\x1b[2Ka.bin: 50%, 2 s, 2 s left\r"


def test_in_a_pipe_lines_become_ever_more_seldom():
    progress = Progress("a.bin", is_terminal=False)
    times = [seconds for seconds in range(100) if progress.due(float(seconds))]
    assert times == [2, 4, 8, 16, 32, 64]


def test_a_stage_of_unknown_length_is_told_in_seconds():
    progress = Progress("a.bin", is_terminal=False)
    progress(30, 30)
    progress.stage("a.bin: writing the report")
    assert progress.due(7.0) == "a.bin: writing the report: 7 s\n"


def test_listening_is_told_with_how_long_it_takes():
    progress = Progress("listening on udpin:0.0.0.0:14550", is_terminal=False, in_seconds=True)
    progress(2_000, 15_000)
    assert progress.due(2.0) == "listening on udpin:0.0.0.0:14550: 2 of 15 s\n"


def test_a_line_is_no_longer_than_the_terminal():
    progress = Progress("a" * 200, is_terminal=True, width=40)
    assert len(progress.due(2.0).replace("\x1b[2K", "").strip("\r")) == 39


def test_more_than_all_is_all():
    progress = Progress("a.bin", is_terminal=False)
    progress(130, 120)
    assert progress.text(3.0) == "a.bin: 100%, 3 s"


class Terminal:
    """A pseudo-terminal for the standard error."""

    def __enter__(self):
        self._ours, theirs = pty.openpty()
        os.set_blocking(self._ours, False)
        self.stream = os.fdopen(theirs, "w")
        self.text = ""
        return self

    def wait_for(self, words):
        end = time.monotonic() + LIMIT
        while words not in self.text:
            assert time.monotonic() < end, self.text
            try:
                self.text += os.read(self._ours, 4096).decode()
            except BlockingIOError:
                time.sleep(0.02)

    def __exit__(self, *_):
        self.stream.close()
        os.close(self._ours)


def test_a_terminal_s_line_vanishes_at_the_end(monkeypatch):
    with Terminal() as terminal:
        monkeypatch.setattr(sys, "stderr", terminal.stream)
        with progress_line("a.bin") as progress:
            progress(1, 4)
            terminal.wait_for("a.bin: 25%")
        terminal.stream.write("END")
        terminal.stream.flush()
        terminal.wait_for("END")
    assert terminal.text.endswith("\r\x1b[2KEND")


def test_a_stream_that_is_closed_stops_nothing(tmp_path, monkeypatch):
    with (tmp_path / "errors").open("w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        with progress_line("a.bin"):
            stream.close()


def test_the_time_that_is_left_is_told_in_its_own_unit():
    progress = Progress("9 logs", is_terminal=False)
    progress(1, 100)
    assert progress.text(10.0) == "9 logs: 1%, 10 s, 16 min left"
    assert progress.text(1000.0) == "9 logs: 1%, 1000 s, 27.5 h left"
    progress(100, 100)
    assert progress.text(1000.0) == "9 logs: 100%, 1000 s"
