"""The daemon under a service manager: killed and started again, and its configuration reloaded."""

import http.server
import itertools
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.autopilot import Kind
from sim_autopilot.fly import fly, over, run
from tests.daemon.test_daemon import Daemon, Open, Record, Wire, free_port, plan
from tests.daemon.waiting import LIMIT

pytestmark = pytest.mark.campaign

RESTART_SEC = 1.0
"""As the unit says."""
BUSY = 20.0
"""Seconds in which a busy machine starts a process."""


class Pilot:
    """A flight in a thread of its own; keeps the wire, and when it heard what."""

    def __init__(self, port, boot=50.0, kind="udpin"):
        self.wire = None
        self._flight = Open(plan(240.0, boot=boot))

        async def body(link):
            self.wire = Wire(link)
            await fly(self._flight, self.wire, personality=Kind.PX4, wait=60.0)

        self._thread = threading.Thread(target=lambda: run(over(f"{kind}:127.0.0.1:{port}", body)))
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._flight.land()
        self._thread.join()


BOMB_PAIRS = list(itertools.pairwise("abcdefghijkl"))
BOMB = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in BOMB_PAIRS)
"""Aliases to aliases: 2 KB that stand for 4000 values, and twice as many for each line more."""


def odometry(wire):
    return [unpack(f) for f in wire.frames() if f.message_id == IDS["ODOMETRY"]]


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Fly; kill the daemon twice; start it again a second later, as Restart=always does."""
    folder = tmp_path_factory.mktemp("supervised")
    port = free_port()
    records, kills = [], []
    options = ("--link", f"udpout:127.0.0.1:{port}", "--checkpoint", str(folder / "checkpoint"))
    with Pilot(port) as pilot:
        for number in range(3):
            own = folder / str(number)
            own.mkdir()
            record = ("--record", str(own / "flight.tlog"))
            with Daemon(own, *options, *record, config="http: {port: 0}\n") as daemon:
                daemon.wait_for("Estimate is OK" if number == 0 else "Going on from a checkpoint")
                time.sleep(1.5)
                if number == 2:
                    assert daemon.stop() == 0
                else:
                    kills.append(time.time_ns() // 1000)
                    assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
                    time.sleep(RESTART_SEC)
            records.append(Record(own / "flight.tlog", daemon.config))
    return pilot.wire, records, kills


@pytest.mark.parametrize("number", [1, 2])
def test_odometry_is_there_again_as_soon_as_it_is_started_after_a_kill(killed, number):
    _, records, kills = killed
    first, odometry = records[number].of("ODOMETRY")[0]
    # At once: it is the answer to the first fix that comes after the start, five times a second
    sample = records[number].of("HIGHRES_IMU", component=1)[0][1]
    assert 0 <= odometry.time_usec - sample.time_usec < 500_000
    assert (first - kills[number - 1]) * 1e-6 < BUSY


def test_what_was_recorded_before_a_kill_can_be_read_up_to_its_last_second(killed):
    _, records, kills = killed
    for record, kill in zip(records, kills, strict=False):
        assert (kill - record.stamps[-1]) * 1e-6 < 3.0  # a second, and a wait for the processor
        assert len(record.of("HIGHRES_IMU", component=1)) > 250
    assert records[0].convert(".csv").stat().st_size > 10_000


def test_every_restart_moves_the_reset_counter(killed):
    _, records, _ = killed
    counts = [[m.reset_counter for _, m in record.of("ODOMETRY")] for record in records]
    assert counts[0][-1] < counts[1][0] <= counts[1][-1] < counts[2][0]


@pytest.fixture(scope="module")
def reloaded(tmp_path_factory):
    """Fly; change the configuration on the way: good, wrong, cut, a bomb, and good again."""
    folder = tmp_path_factory.mktemp("reloaded")
    port = free_port()
    options = ("--link", f"udpout:127.0.0.1:{port}", "--record", str(folder / "flight.tlog"))
    slow = "output: {odometry: {rate: 10, frame: LOCAL_FRD}}\ngate: {probability: 0.9999}\n"
    moments = []
    config = "output: {odometry: {rate: 50}}\n"
    with Pilot(port) as pilot, Daemon(folder, *options, config=config) as daemon:
        daemon.wait_for("Estimate is OK")
        for text, words in (
            (slow, "Reload: Taken: gate.probability: 0.999999 -> 0.9999, output.odometry.rate"),
            ("output: {odometry: {rate: fast}}\n", "all stays as it was"),
            ("gate: {probability: 0.9999}\n", "frame is no longer in it, and was 'LOCAL_FRD'"),
            (BOMB, "is an alias; write the value itself"),
            (slow.replace("10", "25"), "output.odometry.rate: 10.0 -> 25.0"),
        ):
            time.sleep(2.0)
            daemon.config.write_text(text)
            daemon.hang_up()
            daemon.wait_for(words)
            moments.append(time.time_ns() // 1000)
        time.sleep(2.0)
        assert daemon.stop() == 0
        words = daemon.words.read_text()
    return pilot.wire, Record(folder / "flight.tlog", daemon.config), words, moments


def command(*words):
    """Return exit code and words of a command."""
    done = subprocess.run(
        [sys.executable, "-m", "ekf_companion", *words], capture_output=True, text=True
    )
    return done.returncode, done.stdout + done.stderr


def test_the_command_prints_what_was_taken_and_says_where_nobody_is(tmp_path):
    link, port = free_port(), free_port(socket.SOCK_STREAM)
    url = ("--url", f"http://127.0.0.1:{port}")
    text = f"http: {{port: {port}}}\n"
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{link}", config=text) as daemon:
        daemon.wait_for("Status on")
        daemon.config.write_text(text + "baro: {std: 1.0}\n")
        assert command("reload", *url) == (0, "Taken: baro.std: 0.5 -> 1.0\n")
        daemon.config.write_text("baro: {std: -1.0}\n")
        code, words = command("reload", *url)
        assert (code, "baro.std: -1.0" in words, "all stays as it was" in words) == (2, True, True)
        assert daemon.stop() == 0
    code, words = command("reload", *url)
    assert (code, "nothing answers" in words) == (4, True)


class Elsewhere(http.server.BaseHTTPRequestHandler):
    """Answers as a daemon in a container does, whose process has there the number of one here."""

    pid = 0

    def do_GET(self):
        health, process = {"is_healthy": True, "words": "ok"}, {"pid": self.pid}
        data = {"health": health, "process": process, "reload": {"count": 0, "words": ""}}
        body = json.dumps(data).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


def test_no_process_but_the_daemon_itself_is_sent_a_signal():
    """The number that an answer names is that of another machine, or of a container."""
    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), Elsewhere) as server,
        subprocess.Popen(["sleep", "60"]) as innocent,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = ("--url", f"http://127.0.0.1:{server.server_port}")
        for pid in (innocent.pid, 1 << 30, -1, 0):
            Elsewhere.pid = pid
            code, words = command("reload", *url)
            assert (code, "is no process of this machine" in words) == (4, True), words
        assert innocent.poll() is None
        innocent.terminate()
        server.shutdown()


@pytest.mark.parametrize("text", ["baro: {std: !!float x}\n", "baro: {std: !!int ''}\n"])
def test_a_file_that_cannot_even_be_read_ends_the_reload_too(tmp_path, text):
    """systemd waits for READY=1 after RELOADING=1; an answer must come, whatever is in the file."""
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{free_port()}") as daemon:
        daemon.wait_for(": open")
        daemon.config.write_text(text)
        daemon.hang_up()
        daemon.wait_for("config.yaml: is not YAML: ")
        daemon.wait_for("all stays as it was")
        assert daemon.stop() == 0
        assert "Traceback" not in daemon.words.read_text()


def test_a_fifo_as_configuration_ends_no_later_reload(tmp_path):
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{free_port()}") as daemon:
        daemon.wait_for(": open")
        daemon.config.unlink()
        os.mkfifo(daemon.config)
        daemon.hang_up()
        daemon.wait_for("config.yaml: is not a regular file; name a YAML file")
        daemon.config.unlink()
        daemon.config.write_text("baro: {std: 2.0}\n")
        daemon.hang_up()
        daemon.wait_for("Taken: baro.std: 0.5 -> 2.0")
        assert daemon.stop() == 0


SLOW = """
import logging, sys
from dataclasses import replace
from ekf_companion.daemon import daemon
from ekf_companion.config.config import Config
from ekf_companion.config.service import HttpConfig, LinkConfig

