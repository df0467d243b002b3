"""The recording: its names, its files, and the space that it leaves."""

import fcntl
import os
import time
from collections import namedtuple

import pytest

from ekf_companion.config.service import RecordConfig
from ekf_companion.daemon import tlog_folder, tlog_recorder
from ekf_companion.daemon.tlog_recorder import MB, open_recorder
from ekf_companion.errors import ConfigError
from tests.daemon.waiting import close, wait_until

RECORD = 100
"""Bytes of one record, with its stamp."""


def settings(path, *, file=1.0, total=100.0, free=0.0):
    return RecordConfig(path=str(path), file_size=file, total_size=total, free_space=free)


def records(first, count):
    return [(1000 + k, k.to_bytes(RECORD - 8, "big")) for k in range(first, first + count)]


def as_bytes(stamped):
    return b"".join(stamp.to_bytes(8, "big") + data for stamp, data in stamped)


@pytest.fixture
def _without_pauses(monkeypatch):
    """Write and sync as soon as something comes."""
    monkeypatch.setattr(tlog_recorder, "WRITE_PERIOD", 0.0)
    monkeypatch.setattr(tlog_recorder, "SYNC_PERIOD", 0.0)


pytestmark = pytest.mark.usefixtures("_without_pauses")


def write(ours, stamped):
    """Write records, and wait until the thread has taken them, and the disk all files but one."""
    known = ours.recorded_bytes + ours.unrecorded_bytes
    ours.write(stamped)
    size = len(as_bytes(stamped))
    wait_until(lambda: ours.recorded_bytes + ours.unrecorded_bytes == known + size)
    wait_until(lambda: len(ours._open) <= 1)


def names(folder):
    """Return the files that a user sees."""
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))


# Names


def test_no_recording_is_written_over(tmp_path):
    found = []
    for k in range(3):
        ours = open_recorder(settings(tmp_path / "flight.tlog"))
        ours.write([(k, b"frame")])
        close(ours)
        found.append(ours.path.name)
        assert ours.path.read_bytes() == k.to_bytes(8, "big") + b"frame"
    assert found == ["flight.tlog", "flight-2.tlog", "flight-3.tlog"]
    # Numbers go up, so that their order is that of time
    (tmp_path / "flight.tlog").unlink()
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    close(ours)
    assert ours.path.name == "flight-4.tlog"


def test_the_name_of_a_recording_may_say_when_it_began(tmp_path):
    ours = open_recorder(settings(tmp_path / "flight-%s.tlog"))
    close(ours)
    stamp = time.strptime(ours.path.name, "flight-%Y%m%dT%H%M%SZ.tlog")
    assert stamp.tm_year >= 2024


@pytest.mark.parametrize("name", ["/", "folder/", "..", "half \ud800", "no\0thing"])
def test_a_name_that_no_file_can_have_is_a_sentence(name):
    with pytest.raises(ConfigError, match=r"record\.path: .* is no name of a file; name one"):
        open_recorder(settings(name))
    assert open_recorder(RecordConfig()) is None


def test_a_run_without_a_byte_leaves_no_file(tmp_path):
    path = tmp_path / "flight.tlog"
    ours = open_recorder(settings(path))
    wait_until(path.exists)
    close(ours)
    assert not path.exists()


def test_a_name_that_is_no_text_is_a_name_all_the_same(tmp_path):
    for _ in range(2):
        ours = open_recorder(settings(tmp_path / "flight\udcff.tlog"))
        ours.write([(1, b"a byte")])
        close(ours)
    assert ours.path == tmp_path / "flight\udcff-2.tlog"
    assert len((tmp_path / ".flight\udcff.tlog.list").read_bytes().splitlines()) == 2


