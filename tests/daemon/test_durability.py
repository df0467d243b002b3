"""What of a recording is on the disk when, and that nobody waits for it."""

import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.daemon import tlog_folder, tlog_recorder
from ekf_companion.daemon.daemon import CLOSING, DRAIN
from ekf_companion.daemon.tlog_recorder import MB, SYNC_PERIOD, WRITE_PERIOD, open_recorder
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav.state import WIND, WIND_SIGMA
from sim_autopilot.__main__ import app as sim
from tests.daemon.test_daemon import SYSTEM, Daemon, free_port
from tests.daemon.test_tlog_recorder import RECORD, records, settings, write
from tests.daemon.waiting import LIMIT, close, wait_until

pytestmark = pytest.mark.campaign


def test_everything_is_synced_without_being_asked_for(tmp_path, monkeypatch):
    """What a loss of power leaves: bytes that were synced, in a file whose name was."""
    # A record waits for the next write, and what was written for the next sync
    assert WRITE_PERIOD + SYNC_PERIOD < 1.0
    synced, folders = [0], []
    real, real_folder = os.fdatasync, tlog_folder.TlogFolder.sync

    def fdatasync(descriptor):
        size = os.fstat(descriptor).st_size
        real(descriptor)
        synced.append(size)

    def sync(self):
        real_folder(self)
        folders.append(len(synced))

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    monkeypatch.setattr(tlog_folder.TlogFolder, "sync", sync)
    begin = time.monotonic()
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    for k in range(3):
        ours.write(records(k, 1))
        # While it goes on, not at its end
        wait_until(lambda k=k: synced[-1] == (k + 1) * RECORD)
    seconds = time.monotonic() - begin
    close(ours)
    assert len(synced) - 1 <= 1 + seconds / SYNC_PERIOD  # and no more often than it must
    assert folders == [2]  # with the first of them


def test_what_was_sent_until_a_second_before_a_kill_is_in_the_file(tmp_path):
    """Frames come at 200 Hz; the process is killed amid them, and could be at any moment."""
    port = free_port()
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    sender, sent, held = Sender(SYSTEM, 1), [], []
    with (
        Daemon(tmp_path, *options) as daemon,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        daemon.wait_for(": open")
        peer.connect(("127.0.0.1", port))
        begin = time.monotonic()
        while time.monotonic() < begin + 2.7:
            frame = sender.message("SYSTEM_TIME", time_boot_ms=len(sent))
            sent.append((time.monotonic(), frame))
            peer.send(frame)
            time.sleep(0.005)
            held.append((time.monotonic(), (tmp_path / "flight.tlog").stat().st_size))
        killed = time.monotonic()
        assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
    # What delays us on a busy machine delays the daemon too
    times = [when for when, _ in sent]
    loss = 1.0 + 3.0 * max(later - sooner for sooner, later in itertools.pairwise(times))
    log = tlog.read(tmp_path / "flight.tlog")
    recorded = {frame for _, frame in log.frames()}
    # Rule 39: microseconds since 1970, big-endian, the low two bits the link's number, which is 0
    assert set(log.records.all()["stamp_us"] & 3) == {0}
    assert abs(log.records.all()["stamp_us"] - time.time() * 1e6).max() < 60e6
    must = [frame for when, frame in sent if when < killed - loss]
    assert len(must) > 50
    assert [frame for frame in must if frame not in recorded] == []
    # What the system has taken outlives the process
    for now, size in held:
        assert size >= sum(8 + len(frame) for when, frame in sent if when < now - loss)


SLOW = """
import os, sys, time

os.fdatasync = lambda file: time.sleep(600)
from ekf_companion.daemon.tlog_recorder import open_recorder
from ekf_companion.config.service import RecordConfig

ours = open_recorder(RecordConfig(path=sys.argv[1], free_space=0.0))
while True:
    ours.write([(time.time_ns() // 1000, bytes(8))])
    time.sleep(0.01)
"""


def test_a_disk_that_takes_seconds_to_force_costs_a_killed_recording_none_of_them(tmp_path):
    """Rule 39: what was written waits for nothing, and the system's cache outlives the process."""
    path = tmp_path / "flight.tlog"
    with subprocess.Popen([sys.executable, "-c", SLOW, str(path)]) as process:
        try:
            wait_until(lambda: path.exists() and path.stat().st_size)
            # Amid the first sync, which began with the first write
            written = path.stat().st_size
            wait_until(lambda: path.stat().st_size > written)
            before = path.stat().st_size
        finally:
            process.kill()
    data = path.read_bytes()
    assert len(data) >= before
    stamps = [int.from_bytes(data[k : k + 8], "big") for k in range(0, len(data) - 15, 16)]
    assert stamps == sorted(stamps)
    assert stamps[-1] > stamps[0]


@pytest.mark.parametrize("call", ["open", "write"])
def test_a_disk_that_hangs_holds_up_no_writer_and_what_is_lost_is_counted(
    tmp_path, monkeypatch, caplog, call
):
    hang, real = threading.Event(), getattr(os, call)

    def slow(*words):
        if threading.current_thread().name == "tlog":
            hang.wait()
        return real(*words)

    monkeypatch.setattr(os, call, slow)
    monkeypatch.setattr(tlog_recorder, "WAITING", 50 * RECORD)
    monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 1.0)
    # That each of these calls returns is what this is about: it hangs until all of them have
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    for k in range(100):
        ours.write(records(k, 1))
        time.sleep(0.001)
    assert ours.unrecorded_bytes == 50 * RECORD
    wait_until(lambda: ours.trouble.endswith("the disk does not answer"))
    close(ours, seconds=0.3)
    assert caplog.text.count("the disk is too slow; not all is recorded") == 1
    assert caplog.text.count("the disk is too slow; the end may be missing") == 1
    hang.set()
    close(ours)
    assert ours.recorded_bytes == 50 * RECORD