config = Config(link=LinkConfig(url="udpin:127.0.0.1:{port}"), http=HttpConfig(port=0))
first, other = (replace(config, baro=replace(config.baro, std=std)) for std in (1.0, 2.0))
logging.basicConfig(level=logging.INFO)

def read_all():
    yield config
    open("{share}").close()  # a share that is gone answers when it is back
    yield first
    while True:
        yield other

reads = read_all()
daemon.run(lambda: next(reads))
"""


def test_a_file_that_does_not_end_is_not_waited_for(tmp_path):
    share = tmp_path / "share"
    os.mkfifo(share)
    command = [sys.executable, "-c", SLOW.format(port=free_port(), share=share)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as it, ending(it):
        assert it.stderr is not None

        def wait_for(words):
            assert any(words in line for line in it.stderr)

        wait_for(": open")
        it.send_signal(signal.SIGHUP)
        wait_for("the configuration could not be read within 3 s; all stays as it was")
        it.send_signal(signal.SIGHUP)
        wait_for("the configuration is still being read; wait for that; all stays as it was")
        os.close(os.open(share, os.O_WRONLY))  # too late
        # each signal has an answer; what was read too late has none
        it.send_signal(signal.SIGHUP)
        for line in it.stderr:
            if "Taken: baro.std: 0.5 -> 2.0" in line:
                break
            it.send_signal(signal.SIGHUP)
        it.send_signal(signal.SIGTERM)
        it.stderr.read()
        assert it.wait() == 0


@contextmanager
def ending(process):
    """End a process whatever becomes of the test: who leaves it alone waits for it for good."""
    try:
        yield
    finally:
        process.kill()


BUG = """
import logging
from ekf_companion.daemon import daemon
from ekf_companion.config.config import Config
from ekf_companion.config.service import HttpConfig, LinkConfig