def test_a_recording_that_has_no_place_begins_when_it_has_one(tmp_path, monkeypatch, caplog):
    """A stick that is not there yet, or fell off before a restart in flight."""
    monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 0.0)
    ours = open_recorder(settings(tmp_path / "stick" / "flight.tlog"))
    for k in range(3):
        write(ours, records(k, 1))
    assert ours.unrecorded_bytes == 3 * RECORD
    assert ours.trouble == f"{tmp_path}/stick/flight.tlog: No such file or directory"
    assert caplog.text.count("No such file or directory; nothing is recorded, trying again") == 1
    (tmp_path / "stick").mkdir()
    for k in range(3, 6):
        write(ours, records(k, 1))
    monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 100.0)
    assert ours.trouble == ""
    close(ours)
    assert ours.path.read_bytes() == as_bytes(records(3, 3))


def test_the_file_is_for_us_and_our_group_and_for_no_child(tmp_path):
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 1))
    assert ours.path.stat().st_mode & 0o777 == 0o640
    assert not os.get_inheritable(ours._file.descriptor)
    close(ours)


# Rule 39: it rotates, and guards the space


def test_a_full_file_is_followed_by_the_next_at_a_whole_record(tmp_path):
    """Rule 39."""
    ours = open_recorder(settings(tmp_path / "flight.tlog", file=0.01))
    sent = records(0, 1000)
    for k in range(0, 1000, 30):
        write(ours, sent[k : k + 30])
    close(ours)
    paths = sorted(tmp_path.glob("*.tlog"), key=lambda path: int(path.stem.partition("-")[2] or 1))
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
        close(ours)
    # 121 kB were too much, the locked one included; the oldest that could go went
    assert names(tmp_path) == sorted([*kept, *old[1:], ours.path.name])


def record_run(path, count=1, total=0.1):
    """Return the name of the first file of a run that begins several."""
    ours = open_recorder(settings(path, file=0.01, total=total))
    wait_until(lambda: ours._file is not None)
    first = ours.path.name
    for _ in range(count):
        write(ours, records(0, 100))
    close(ours)
    return first


def test_on_a_board_without_a_clock_the_oldest_go_by_the_order_in_which_they_were_begun(
    tmp_path, monkeypatch
):
    """Rule 39: each start is in 1970 again, one second earlier than the last."""
    began = []
    for k in range(12):
        monkeypatch.setattr(
            time, "gmtime", lambda k=k: time.struct_time((1970, 1, 1, 0, 0, 50 - k, 3, 1, 0))
        )
        began.append(record_run(tmp_path / "%s.tlog", total=0.1))
        for path in tmp_path.glob("*.tlog"):
            seconds = int(path.name[13:15])
            os.utime(path, (seconds, seconds))
    left = [name for name in began if (tmp_path / name).exists()]
    assert left == began[-len(left) :]
    assert 8 <= len(left) < 12


def test_a_users_file_of_a_like_name_is_never_deleted(tmp_path):
    """Rule 39: without a time in the name, ours are those that we have begun."""
    for name in ("flight-2025.tlog", "flight.tlog", "flight-9.tlog"):
        (tmp_path / name).write_bytes(bytes(60_000))
        os.utime(tmp_path / name, (1.0, 1.0))
    for _ in range(3):
        record_run(tmp_path / "flight.tlog", count=20)
    assert {"flight-2025.tlog", "flight.tlog", "flight-9.tlog"} <= set(names(tmp_path))
    ours = [int(name[7:-5]) for name in names(tmp_path) if name != "flight.tlog"]
    ours = sorted(number for number in ours if number > 2025)
    assert ours[-1] == 2025 + 60
    assert ours == list(range(ours[0], 2025 + 61))
    assert len(ours) <= 11


def test_the_list_does_not_grow_for_ever_and_names_nothing_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setattr(tlog_folder, "LIST_SIZE", 200)
    (tmp_path / "other.txt").write_bytes(bytes(60_000))
    (tmp_path / ".flight.tlog.list").write_text("other.txt\n../flight.tlog\nflight-7.tlog\n")
    for _ in range(3):
        record_run(tmp_path / "flight.tlog", count=20)
    assert (tmp_path / ".flight.tlog.list").stat().st_size < 500
    assert (tmp_path / "other.txt").exists()
    assert 8 <= len(list(tmp_path.glob("*.tlog"))) <= 11


def fill(ours):
    """Have the disk refuse every write, as if it were full."""
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, ours._file.descriptor)
    os.close(full)


