"""The recording: whole, bounded, on the disk within a second, and nobody waits for it."""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import namedtuple

import pytest
from typer.testing import CliRunner

from ekf_companion import recorder, shelf
from ekf_companion.cli import app
from ekf_companion.errors import ConfigError
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender
from ekf_companion.recorder import MB, open_recorder
from ekf_companion.sections import RecordConfig
from sim_autopilot.__main__ import app as sim
from tests.test_service import SYSTEM, Daemon, free_port

RECORD = 100
"""Bytes of one record, with its stamp."""


def settings(path, *, file=1.0, total=100.0, free=0.0):
    return RecordConfig(path=str(path), file_size=file, total_size=total, free_space=free)


def records(first, count):
    return [(1000 + k, k.to_bytes(RECORD - 8, "big")) for k in range(first, first + count)]


def as_bytes(stamped):
    return b"".join(stamp.to_bytes(8, "big") + data for stamp, data in stamped)


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def write(ours, stamped):
    """Hand records over at once, and wait until the thread has seen to them."""
    known = ours.recorded_bytes + ours.unrecorded_bytes
    ours._next = 0.0
    ours.write(stamped)
    size = len(as_bytes(stamped))
    wait_until(lambda: ours.recorded_bytes + ours.unrecorded_bytes == known + size)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# Names


def test_no_recording_is_written_over(tmp_path):
    found = []
    for k in range(3):
        ours = open_recorder(settings(tmp_path / "flight.tlog"))
        ours.write([(k, b"frame")])
        ours.close()
        found.append(ours.path.name)
        assert ours.path.read_bytes() == k.to_bytes(8, "big") + b"frame"
    assert found == ["flight.tlog", "flight-2.tlog", "flight-3.tlog"]
    # Numbers go up, so that their order is that of time
    (tmp_path / "flight.tlog").unlink()
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    ours.close()
    assert ours.path.name == "flight-4.tlog"


def test_the_name_of_a_recording_may_say_when_it_began(tmp_path):
    ours = open_recorder(settings(tmp_path / "flight-%s.tlog"))
    ours.close()
    stamp = time.strptime(ours.path.name, "flight-%Y%m%dT%H%M%SZ.tlog")
    assert stamp.tm_year >= 2024


def test_a_folder_is_no_name_for_a_recording(tmp_path):
    with pytest.raises(ConfigError, match=r"record\.path: .*none.*name a file in a folder"):
        open_recorder(settings(tmp_path / "none" / "flight.tlog"))
    assert open_recorder(RecordConfig()) is None


def test_the_file_is_for_us_and_our_group_and_for_no_child(tmp_path):
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    assert ours.path.stat().st_mode & 0o777 == 0o640
    assert not os.get_inheritable(ours._file)
    ours.close()


# Rule 39: it rotates, and guards the space


def test_a_full_file_is_followed_by_the_next_at_a_whole_record(tmp_path):
    """Rule 39."""
    ours = open_recorder(settings(tmp_path / "flight.tlog", file=0.01))
    sent = records(0, 1000)
    for k in range(0, 1000, 30):
        write(ours, sent[k : k + 30])
    ours.close()
    paths = sorted(tmp_path.iterdir(), key=lambda path: int(path.stem.partition("-")[2] or 1))
    assert [path.name for path in paths[:3]] == ["flight.tlog", "flight-2.tlog", "flight-3.tlog"]
    assert len(paths) == 11  # 30 records at a time, in files of at most 100
    assert all(path.stat().st_size <= 0.01 * MB for path in paths)
    assert all(path.stat().st_size % RECORD == 0 for path in paths)
    assert b"".join(path.read_bytes() for path in paths) == as_bytes(sent)


def test_beyond_the_total_the_oldest_of_ours_go_and_no_foreign_file(tmp_path):
    """Rule 39: ours are those that the configured name can make, but not those in use."""
    foreign = ["flight.tlog", "20260101T000000Z.bin", "x20260101T000000Z.tlog", "notes.txt"]
    old = ["20260101T000000Z.tlog", "20260101T000000Z-2.tlog", "20260102T000000Z.tlog"]
    for k, name in enumerate([*foreign, "20250101T000000Z.tlog", *old]):
        (tmp_path / name).write_bytes(bytes(30_000))
        os.utime(tmp_path / name, (1000.0 + k, 1000.0 + k))
    (tmp_path / "20240101T000000Z.tlog").symlink_to(tmp_path / "notes.txt")
    kept = ["20240101T000000Z.tlog", "20250101T000000Z.tlog", *foreign]
    with (tmp_path / "20250101T000000Z.tlog").open("rb") as theirs:
        fcntl.flock(theirs, fcntl.LOCK_EX)  # as another daemon does that writes it
        ours = open_recorder(settings(tmp_path / "%s.tlog", total=0.1))
        write(ours, records(0, 1))
        ours.close()
    # 121 kB were too much, the locked one included; the oldest that could go went
    assert names(tmp_path) == sorted([*kept, *old[1:], ours.path.name])