config = Config(link=LinkConfig(url="udpin:127.0.0.1:{port}"), http=HttpConfig(port=0))
logging.basicConfig()
reads = iter([config])
daemon.run(lambda: next(reads))
"""


def test_a_bug_in_reading_ends_the_reload_too(tmp_path):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(LIMIT)
        command = [sys.executable, "-c", BUG.format(port=free_port())]
        environment = {**os.environ, "NOTIFY_SOCKET": address}
        with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as it:
            said = [manager.recv(1000).partition(b"\n")[0]]
            it.send_signal(signal.SIGHUP)
            while b"RELOADING=1" not in said or said[-1] != b"READY=1":
                said.append(manager.recv(1000).partition(b"\n")[0])
            it.terminate()
            assert it.wait(60.0) == 0
            words = it.stderr.read()
    assert said[0] == b"READY=1"
    assert "cannot be read, by a bug: StopIteration(); please report it; all stays" in words


def rate(record, begin, end):
    """Return the rate of ODOMETRY between two times (us) but for their edges, Hz of its stamps."""
    messages = [m for s, m in record.of("ODOMETRY") if begin + 300_000 < s < end - 300_000]
    return (len(messages) - 1) / (messages[-1].time_usec - messages[0].time_usec) * 1e6


def test_a_changed_rate_is_taken_and_a_wrong_file_changes_nothing(reloaded):
    """Rule 36: SIGHUP reloads the safe keys."""
    _, record, _, (first, second, third, _, last) = reloaded
    assert rate(record, first - 2_000_000, first) == pytest.approx(50.0, rel=0.15)
    assert rate(record, first, second) == pytest.approx(10.0, rel=0.15)
    assert rate(record, second, third) == pytest.approx(10.0, rel=0.15)
    assert rate(record, last, last + 2_000_000) == pytest.approx(25.0, rel=0.15)


def test_the_rest_is_refused_by_name(reloaded):
    _, record, words, _ = reloaded
    assert "only at the next start: output.odometry.frame" in words
    assert "output.odometry.rate: 'fast'" in words
    assert {m.frame_id for _, m in record.of("ODOMETRY")} == {1}


def test_no_sample_is_dropped_meanwhile(reloaded):
    wire, record, _, _ = reloaded
    stamps = [m.time_usec for _, m in record.of("HIGHRES_IMU", component=1)]
    assert len(stamps) > 2000
    assert max(b - a for a, b in itertools.pairwise(stamps)) <= 4000
    assert len(odometry(wire)) > 100