class Disk:
    """What statvfs says is free."""

    def __init__(self, monkeypatch, free):
        self.free = free
        answer = namedtuple("answer", "f_bavail f_frsize")
        monkeypatch.setattr(os, "statvfs", lambda _: answer(self.free // 512, 512))
        monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 0.0)


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
    # Short of more than ours could give: what fills it is somebody else's. None goes, and nothing
    # is recorded; once is it said
    disk.free = 30 * MB
    for k in range(5):
        write(ours, records(20 + k, 1))
    assert names(tmp_path) == ["20260103T000000Z.tlog", ours.path.name]
    assert "less than 40 MB free" in ours.trouble
    assert ours.unrecorded_bytes == 5 * RECORD
    # A little room is not enough: it would stop again at once
    disk.free = 41 * MB
    write(ours, records(25, 1))
    assert ours.unrecorded_bytes == 6 * RECORD
    disk.free = 80 * MB
    write(ours, records(26, 10))
    close(ours)
    assert ours.path.read_bytes() == as_bytes([*records(0, 20), *records(26, 10)])
    warnings = [one.getMessage() for one in caplog.records if one.levelname == "WARNING"]
    assert len(warnings) == 2
    assert "less than 40 MB free" in warnings[0]
    assert warnings[1].endswith("600 bytes are missing")
    assert "there is room again; recording goes on" in caplog.text


def test_a_file_that_another_daemon_writes_gives_no_room(tmp_path, monkeypatch):
    """Rule 39: nothing is deleted in vain."""
    disk = Disk(monkeypatch, 50 * MB)
    for k in range(2):
        (tmp_path / f"2026010{k + 1}T000000Z.tlog").write_bytes(bytes(MB))
    with (tmp_path / "20260102T000000Z.tlog").open("rb") as theirs:
        fcntl.flock(theirs, fcntl.LOCK_EX)
        ours = open_recorder(settings(tmp_path / "%s.tlog", free=40))
        write(ours, records(0, 1))
        disk.free = 40 * MB - 3 * MB // 2
        write(ours, records(1, 1))
        assert len(names(tmp_path)) == 3
        disk.free = 40 * MB + tlog_recorder.SLACK - MB // 2
        write(ours, records(2, 1))
        assert names(tmp_path) == ["20260102T000000Z.tlog", ours.path.name]
        close(ours)


def test_a_disk_that_stays_full_costs_no_more_of_ours_than_might_have_helped(tmp_path, monkeypatch):
    """Rule 39: a quota is full, and not of our files."""
    for k in range(9):
        (tmp_path / f"2026010{k + 1}T000000Z.tlog").write_bytes(bytes(MB))
    ours = open_recorder(settings(tmp_path / "%s.tlog"))
    write(ours, records(0, 1))
    fill(ours)
    for k in range(9):
        write(ours, records(1 + k, 1))
    close(ours)
    assert len(names(tmp_path)) == 9
    assert ours.unrecorded_bytes == 9 * RECORD


def test_a_recording_that_someone_deleted_is_followed_by_a_new_one(tmp_path, monkeypatch):
    monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 0.0)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 10))
    (tmp_path / "flight.tlog").unlink()
    write(ours, records(10, 10))
    close(ours)
    assert ours.path.name == "flight-2.tlog"
    assert ours.path.read_bytes() == as_bytes(records(10, 10))


def test_a_disk_that_fails_is_tried_again_in_a_new_file(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(tlog_recorder, "CHECK_PERIOD", 0.0)
    ours = open_recorder(settings(tmp_path / "flight.tlog"))
    write(ours, records(0, 10))
    fill(ours)  # as a stick that was pulled out
    monkeypatch.setattr(tlog_recorder, "_NO_ROOM", ())
    write(ours, records(10, 10))
    write(ours, records(20, 10))
    close(ours)
    assert ours.path.name == "flight-2.tlog"
    assert ours.path.read_bytes() == as_bytes(records(20, 10))
    assert ours.unrecorded_bytes == 10 * RECORD
    assert caplog.text.count("No space left on device; not all is recorded") == 1