HUNG = """
import os, pathlib, time

os.fdatasync = os.replace = os.rename = lambda *_: time.sleep(600)
pathlib.Path.replace = lambda *_: time.sleep(600)
from ekf_companion.daemon import daemon
from ekf_companion.engine.companion import Companion

daemon.CLOSING = 5.0
Companion.checkpoint = lambda *_: b"state"  # as if something had been estimated
"""
ALL_HUNG = """
from ekf_companion.daemon.http import HttpServer
from ekf_companion.daemon.worker import Worker

HttpServer._run = Worker._run = lambda _: time.sleep(600)
"""


@pytest.mark.parametrize("hung", [HUNG, HUNG + ALL_HUNG], ids=["disk", "everything"])
def test_sigterm_ends_it_within_two_seconds_while_the_disk_hangs(tmp_path, hung):
    """Rule 36, where nothing can be finished: recording, checkpoint, parameters, times, status.

    All of them are waited for together, here for 5 s, so that a busy machine cannot blur it.
    """
    assert DRAIN + CLOSING <= 1.5  # what is left is for the interpreter's own end
    port = free_port()
    (tmp_path / "secret").write_bytes(bytes(32))
    (tmp_path / "secret").chmod(0o600)
    (tmp_path / "config.yaml").write_text(
        f"signing: {{key_file: {tmp_path}/secret, accept_unsigned: true}}\n"
        f"http: {{port: {free_port(socket.SOCK_STREAM)}}}\n"
    )
    code = hung + (
        "from ekf_companion.cli import app\n"
        f"app(['run', '--link', 'udpin:127.0.0.1:{port}', '--record', '{tmp_path}/flight.tlog',"
        f" '--checkpoint', '{tmp_path}/checkpoint', '--config', '{tmp_path}/config.yaml'])\n"
    )
    with (
        subprocess.Popen(
            [sys.executable, "-c", code], stderr=subprocess.PIPE, text=True
        ) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        peer.connect(("127.0.0.1", port))
        peer.settimeout(0.2)
        heard = b""
        end = time.monotonic() + LIMIT
        while not heard and time.monotonic() < end:
            try:
                peer.send(Sender(SYSTEM, 1).message("HEARTBEAT", type=2, autopilot=12))
                heard = peer.recv(1000)
            except OSError:
                time.sleep(0.05)
        assert heard
        time.sleep(1.0)  # until it hangs
        begin = time.monotonic()
        process.terminate()
        assert process.wait(LIMIT) == 0
        assert time.monotonic() - begin > 5.0
        words = process.stderr.read()
    assert "the disk is too slow; the end may be missing" in words
    assert "checkpoint: the disk is too slow; the last state may be missing" in words
    assert "checkpoint.signing: the disk is too slow; the last state may be missing" in words
    is_lost = "checkpoint.parameters: the disk is too slow; the last state may be missing" in words
    assert is_lost == ("Worker" in hung)


# Each file of a flight can be converted, and together they are one recording


@pytest.fixture(scope="module")
def rotated(tmp_path_factory):
    """Return a flight as one file, and as our recorder keeps it in several."""
    folder = tmp_path_factory.mktemp("rotated")
    options = ("--scenario", "figure-eight", "--duration", "20", "--imu-rate", "100")
    flight = folder / "flight.tlog"
    assert CliRunner().invoke(sim, ["generate", *options, "-o", str(flight)]).exit_code == 0
    stamped = list(tlog.read(flight).frames())
    (folder / "parts").mkdir()
    size = flight.stat().st_size / MB / 1.9
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tlog_recorder, "WRITE_PERIOD", 0.0)
        ours = open_recorder(settings(folder / "parts" / "part.tlog", file=size))
        for k in range(0, len(stamped), 50):
            write(ours, stamped[k : k + 50])
        close(ours)
    return flight, [folder / "parts" / name for name in ("part.tlog", "part-2.tlog")]


def convert(path, out):
    result = CliRunner().invoke(app, ["convert", str(path), "-o", str(out)])
    assert result.exit_code == 0, result.output
    return out.read_bytes()


def test_each_file_of_a_flight_is_a_recording_by_itself(rotated, tmp_path):
    _, parts = rotated
    for part in parts:
        rows = convert(part, tmp_path / f"{part.stem}.csv").splitlines()
        assert len(rows) > 700
        names, numbers = (row.decode().split(",") for row in (rows[0], rows[-1]))
        unknown = {name for name, number in zip(names, numbers, strict=True) if not number}
        assert unknown == {*WIND, *WIND_SIGMA, "reasons"}


def test_joined_they_give_the_same_as_one(rotated, tmp_path):
    flight, parts = rotated
    joined = tmp_path / "joined.tlog"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    assert convert(joined, tmp_path / "joined.csv") == convert(flight, tmp_path / "one.csv")
