"""``ekf-companion status``: against the real daemon, against nobody, and against something else."""

import asyncio
import codecs
import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import socket
import struct
import subprocess
import sys
import termios
import threading
import time
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from rich.console import Console
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.cli.status_view import view
from ekf_companion.daemon import http
from ekf_companion.engine.health import Aid
from ekf_companion.status.judge import to_json
from tests.cli.served import serving_once
from tests.daemon.test_daemon import Daemon, free_port
from tests.daemon.test_http import listening, serving
from tests.daemon.waiting import LIMIT
from tests.status.test_observer import Watched


def status(*arguments):
    return CliRunner().invoke(app, ["status", *map(str, arguments)])


@pytest.fixture(scope="module")
def daemon(tmp_path_factory):
    """Return the address of a daemon that nobody flies."""
    port = free_port(socket.SOCK_STREAM)
    link = f"udpin:127.0.0.1:{free_port()}"
    folder = tmp_path_factory.mktemp("status")
    with Daemon(folder, "--link", link, config=f"http: {{port: {port}}}\n") as daemon:
        daemon.wait_for("Status on ")
        yield f"http://127.0.0.1:{port}"


def test_a_daemon_that_hears_nothing_is_shown_and_is_not_ok(daemon):
    """Whoever waits for exit code 0 before a take-off must not get it from a dead wire."""
    result = status("--url", daemon)
    assert result.exit_code == 1, result.output
    words = " ".join(result.output.split())
    assert words.startswith("waiting for an autopilot; not a byte has come over the link")
    for stage in ("link", "frames", "autopilot", "time", "estimate", "output", "process"):
        assert f"\n{stage} " in result.output.replace("\n ", "\n")
    assert "HIGHRES_IMU" in words


def test_json_is_what_the_daemon_gave(daemon):
    result = status("--url", daemon + "/", "--json")
    assert result.exit_code == 1
    data = json.loads(result.stdout)
    assert (data["health"]["is_healthy"], data["health"]["is_ok"]) == (True, False)
    assert data["link"]["is_open"]


