"""One file on the disk: whole at any time, and no trouble of it is the daemon's."""

import os
import threading
import time
from pathlib import Path

import pytest

from ekf_companion.daemon import checkpoint_file
from ekf_companion.daemon.checkpoint_file import (
    CheckpointFile,
    open_checkpoint_file,
    open_parameter_file,
)
from ekf_companion.daemon.clock import read_clocks
from ekf_companion.engine.checkpoint import MAGIC
from ekf_companion.errors import ConfigError
from tests.daemon.waiting import close, wait_until

SECOND_NS = 1_000_000_000
OLD, NEW = MAGIC + b"old" * 1000, MAGIC + b"new" * 1500


def test_what_was_kept_last_is_read_again(tmp_path):
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    assert file.read() is None
    file.write(OLD)
    file.write(NEW)
    close(file)
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    assert file.read() == NEW
    close(file)
    assert {path.name for path in tmp_path.iterdir()} <= {"checkpoint", "checkpoint.new"}


def test_a_reader_finds_the_old_or_the_new_one_whole(tmp_path):
    path = tmp_path / "checkpoint"
    file = CheckpointFile(path, 1.0)
    file.write(OLD)
    wait_until(path.exists)
    seen, is_over = set(), threading.Event()

    def read():
        while not is_over.is_set():
            seen.add(path.read_bytes())

    reader = threading.Thread(target=read)
    reader.start()
    for k in range(600):
        file.write((OLD, NEW)[k % 2])
        time.sleep(0.001)
    is_over.set()
    reader.join()
    close(file)
    assert seen == {OLD, NEW}


def test_handing_over_does_not_wait_for_the_disk(tmp_path):
    """A pipe without a reader stands for a disk that never answers."""
    os.mkfifo(tmp_path / "checkpoint.new")
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    for _ in range(1000):
        file.write(NEW)
    # All of them returned, while the thread waits for who reads
    assert not (tmp_path / "checkpoint").exists()
    with (tmp_path / "checkpoint.new").open("rb") as pipe:
        assert pipe.read() == NEW
    close(file)


def test_parameters_set_again_and_again_make_few_files_and_the_last_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoint_file, "PARAMETER_PERIOD", 1000.0)
    file = open_parameter_file(str(tmp_path / "state"))
    file.write(b"0")
    wait_until(file.path.exists)
    first = file.path.stat().st_ino
    for number in range(1, 200):
        file.write(b"%d" % number)
        time.sleep(0.001)
    assert file.path.stat().st_ino == first  # the first at once, the next when the period is over
    assert file.path.read_bytes() == b"0"
    close(file)
    assert file.path.read_bytes() == b"199"


def test_a_disk_that_never_answers_does_not_hold_up_the_end(tmp_path, caplog):
    os.mkfifo(tmp_path / "checkpoint.new")
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    file.write(NEW)
    close(file, seconds=0.3)
    assert "the disk is too slow; the last state may be missing" in caplog.text
    assert (tmp_path / "checkpoint.new").read_bytes() == NEW
    close(file)


def test_trouble_is_said_once_and_its_end_is_noticed(tmp_path, caplog):
    folder = tmp_path / "disk"
    folder.mkdir()
    file = CheckpointFile(folder / "checkpoint", 1.0)
    assert file.read() is None  # so it has begun
    for _ in range(2):
        (folder / "checkpoint.new").unlink(missing_ok=True)
        (folder / "checkpoint").unlink(missing_ok=True)
        folder.rmdir()
        caplog.clear()
        for _ in range(3):
            state = bytes(bytearray(NEW))
            file.write(state)
            wait_until(lambda state=state: file._written is state and not file._worker.busy_s)
        assert caplog.text.count("No such file or directory; a restart would align anew") == 1
        folder.mkdir()
        file.write(bytes(bytearray(NEW)))
        wait_until((folder / "checkpoint").exists)
    close(file)


