"""One file on the disk: whole at any time, and no trouble of it is the daemon's."""

import os
import threading
import time
from pathlib import Path

import pytest

from ekf_companion.daemon import checkpoint_file
from ekf_companion.daemon.checkpoint_file import Keeper, clocks, open_keeper, open_memory
from ekf_companion.engine.checkpoint import MAGIC
from ekf_companion.errors import ConfigError

SECOND_NS = 1_000_000_000
OLD, NEW = MAGIC + b"old" * 1000, MAGIC + b"new" * 1500


def wait_for(condition):
    end = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)


def test_what_was_kept_last_is_read_again(tmp_path):
    keeper = Keeper(tmp_path / "checkpoint", 1.0)
    assert keeper.read() is None
    keeper.keep(OLD)
    keeper.keep(NEW)
    keeper.close()
    assert Keeper(tmp_path / "checkpoint", 1.0).read() == NEW
    assert {path.name for path in tmp_path.iterdir()} <= {"checkpoint", "checkpoint.new"}


def test_a_reader_finds_the_old_or_the_new_one_whole(tmp_path):
    path = tmp_path / "checkpoint"
    keeper = Keeper(path, 1.0)
    keeper.keep(OLD)
    wait_for(path.exists)
    seen, is_over = set(), threading.Event()

    def read():
        while not is_over.is_set():
            seen.add(path.read_bytes())

    reader = threading.Thread(target=read)
    reader.start()
    for k in range(600):
        keeper.keep((OLD, NEW)[k % 2])
        time.sleep(0.001)
    is_over.set()
    reader.join()
    keeper.close()
    assert seen == {OLD, NEW}


def test_handing_over_does_not_wait_for_the_disk(tmp_path):
    """A pipe without a reader stands for a disk that never answers."""
    os.mkfifo(tmp_path / "checkpoint.new")
    keeper = Keeper(tmp_path / "checkpoint", 1.0)
    begin = time.monotonic()
    for _ in range(1000):
        keeper.keep(NEW)
    assert time.monotonic() - begin < 0.2
    with (tmp_path / "checkpoint.new").open("rb") as pipe:
        assert pipe.read() == NEW
    keeper.close()


def test_parameters_set_again_and_again_make_few_files_and_the_last_is_kept(tmp_path):
    memory = open_memory(str(tmp_path / "state"))
    written, end_s = set(), time.monotonic() + 0.5
    number = 0
    while time.monotonic() < end_s:
        number += 1
        memory.keep(b"%d" % number)
        if memory.path.exists():
            written.add(memory.path.stat().st_ino)
        time.sleep(0.001)
    assert number > 50
    assert len(written) == 1  # the first at once, the next a second later
    memory.close()
    assert memory.path.read_bytes() == b"%d" % number


def test_a_disk_that_never_answers_does_not_hold_up_the_end(tmp_path, caplog):
    os.mkfifo(tmp_path / "checkpoint.new")
    keeper = Keeper(tmp_path / "checkpoint", 1.0)
    keeper.keep(NEW)
    begin = time.monotonic()
    keeper.close()
    assert time.monotonic() - begin < 2.0
    assert "the disk is too slow" in caplog.text
    assert (tmp_path / "checkpoint.new").read_bytes() == NEW


def test_trouble_is_said_once_and_its_end_is_noticed(tmp_path, caplog):
    folder = tmp_path / "disk"
    folder.mkdir()
    keeper = Keeper(folder / "checkpoint", 1.0)
    assert keeper.read() is None  # so it has begun
    for _ in range(2):
        (folder / "checkpoint.new").unlink(missing_ok=True)
        (folder / "checkpoint").unlink(missing_ok=True)
        folder.rmdir()
        caplog.clear()
        for _ in range(3):
            keeper.keep(bytes(bytearray(NEW)))
            time.sleep(0.05)
        assert caplog.text.count("No such file or directory; a restart would align anew") == 1
        folder.mkdir()
        keeper.keep(bytes(bytearray(NEW)))
        wait_for((folder / "checkpoint").exists)
    keeper.close()


def test_one_is_due_at_its_interval_and_at_every_reset(tmp_path):
    keeper = Keeper(tmp_path / "checkpoint", 2.0)
    keeper.close()
    due = [k for k in range(100) if keeper.is_due(k * SECOND_NS // 10, resets=k >= 33)]
    assert due == [0, 20, 33, 53, 73, 93]


def test_what_is_no_checkpoint_is_put_aside_and_not_written_over(tmp_path, caplog):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"a recording")
    keeper = Keeper(path, 1.0)
    assert keeper.read() == b"a recording"
    keeper.keep(NEW)
    keeper.close()
    assert (tmp_path / "flight.tlog.foreign").read_bytes() == b"a recording"
    assert path.read_bytes() == NEW
    assert "is no checkpoint; it is now flight.tlog.foreign" in caplog.text


def test_an_empty_file_is_what_a_loss_of_power_leaves(tmp_path):
    (tmp_path / "checkpoint").touch()
    keeper = Keeper(tmp_path / "checkpoint", 1.0)
    assert keeper.read() == b""
    keeper.close()
    assert not (tmp_path / "checkpoint.foreign").exists()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none/checkpoint", "No such file or directory; a restart would align anew"),
        ("folder", "is no plain file; a restart would align anew; name another"),
        ("pipe", "is no plain file; a restart would align anew; name another"),
        ("file/checkpoint", "Not a directory; a restart would align anew"),
    ],
)
def test_a_place_where_nothing_can_be_kept_is_said_and_stops_nobody(tmp_path, caplog, name, words):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    keeper = open_keeper(str(tmp_path / name), 1.0)
    assert keeper.read() is None
    keeper.keep(NEW)
    keeper.close()
    assert caplog.text.count(words) == 1
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize("name", ["/", "folder/", "folder/..", "half \ud800", "no\0thing"])
def test_a_name_that_no_file_can_have_is_a_sentence(name):
    with pytest.raises(ConfigError, match=r"^checkpoint\.file: .* is no name of a file; name one"):
        open_keeper(name, 1.0)


def test_a_disk_that_does_not_give_the_last_state_holds_up_the_start_for_a_moment_only(
    tmp_path, monkeypatch, caplog
):
    """A folder that hangs, as on a card that is busy or a share that is away."""
    (tmp_path / "checkpoint").write_bytes(OLD)
    hang, opened = threading.Event(), Path.open
    monkeypatch.setattr(Path, "open", lambda *a, **b: hang.wait() and opened(*a, **b))
    begin = time.monotonic()
    keepers = [Keeper(tmp_path / "checkpoint", 1.0) for _ in range(3)]
    assert [keeper.read() for keeper in keepers] == [None, None, None]
    assert time.monotonic() - begin < checkpoint_file.READING + 0.5
    assert caplog.text.count("checkpoint: the disk has not given it within 2 s; starting") == 3
    # What comes later is not gone on from, but written over
    hang.set()
    keepers[0].keep(NEW)
    keepers[0].close()
    assert keepers[0].read() is None
    assert (tmp_path / "checkpoint").read_bytes() == NEW


def test_no_name_is_no_keeper():
    assert open_keeper("", 1.0) is None


def test_the_clocks_are_those_of_this_boot():
    first = clocks()
    time.sleep(0.01)
    second = clocks()
    assert 5_000_000 < second.since(first) < SECOND_NS
    assert first.boot_id == second.boot_id
    if Path("/proc/sys/kernel/random/boot_id").exists():
        assert first.boot_id != bytes(16)
        up = float(Path("/proc/uptime").read_text().split()[0])
        assert second.boot_ns * 1e-9 == pytest.approx(up, abs=1.0)