class Disk:
    """What statvfs says is free."""

    def __init__(self, monkeypatch, free):
        self.free = free
        answer = namedtuple("answer", "f_bavail f_frsize")
        monkeypatch.setattr(os, "statvfs", lambda _: answer(self.free // 512, 512))
        monkeypatch.setattr(recorder, "LOOK", 0.0)


def test_on_a_full_disk_the_oldest_go_then_it_stops_and_begins_again(tmp_path, monkeypatch, caplog):
    """Rule 39: the free-space guard."""
    caplog.set_level("INFO")
    disk = Disk(monkeypatch, 50 * MB)
    for k in range(3):
        (tmp_path / f"2026010{k + 1}T000000Z.tlog").write_bytes(bytes(MB))
        os.utime(tmp_path / f"2026010{k + 1}T000000Z.tlog", (k, k))
    ours = open_recorder(settings(tmp_path / "%s.tlog", free=40))
    write(ours, records(0, 10))
    assert len(names(tmp_path)) == 4
    # Short of 1.5 MB: two go
    disk.free = 40 * MB - 3 * MB // 2
    write(ours, records(10, 10))
    disk.free = 41 * MB
    assert names(tmp_path) == ["20260103T000000Z.tlog", ours.path.name]
    assert not [one for one in caplog.records if one.levelname == "WARNING"]
    # Short of more than there is: the last goes, and nothing is recorded; once is it said
    disk.free = 30 * MB
    for k in range(5):
        write(ours, records(20 + k, 1))
    assert names(tmp_path) == [ours.path.name]
    assert ours.unrecorded_bytes == 5 * RECORD
    # A little room is not enough: it would stop again at once
    disk.free = 41 * MB
    write(ours, records(25, 1))
    assert ours.unrecorded_bytes == 6 * RECORD
    disk.free = 80 * MB
    write(ours, records(26, 10))
    ours.close()
    assert ours.path.read_bytes() == as_bytes([*records(0, 20), *records(26, 10)])
    warnings = [one.getMessage() for one in caplog.records if one.levelname == "WARNING"]
    assert len(warnings) == 2
    assert "less than 40 MB free" in warnings[0]
    assert warnings[1].endswith("600 bytes are missing")
    assert "there is room again; recording goes on" in caplog.text


def test_a_recording_that_someone_deleted_is_followed_by_a_new_one(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "LOOK", 0.0)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 10))
    (tmp_path / "flight.tlog").unlink()
    write(ours, records(10, 10))
    ours.close()
    assert ours.path.name == "flight-2.tlog"
    assert ours.path.read_bytes() == as_bytes(records(10, 10))


def test_a_disk_that_fails_is_tried_again_in_a_new_file(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(recorder, "LOOK", 0.0)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 10))
    os.dup2(os.open("/dev/full", os.O_WRONLY), ours._file)  # as a stick that was pulled out
    monkeypatch.setattr(recorder, "_NO_ROOM", ())
    write(ours, records(10, 10))
    write(ours, records(20, 10))
    ours.close()
    assert ours.path.name == "flight-2.tlog"
    assert ours.path.read_bytes() == as_bytes(records(20, 10))
    assert ours.unrecorded_bytes == 10 * RECORD
    assert caplog.text.count("No space left on device; not all is recorded") == 1


# On the disk within a second, and nobody waits