def test_a_full_disk_leaves_the_older_state_whole_and_no_half_of_a_new_one(tmp_path, caplog):
    (tmp_path / "checkpoint").write_bytes(OLD)
    (tmp_path / "checkpoint.new").symlink_to("/dev/full")
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    assert file.read() == OLD
    file.write(NEW)
    wait_until(lambda: file._written is NEW and not file._worker.busy_s)
    assert "No space left on device; a restart would align anew" in caplog.text
    assert [one.name for one in tmp_path.iterdir()] == ["checkpoint"]
    assert (tmp_path / "checkpoint").read_bytes() == OLD
    close(file)


def test_one_is_due_at_its_interval_and_at_every_reset(tmp_path):
    file = CheckpointFile(tmp_path / "checkpoint", 2.0)
    close(file)
    due = [k for k in range(100) if file.is_due(k * SECOND_NS // 10, resets=k >= 33)]
    assert due == [0, 20, 33, 53, 73, 93]


def test_what_is_no_checkpoint_is_put_aside_and_not_written_over(tmp_path, caplog):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"a recording")
    file = CheckpointFile(path, 1.0)
    assert file.read() == b"a recording"
    file.write(NEW)
    close(file)
    assert (tmp_path / "flight.tlog.foreign").read_bytes() == b"a recording"
    assert path.read_bytes() == NEW
    assert "is not a checkpoint; renamed to flight.tlog.foreign" in caplog.text


def test_an_empty_file_is_what_a_loss_of_power_leaves(tmp_path):
    (tmp_path / "checkpoint").touch()
    file = CheckpointFile(tmp_path / "checkpoint", 1.0)
    assert file.read() == b""
    close(file)
    assert not (tmp_path / "checkpoint.foreign").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none/checkpoint", "No such file or directory; a restart would align anew"),
        ("folder", "is not a regular file; a restart would align anew; name another"),
        ("pipe", "is not a regular file; a restart would align anew; name another"),
        ("file/checkpoint", "Not a directory; a restart would align anew"),
    ],
)
def test_a_place_where_nothing_can_be_kept_is_said_and_stops_nobody(tmp_path, caplog, name, words):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    file = open_checkpoint_file(str(tmp_path / name), 1.0)
    assert file.read() is None
    file.write(NEW)
    close(file)
    assert caplog.text.count(words) == 1
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("name", ["/", "folder/", "folder/..", "half \ud800", "no\0thing"])
def test_a_name_that_no_file_can_have_is_a_sentence(name):
    with pytest.raises(ConfigError, match=r"^checkpoint\.file: .* is no name of a file; name one"):
        open_checkpoint_file(name, 1.0)


def test_a_disk_that_does_not_give_the_last_state_holds_up_the_start_for_a_moment_only(
    tmp_path, monkeypatch, caplog
):
    """A folder that hangs, as on a card that is busy or a share that is away."""
    paths = [tmp_path / name / "checkpoint" for name in "abc"]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(OLD)
    hang, opened = threading.Event(), Path.open
    monkeypatch.setattr(Path, "open", lambda *a, **b: hang.wait() and opened(*a, **b))
    begin = time.monotonic()
    files = [CheckpointFile(path, 1.0) for path in paths]
    assert [file.read() for file in files] == [None, None, None]
    assert time.monotonic() - begin < 2 * checkpoint_file.READING  # and not three times
    assert caplog.text.count("checkpoint: the disk did not return it within 2 s; starting") == 3
    # What comes later is not gone on from, but written over
    hang.set()
    files[0].write(NEW)
    close(*files)
    assert files[0].read() is None
    assert paths[0].read_bytes() == NEW


def test_no_name_is_no_file():
    assert open_checkpoint_file("", 1.0) is None


def test_the_clocks_are_those_of_this_boot():
    first = read_clocks()
    time.sleep(0.01)
    second = read_clocks()
    assert 5_000_000 < second.since(first) < SECOND_NS
    assert first.boot_id == second.boot_id
    if Path("/proc/sys/kernel/random/boot_id").exists():
        assert first.boot_id != bytes(16)
        up = float(Path("/proc/uptime").read_text().split()[0])
        assert second.boot_ns * 1e-9 == pytest.approx(up, abs=1.0)