def test_watching_ends_with_the_last_finding(daemon):
    command = [sys.executable, "-W", "error", "-m", "ekf_companion", "status"]
    command += ["--url", daemon, "--watch", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        first, second = (json.loads(process.stdout.readline()) for _ in range(2))
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 1
    assert second["unix_ns"] > first["unix_ns"]


def test_where_nothing_answers_the_exit_code_is_4_with_the_remedy():
    result = status("--url", f"http://127.0.0.1:{free_port(socket.SOCK_STREAM)}")
    assert result.exit_code == 4
    assert "/status: nothing answers (Connection refused); is the daemon running" in result.stderr


def test_an_address_without_a_scheme_is_one_of_http(daemon):
    result = status("--url", daemon.removeprefix("http://"), "--brief")
    assert result.exit_code == 1
    assert result.output.startswith("waiting for an autopilot")


@pytest.mark.parametrize("url", ["nonsense", "http://", "file:///etc/passwd", "http://127.0.0.1:x"])
def test_an_address_that_is_none_is_nobody(url):
    result = status("--url", url)
    assert result.exit_code == 4
    assert re.match(rf"ekf-companion: (--url: )?{re.escape(url.rstrip('/'))}", result.stderr)
    assert ("is no address; write it as in http:" in result.stderr) == (not url.startswith("http:"))


@pytest.mark.parametrize("code", [200, 404, 503])
@pytest.mark.parametrize("body", [b"hello", b"[]", b"{}", b'{"health": 1}', b"\xff"])
def test_something_else_that_answers_is_nobody(body, code):
    class Other(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(code)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Other) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        result = status("--url", f"http://127.0.0.1:{server.server_port}")
        thread.join()
    assert result.exit_code == 4
    assert "what answers is no ekf-companion; name its address with --url" in result.stderr


def test_a_daemon_that_is_stuck_is_exit_code_1(monkeypatch):
    monkeypatch.setattr(http, "HEAD_START", 0.0)
    results = []

    async def body():
        async with serving(Watched()) as url:
            await listening(url)
            thread = threading.Thread(target=lambda: results.append(status("--url", url)))
            thread.start()
            end = time.monotonic() + LIMIT
            while not results and time.monotonic() < end:
                time.sleep(0.05)  # noqa: ASYNC251  # the loop is held up, which is what it is about
            await asyncio.to_thread(thread.join)

    asyncio.run(body())
    assert results[0].exit_code == 1
    assert "ekf-companion: stalled: the loop has not answered for 1 s" in results[0].stderr


@pytest.mark.parametrize(("is_open", "code"), [(True, 0), (False, 1)])
def test_only_with_an_estimate_of_what_comes_is_the_exit_code_0(is_open, code):
    snapshot = Watched().fly(4.0).snapshot()
    page = to_json(replace(snapshot, link=replace(snapshot.link, is_open=is_open)))

    with serving_once(page) as url:
        result = status("--url", url)
    assert result.exit_code == code, result.output
    assert ("ok: the estimate is OK" in result.output) == is_open


def test_an_estimate_without_samples_for_a_second_is_none_of_now_and_has_its_age():
    watched = Watched().fly(4.0)
    watched.link._port = object()  # open
    assert watched.snapshot().sample_age_s == 0.0
    watched.now_ns += 1_100_000_000
    with serving_once(to_json(watched.snapshot())) as url:
        result = status("--url", url, "--brief")
    assert result.exit_code == 1
    first, second, *_ = result.output.splitlines()
    assert first == "no estimate, the last was OK; no inertial sample has come for 1.1 s"
    assert second == "take-off: not ready: no inertial sample has come for 1.1 s"
    assert "estimate, 1.1 s ago" in result.output


def test_what_is_watched_through_a_pipe_comes_out_of_it():
    """As through ``tee``, where there is no terminal to draw on."""
    command = [sys.executable, "-m", "ekf_companion", "status", "--watch", "--url"]
    with subprocess.Popen(
        [*command, "http://127.0.0.1:9"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        try:
            assert process.stderr.readline().startswith(b"ekf-companion: http://127.0.0.1:9/status")
            assert process.poll() is None
        finally:
            process.kill()


# The page


@pytest.fixture(scope="module")
def data():
    return json.loads(to_json(Watched().fly(8.0).snapshot()))


def page(data, width=200, **options):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    with contextlib.closing(console.file):
        console.print(view(data, "http://127.0.0.1:9331", **options))
    return console.export_text()


def test_the_page_shows_rates_against_what_was_asked_and_every_aid(data):
    text = page(data)
    row = next(line for line in text.splitlines() if line.startswith(" HIGHRES_IMU")).split()
    assert float(row[2]) == pytest.approx(250.0, rel=0.02)
    assert row[3] == "250"
    aids = [line.split()[0] for line in text.splitlines() if line.strip()][-len(Aid) :]
    assert aids == [aid.name.lower() for aid in Aid]
    assert "estimate" in text
    assert "OK, start cold" in text
    assert "ODOMETRY streams at 30.0 Hz" in text
    assert "auto, ODOMETRY streamed: " in text
    assert "(EKF2_EV_CTRL 0, EKF2_GPS_CTRL 7)" in text
    assert "HIGHRES_IMU, sensor 0, 250." in text
    assert "99.9 % within 0.3 ms" in text


@pytest.mark.parametrize(("count", "times"), [(1, "once"), (2, "2 times")])
def test_one_of_a_thing_is_one(data, count, times):
    peer, estimator = {**data["peer"], "reboots": count}, {**data["estimator"], "gaps": count}
    text = page({**data, "peer": peer, "estimator": estimator})
    assert f"rebooted {times}" in text
    assert f" samples, {count} gap{'s' * (count - 1)}" in text


@pytest.mark.parametrize("width", [60, 80])
def test_a_narrow_terminal_cuts_no_word_and_no_number(data, width):
    vehicle, sigma = data["vehicle"], {**data["vehicle"]["sigma"], "north_m": 12345.67}
    place = {
        "lon_deg": -122.4194155,
        "autopilot": {**vehicle["autopilot"], "lon_deg": -122.4194156},
    }
    told = {**data, "sample_age_s": 12.3, "vehicle": {**vehicle, **place, "sigma": sigma}}
    slow = {**data["messages"]["HIGHRES_IMU"], "cause": "the link is full: lower link.imu_rate"}
    told["messages"] = {**data["messages"], "GLOBAL_POSITION_INT": slow}
    text = page(told, width=width)
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    words = text.split()
    for whole in ("-122.4194155", "-122.4194156", "range_finder", "GLOBAL_POSITION_INT", "AMSL"):
        assert whole in words
    assert re.search(r"^speed north +.* m/s *$", text, re.MULTILINE)
    assert " 12345.67 m " in text


def test_the_page_names_the_vehicle_its_link_and_the_daemon_that_was_asked(data):
    lines = page(data, is_brief=True).splitlines()
    assert lines[2] == "system 1, px4 1.16.0, on udpin:127.0.0.1:14550; http://127.0.0.1:9331"
    none = page({**data, "peer": None}, is_brief=True)
    assert "no autopilot yet, on udpin:127.0.0.1:14550; http://127.0.0.1:9331" in none


def test_words_in_brackets_are_shown_as_they_are(data):
    odd = {**data, "output": {**data["output"], "reason": "[red]because[/red] [link]"}}
    assert "[red]because[/red] [link]" in page(odd)


def test_the_page_shows_what_differs_from_the_file_and_what_comes_in_vain(data):
    slow = {**data["messages"]["HIGHRES_IMU"], "cause": "the link is full"}
    told = {
        **data,
        "messages": {**data["messages"], "HIGHRES_IMU": slow},
        "tuned": {"gnss.delay": 0.1},
        "reload": {"count": 2, "words": "Nothing to take"},
    }
    text = " ".join(page(told).split())
    assert "gnss.delay 0.1 over MAVLink; reloaded 2 times, last: Nothing to take" in text
    assert "the link is full" in text


# The vehicle, on a small screen


def test_the_page_begins_with_the_verdicts_and_where_the_vehicle_is(data):
    lines = page(data).splitlines()
    assert lines[1].startswith("take-off: armed already: ")
    names = [line.split("  ")[0] for line in lines[3:20]]
    assert names[:4] == ["Vehicle", "latitude", "longitude", "height"]
    assert names[-6:] == ["position", "height", "velocity", "heading", "baro", "rest"]
    vehicle = data["vehicle"]
    (heading,) = [line.split() for line in lines if line.startswith("heading") and "deg" in line]
    own = vehicle["autopilot"]["heading_deg"]
    sigma = vehicle["sigma"]["heading_deg"]
    assert heading[1:4] == [f"{vehicle['heading_deg']:.1f}", f"{sigma:.1f}", "deg"]
    assert heading[4] == f"{own:.1f}"
    assert re.search(r"^heading +\d s  HIGHRES_IMU, magnetometer", page(data), re.MULTILINE)


def test_a_vehicle_that_moves_has_not_lost_its_rest(data):
    aids = data["vehicle"]["aids"]
    gone = {**aids["rest"], "state": "lost"}
    moving = {**data, "vehicle": {**data["vehicle"], "aids": {**aids, "rest": gone}}}
    (line,) = [line for line in page(moving).splitlines() if line.startswith("rest ")]
    assert line.split()[1] == "moving"


def test_in_brief_it_fits_80_by_24_also_with_a_long_verdict(data):
    reasons = "; ".join(f"a reason of usual length, the {number}th" for number in range(4))
    told = {**data, "preflight": {**data["preflight"], "sentence": f"not ready: {reasons}"}}
    lines = page(told, width=80, is_brief=True).splitlines()
    assert len(lines) <= 23  # and a line for the keys
    assert max(map(len, lines)) <= 80
    assert "…" not in "".join(lines)
    assert not any(line.startswith(" link") for line in lines)


def test_what_is_refused_is_shown_with_why(data):
    refused = {**data["vehicle"]["aids"]["baro"], "state": "refused", "why": "outside its gate"}
    vehicle = {**data["vehicle"], "aids": {**data["vehicle"]["aids"], "baro": refused}}
    text = " ".join(page({**data, "vehicle": vehicle}).split())
    assert "baro refused HIGHRES_IMU, barometer: outside its gate" in text


def test_what_may_be_wrong_is_shown_where_that_is_weighed(data):
    none = dict.fromkeys(("protection_horizontal", "protection_vertical"))
    quiet = {**data["estimator"], "suspected": [], "found": [], **none}
    assert "faults" not in page({**data, "estimator": quiet})
    said = {
        "suspected": ["height: GNSS height or barometer (0.93)"],
        "found": ["barometer 8.0 m off, 30 to 2 s ago"],
        "protection_horizontal": 4.26,
        "protection_vertical": 1.3,
    }
    text = " ".join(page({**data, "estimator": {**data["estimator"], **said}}).split())
    assert "faults suspected: height: GNSS height or barometer (0.93); found: barometer" in text
    assert "protection level 4.3 m horizontal, 1.3 m vertical" in text


def test_before_anything_is_known_it_is_shown_as_such():
    data = json.loads(to_json(Watched().snapshot()))
    text = page(data, is_brief=True)
    assert re.search(r"^latitude +- +- m +- +deg", text, re.MULTILINE)


def test_the_page_of_a_daemon_from_before_has_no_vehicle(data):
    old = {key: value for key, value in data.items() if key not in ("vehicle", "preflight")}
    assert "latitude" not in page(old)
    assert "HIGHRES_IMU" in page(old)


class Screen:
    """A terminal of 80 by 24 on which a command runs, and what it shows there."""

    def __init__(self, *command):
        self.shown = ""
        ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        self._terminal = ours
        self._text = codecs.getincrementaldecoder("utf-8")()
        with os.fdopen(theirs, "r+b", 0) as terminal:
            files = {"stdin": terminal, "stdout": terminal, "stderr": terminal}
            self.process = subprocess.Popen(
                command, **files, env=environment, start_new_session=True
            )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()
        os.close(self._terminal)

    def press(self, key):
        os.write(self._terminal, key)

    def wait_for(self, words):
        """Read until it shows them, and return the screen that does, line by line."""
        end = time.monotonic() + LIMIT
        while True:
            screens = self.shown.split("\x1b[H")
            for screen in screens:
                plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", screen)
                if words in plain:
                    self.shown = ""
                    return plain.replace("\r", "").split("\n")
            assert time.monotonic() < end, self.shown
            if select.select([self._terminal], [], [], 1.0)[0]:
                # A read may end within a character
                self.shown += self._text.decode(os.read(self._terminal, 1 << 16))


def test_what_is_watched_fits_the_terminal_scrolls_and_ends_with_a_key(daemon):
    command = [sys.executable, "-W", "error", "-m", "ekf_companion", "status", "--watch"]
    with Screen(*command, "--url", daemon) as screen:
        first = screen.wait_for("lines 1 to 23 of ")
        assert len(first) == 24
        assert first[0].startswith("waiting for an autopilot; not a byte")
        assert any(line.startswith("latitude") for line in first)
        assert max(map(len, first)) <= 80
        screen.press(b"\x1b[B")
        screen.wait_for("lines 2 to 24 of ")
        lines = re.search(r"of (\d+)", "\n".join(first))[1]
        screen.press(b"G")
        last = screen.wait_for(f" to {lines} of {lines}")
        assert any("TIMESYNC" in line or "HIGHRES_IMU" in line for line in last)
        screen.press(b"\x1b[H")
        screen.wait_for("lines 1 to 23 of ")
        screen.press(b"q")
        assert screen.process.wait(LIMIT) == 1


def test_ctrl_c_ends_what_is_watched_with_the_last_finding(daemon):
    command = [sys.executable, "-W", "error", "-m", "ekf_companion", "status", "--watch", "--brief"]
    with Screen(*command, "--url", daemon) as screen:
        screen.wait_for("q ends")
        screen.process.send_signal(signal.SIGINT)
        assert screen.process.wait(LIMIT) == 1


def test_a_token_in_the_address_is_sent_as_a_header():
    asked = []

    class Guarded(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.path, self.headers["Authorization"]))
            self.send_error(401)

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Guarded) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        status("--url", f"http://127.0.0.1:{server.server_port}/?token=tomato-soup")
        thread.join()
    assert asked == [("/status", "Bearer tomato-soup")]