def test_everything_is_forced_to_the_disk_within_a_second(tmp_path, monkeypatch):
    """What a power cut leaves: bytes that were synced, in a file whose name was."""
    synced, folders = [], []
    real, real_folder = os.fdatasync, shelf.Shelf.sync

    def fdatasync(descriptor):
        size = os.fstat(descriptor).st_size
        real(descriptor)
        synced.append((time.monotonic(), size))

    def sync(self):
        real_folder(self)
        folders.append(time.monotonic())

    monkeypatch.setattr(os, "fdatasync", fdatasync)
    monkeypatch.setattr(shelf.Shelf, "sync", sync)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    sent = []
    begin = time.monotonic()
    while time.monotonic() < begin + 1.7:
        ours.write(records(len(sent), 1))
        sent.append(time.monotonic())
        time.sleep(0.02)
    wait_until(lambda: synced[-1][1] >= ours.recorded_bytes)
    ours.close()
    assert synced[-1][1] == len(sent) * RECORD
    for k, when in enumerate(sent):
        done = next(then for then, size in synced if size >= (k + 1) * RECORD)
        assert done - when < 1.0
    assert len(synced) < 10  # and no more often than it must
    assert len(folders) == 1
    assert folders[0] < begin + 1.0


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
        assert daemon.stop(signal.SIGKILL)[0] == -signal.SIGKILL
    log = tlog.read(tmp_path / "flight.tlog")
    recorded = {frame for _, frame in log.frames()}
    # Rule 39: microseconds since 1970, big-endian, the low two bits the link's number, which is 0
    assert set(log.stamp_us & 3) == {0}
    assert abs(log.stamp_us - time.time() * 1e6).max() < 60e6
    must = [frame for when, frame in sent if when < killed - 1.0]
    assert len(must) > 50
    assert [frame for frame in must if frame not in recorded] == []
    # What the system has taken outlives the process
    for now, size in held:
        assert size >= sum(8 + len(frame) for when, frame in sent if when < now - 1.0)


def test_a_disk_that_hangs_holds_up_no_writer_and_what_is_lost_is_counted(
    tmp_path, monkeypatch, caplog
):
    hang = threading.Event()
    monkeypatch.setattr(os, "fdatasync", lambda _: hang.wait())
    monkeypatch.setattr(recorder, "WAITING", 50 * RECORD)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 1))
    slowest = 0.0
    for k in range(100):
        begin = time.monotonic()
        ours._next = 0.0
        ours.write(records(k, 1))
        slowest = max(slowest, time.monotonic() - begin)
        time.sleep(0.01)
    assert slowest < 0.1
    assert 30 * RECORD <= ours.unrecorded_bytes <= 50 * RECORD
    begin = time.monotonic()
    ours.close()
    assert time.monotonic() < begin + recorder.PATIENCE + 0.3
    assert caplog.text.count("the disk is too slow; not all is recorded") == 1
    assert caplog.text.count("the disk is too slow; the end is not recorded") == 1
    hang.set()
    ours._thread.join()


def test_sigterm_ends_it_within_two_seconds_while_the_disk_hangs(tmp_path):
    """Rule 36, where neither recording nor checkpoint can be finished."""
    port = free_port()
    code = (
        "import os, pathlib, time\n"
        "os.fdatasync = os.replace = os.rename = lambda *_: time.sleep(60)\n"
        "pathlib.Path.replace = lambda *_: time.sleep(60)\n"
        "from ekf_companion.companion import Companion\n"
        "Companion.checkpoint = lambda *_: b'state'\n"  # as if something had been estimated
        "from ekf_companion.cli import app\n"
        f"app(['run', '--link', 'udpin:127.0.0.1:{port}', '--record', '{tmp_path}/flight.tlog',"
        f" '--checkpoint', '{tmp_path}/checkpoint'])\n"
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
        end = time.monotonic() + 20.0
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
        assert process.wait(20.0) == 0
        assert time.monotonic() - begin < 2.0
        words = process.stderr.read()
    assert "the disk is too slow; the end is not recorded" in words
    assert "the disk is too slow; the last checkpoint may be missing" in words


# Each file of a flight can be converted, and together they are one recording


@pytest.fixture(scope="module")
def rotated(tmp_path_factory):
    """Give a flight as one file, and as our recorder keeps it in several."""
    folder = tmp_path_factory.mktemp("rotated")
    options = ("--scenario", "figure-eight", "--duration", "20", "--imu-rate", "100")
    flight = folder / "flight.tlog"
    assert CliRunner().invoke(sim, ["generate", *options, "-o", str(flight)]).exit_code == 0
    stamped = list(tlog.read(flight).frames())
    (folder / "parts").mkdir()
    size = flight.stat().st_size / MB / 1.9
    ours = open_recorder(settings(folder / "parts" / "part.tlog", file=size))
    for k in range(0, len(stamped), 50):
        write(ours, stamped[k : k + 50])
    ours.close()
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
        assert rows[-1].count(b",,") == 0


def test_joined_they_give_the_same_as_one(rotated, tmp_path):
    flight, parts = rotated
    joined = tmp_path / "joined.tlog"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    assert convert(joined, tmp_path / "joined.csv") == convert(flight, tmp_path / "one.csv")
