"""Many logs at once: one row each, whatever becomes of the others."""

import csv
import gzip
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import Config
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.fleet import run as batch_run
from ekf_companion.fleet.executor import Processes
from ekf_companion.fleet.folder import find_logs, left_out
from ekf_companion.fleet.row import COLUMNS, examine, failed
from ekf_companion.fleet.source import of_path
from ekf_companion.fleet.table import lines
from ekf_companion.logs.estimate import COLUMNS as ESTIMATE_COLUMNS
from ekf_companion.mavlink.codec import Sender, pack
from ekf_companion.replay.log_source import open_log
from ekf_companion.review.convert import convert
from sim_autopilot.__main__ import app as sim
from tests.daemon.waiting import LIMIT
from tests.fleet import batch_tasks


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of whole, damaged and foreign logs, and of tables that are none."""
    root = tmp_path_factory.mktemp("logs")
    words = ("generate", "--scenario", "figure-eight", "--duration", "12", "--imu-rate", "50")
    result = CliRunner().invoke(
        sim, [*words, "-o", str(root / "a0.tlog"), "--truth", str(root / "truth.csv")]
    )
    assert result.exit_code == 0, result.output
    whole = (root / "a0.tlog").read_bytes()
    for index in range(1, 5):
        shutil.copy(root / "a0.tlog", root / f"a{index}.tlog")
    (root / "below").mkdir()
    (root / "below" / "cut.tlog").write_bytes(whole[: len(whole) // 2 + 5])
    (root / "below" / "hole.tlog").write_bytes(whole[:9000] + bytes(5000) + whole[14000:])
    (root / "noise.bin").write_bytes(b"\xfd\xa3\x95" * 9000)
    (root / "empty.ulg").write_bytes(b"")
    rows = [f"{20000 * index},0,0,0,0,{0.001 * (index % 3)},-9.8" for index in range(500)]
    head = ",".join(["time_us", *(f"gyro_{axis}_rps" for axis in "xyz")])
    head += "," + ",".join(f"accel_{axis}_mps2" for axis in "xyz")
    (root / "own.csv").write_text("\n".join([head, *rows, ""]))
    (root / "notes.txt").write_text("no log")
    return root


@pytest.fixture(scope="module")
def expected(folder):
    """Return the rows of the logs one by one, in this process."""
    return [examine(log, Config()) for log in find_logs([str(folder)])]


def rows_of(path: Path):
    with path.open() as file:
        return list(csv.DictReader(file))


def run(logs, *arguments):
    return batch_run.run([of_path(log) for log in logs], *arguments)


def as_text(rows):
    return [{k: "" if v is None else str(v) for k, v in row.items()} for row in rows]


def test_a_folder_gives_its_logs_and_no_other_table(folder):
    names = [str(log.relative_to(folder)) for log in find_logs([str(folder)])]
    below = ["below/cut.tlog", "below/hole.tlog"]
    whole = [f"a{index}.tlog" for index in range(5)]
    assert names == [*whole, *below, "empty.ulg", "noise.bin", "own.csv"]


def test_files_folders_and_patterns_give_each_log_once(folder):
    names = [str(folder / "a1.tlog"), f"{folder}/a[01].tlog", str(folder / "below")]
    found = [log.name for log in find_logs(names)]
    assert found == ["a1.tlog", "a0.tlog", "cut.tlog", "hole.tlog"]
    assert len(find_logs([f"{folder}/**/*.tlog"])) == 7


@pytest.mark.parametrize("name", ["none.tlog", "none/*.tlog"])
def test_a_name_that_matches_nothing_is_said(tmp_path, name):
    with pytest.raises(ConfigError, match="no such file or folder"):
        find_logs([str(tmp_path / name)])
    with pytest.raises(ConfigError, match="no log in there"):
        find_logs([str(tmp_path)])


def test_rows_say_what_was_found_and_why_a_log_failed(folder, expected):
    rows = {Path(str(row["log"])).name: row for row in expected}
    assert all(row.keys() == COLUMNS.keys() for row in expected)
    whole = rows["a0.tlog"]
    assert (whole["outcome"], whole["autopilot"], whole["resets"]) == ("estimated", "px4", 0)
    assert whole["imu_hz"] == pytest.approx(50.0)
    assert whole["verdict"].startswith(whole["grade"] + ":")
    assert rows["noise.bin"]["verdict"] is None
    assert whole["duration_s"] == pytest.approx(12.0, abs=0.2)
    assert rows["noise.bin"]["outcome"] == rows["empty.ulg"]["outcome"] == "failed"
    assert rows["noise.bin"]["why"].startswith("holds no FMT record")
    assert rows["cut.tlog"]["duration_s"] < 8.0
    assert "cut off there" in rows["cut.tlog"]["notes"]


def test_the_lines_on_the_screen_name_each_verdict(expected):
    rows = {Path(str(row["log"])).name: row for row in expected}
    whole, noise = rows["a0.tlog"], rows["noise.bin"]
    first, second, total = lines([whole, noise])
    assert first.endswith(f"a0.tlog    12 s, {whole['verdict']}")
    assert second.endswith(f"failed: {noise['why']}")
    assert total == "2 logs: 1 estimated, 1 failed"
    long = {**whole, "verdict": f"{whole['verdict']}, {'x' * 99}"}
    width = len(first) + 40
    cut, uncut, _ = lines([long, noise], width)
    assert cut == f"{first}, {'x' * 35}..."
    assert uncut == second
    assert f"12 s, {whole['grade']}: " in lines([long], 10)[0]


@pytest.mark.campaign
def test_two_processes_give_the_rows_of_one(folder, expected, tmp_path):
    out, parquet = tmp_path / "table.csv", tmp_path / "table.parquet"
    result = CliRunner().invoke(
        app, ["batch", str(folder), "-o", str(out), "-o", str(parquet), "--jobs", "2"]
    )
    assert result.exit_code == 0, result.output
    assert rows_of(out) == as_text(expected)
    assert "10 logs: 8 estimated, 2 failed" in result.output
    assert "2 files left out: " in result.output
    assert [path.name for path in sorted(tmp_path.iterdir())] == [out.name, parquet.name]
    from pyarrow import parquet as reader

    assert reader.read_table(parquet).to_pylist() == expected


@pytest.mark.campaign
def test_killed_in_the_middle_it_goes_on_where_it_ended(folder, expected, tmp_path):
    out, journal = tmp_path / "table.csv", tmp_path / "table.csv.journal"
    command = [sys.executable, "-m", "ekf_companion", "batch", str(folder), "-o", str(out)]
    with subprocess.Popen([*command, "--jobs", "2"]) as process:
        deadline = time.monotonic() + LIMIT
        while not (journal.exists() and journal.read_text().count("\n") >= 3):
            assert process.poll() is None, "it ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
    before = journal.read_text().splitlines()
    assert not out.exists()
    with journal.open("a") as file:
        file.write('["half a li')
    done = subprocess.run([*command, "--jobs", "1"], capture_output=True, timeout=LIMIT, check=True)
    assert rows_of(out) == as_text(expected)
    assert not journal.exists()
    assert len(before) >= 3
    assert b"10 logs: 8 estimated" in done.stdout


class Counted:
    """An executor that examines nothing, and counts what it is asked for."""

    def __init__(self):
        self.asked = []

    def run(self, task, logs):
        for log in logs:
            self.asked.append(Path(log.place).name)
            yield log, failed(log.name, "examined by nobody")


def test_what_stands_in_the_journal_is_not_examined_again_unless_it_changed(folder, tmp_path):
    logs = [tmp_path / name for name in ("a.tlog", "b.tlog")]
    for log in logs:
        shutil.copy(folder / "a0.tlog", log)
    journal, config = tmp_path / "journal", Config()
    first, second, third = Counted(), Counted(), Counted()
    rows = run(logs, config, journal, first)
    assert [row["log"] for row in rows] == [str(log) for log in logs]
    assert sorted(first.asked) == ["a.tlog", "b.tlog"]
    logs[1].write_bytes(logs[1].read_bytes()[:-100])
    run(logs, config, journal, second)
    assert second.asked == ["b.tlog"]
    other = Config(window=0.5)
    run(logs, other, journal, third)
    assert sorted(third.asked) == ["a.tlog", "b.tlog"]


def test_progress_counts_the_bytes_of_the_logs(folder, tmp_path):
    logs = find_logs([str(folder)])
    said = []
    run(logs, Config(), tmp_path / "journal", Counted(), lambda *two: said.append(two))
    assert said[-1][0] == said[-1][1] == sum(log.stat().st_size + 1 for log in logs)
    assert [done for done, _ in said] == sorted(done for done, _ in said)


@pytest.mark.parametrize(
    ("task", "jobs", "words"),
    [
        (batch_tasks.kill_at_b, 2, "the process that read it was killed"),
        (batch_tasks.cut_at_b, 2, "the process that read it was killed"),
        (batch_tasks.cut_at_b, 1, "the process that read it was killed"),
        (batch_tasks.stumble_at_b, 1, "a bug: ZeroDivisionError: by nothing"),
    ],
)
def test_a_log_that_kills_its_process_stops_no_other(task, jobs, words):
    found = {log.name: one for log, one in Processes(jobs).run(task, map(Path, "abc"))}
    assert {"a", "b", "c"} == found.keys()
    assert found["a"] == found["c"] == {"why": "examined"}
    assert found["b"].why.startswith(words)


def test_a_log_that_vanishes_has_a_row_too(folder, tmp_path):
    gone = tmp_path / "gone.tlog"
    rows = run([gone], Config(), tmp_path / "journal", Processes(1))
    assert rows[0]["why"].startswith("no such file")


def test_a_table_of_no_known_kind_is_refused_before_any_work(folder, tmp_path):
    result = CliRunner().invoke(app, ["batch", str(folder), "-o", str(tmp_path / "table.xyz")])
    assert result.exit_code == 2
    assert "known are .csv, .parquet" in result.output
    assert list(tmp_path.iterdir()) == []
    assert batch_run._read_journal(tmp_path / "none", Config()) == {}


def test_files_that_are_no_logs_are_counted_and_named(folder):
    mine = folder / "below" / "cut.tlog"
    logs = find_logs([str(folder)])
    words = left_out([str(folder)], [*logs, folder / "truth.csv"])
    kinds = "none of .tlog, .bin, .ulg, .csv"
    assert words == f"1 file left out: {folder}/notes.txt ({kinds})"
    both = left_out([str(folder), str(mine)], logs)
    assert both.startswith(f"2 files left out: {folder}/truth.csv (a table without inertial")
    assert both.endswith(f"; {folder}/notes.txt ({kinds})")
    assert left_out([str(mine)], []) == ""


def test_why_a_table_is_left_out_is_said_and_no_file_counts_twice(tmp_path):
    """A .csv was left out, and the line said that .csv are taken."""
    (tmp_path / "below").mkdir()
    (tmp_path / "estimate.csv").write_text(f"{','.join(ESTIMATE_COLUMNS)}\n")
    (tmp_path / "below" / "wind.csv").write_text("time_s,wind_mps\n0,1\n")
    for name in ("estimate.csv", "below/wind.csv"):
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    (tmp_path / "mine.csv").write_text("time_s,gyro_x_rps\n0,1\n")
    (tmp_path / "odd.csv").write_text("t,p\n0,1\n")
    (tmp_path / "odd.csv.columns.yaml").write_text("time: t\n")
    for number in range(6):
        (tmp_path / f"{number}.txt").write_text("")
    folders = [str(tmp_path), str(tmp_path / "below")]
    logs = find_logs(folders)
    assert [path.name for path in logs] == ["mine.csv", "odd.csv"]
    words = left_out(folders, logs)
    assert words.startswith("10 files left out: ")
    both = f"{tmp_path}/estimate.csv, {tmp_path}/estimate.csv.gz"
    assert f"{both} (an estimate that convert wrote)" in words
    both = f"{tmp_path}/below/wind.csv, {tmp_path}/below/wind.csv.gz"
    assert f"{both} (a table without inertial samples: no column" in words
    assert f"{tmp_path}/3.txt and 2 more (none of .tlog, .bin, .ulg, .csv)" in words
    assert "columns.yaml" not in words


def test_what_convert_wrote_beside_a_log_is_no_log_of_its_own(folder, tmp_path):
    flight = shutil.copy(folder / "a0.tlog", tmp_path / "flight.tlog")
    convert(flight, [tmp_path / "estimate.tlog", tmp_path / "estimate.ulg"], Config())
    beat = Sender(1, 194).frame("HEARTBEAT", pack("HEARTBEAT", mavlink_version=3))
    written = (tmp_path / "estimate.tlog").read_bytes()
    (tmp_path / "recorded.tlog").write_bytes(written + written[:8] + beat)

    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["flight.tlog", "recorded.tlog"]
    words = left_out([str(tmp_path)], logs)
    assert words.startswith("2 files left out: ")
    assert words.endswith("(an estimate that convert wrote)")
    named = tmp_path / "estimate.tlog"
    assert find_logs([str(named)]) == [named]
    with pytest.raises(
        LogError, match=r"estimate\.ulg: an estimate that convert wrote, and no log"
    ):
        open_log(tmp_path / "estimate.ulg")


@pytest.mark.parametrize(
    "name",
    [
        f"{'n' * 238}.csv",
        os.fsdecode(b"\xff\xfe.tlog"),
        pytest.param(f"{'n' * 250}.csv", marks=pytest.mark.campaign),
        pytest.param("dangling.csv", marks=pytest.mark.campaign),
        pytest.param("a\nb.tlog", marks=pytest.mark.campaign),
    ],
)
def test_a_file_with_an_odd_name_stops_no_other(tmp_path, folder, name):
    logs, out = tmp_path / "logs", tmp_path / "table.csv"
    logs.mkdir()
    shutil.copy(folder / "a0.tlog", logs / "good.tlog")
    if name == "dangling.csv":
        (logs / name).symlink_to("nowhere")
    else:
        (logs / name).write_text("no log")
    command = [sys.executable, "-m", "ekf_companion", "batch", str(logs), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, check=False)
    assert b"Traceback" not in done.stderr
    rows = {row["log"]: row for row in rows_of(out)}
    assert rows[str(logs / "good.tlog")]["outcome"] == "estimated"
    assert all(row["why"] for row in rows.values() if row["outcome"] == "failed")


def test_what_is_no_file_is_left_out_by_name(tmp_path):
    os.mkfifo(tmp_path / "pipe.tlog")
    (tmp_path / "absent.bin").symlink_to("nowhere.bin")
    (tmp_path / "circle.ulg").symlink_to("circle.ulg")
    (tmp_path / "endless.csv").symlink_to("/dev/zero")
    (tmp_path / "flight.tlog").write_bytes(b"")
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["flight.tlog"]
    words = left_out([str(tmp_path)], logs)
    assert words.startswith("4 files left out: ")
    assert words.endswith("(no file: a pipe, a device, or a link to none)")


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("\x1b[2Jclear.csv", r"\x1b[2Jclear.csv"),
        ("two\nlines.csv", r"two\nlines.csv"),
        ("back\rward.csv", r"back\rward.csv"),
        ("\u202evsc.tfel", r"\u202evsc.tfel"),
        ("größe °.csv", "größe °.csv"),
    ],
)
def test_no_name_changes_the_screen(name, shown):
    row = {"log": name, "outcome": "failed", "why": f"{name}: none"}
    assert lines([row])[0] == f"{shown}  failed: {shown}: none"


def test_no_name_is_a_formula_of_a_spreadsheet(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (
        "=HYPERLINK(1).tlog",
        "+1.tlog",
        "-1.tlog",
        "@a.tlog",
        " +1.tlog",
        "good.tlog",
    ):
        Path(name).write_bytes(b"no log")
        row = examine(Path(name), Config())
        assert row["log"][0] in "./g"
        assert Path(row["log"]).resolve() == Path(name).resolve()


def test_what_is_no_journal_is_left_alone(tmp_path, folder):
    log, journal = folder / "a0.tlog", tmp_path / "table.csv.journal"
    for content in ("my notes\n", "[1]\n", "{}", "[[], {}]\n", "null\n", "[" * 100_000):
        journal.write_text(content)
        with pytest.raises(ConfigError, match="is no journal of a batch"):
            run([log], Config(), journal, Processes(1))
        assert journal.read_text() == content
    journal.unlink()
    other = tmp_path / "precious"
    other.write_text("mine")
    journal.symlink_to(other)
    with pytest.raises(ConfigError, match="cannot be read"):
        run([log], Config(), journal, Processes(1))
    assert other.read_text() == "mine"


def test_odd_lines_of_a_journal_are_no_rows(tmp_path, folder):
    log, journal = folder / "a0.tlog", tmp_path / "table.csv.journal"
    (row,) = run([log], Config(), journal, Counted())
    begin, line = journal.read_text().splitlines()
    key = json.loads(line)[0]
    for odd in (
        "[1]",
        "3",
        "[[1], {}]",
        f'["{key}", 7]',
        f'["{key}", {{"log": 1}}]',
        '["' + "x" * 99,
    ):
        journal.write_text(f"{begin}\n{odd}\n")
        again = Counted()
        assert run([log], Config(), journal, again) == [row]
        assert again.asked == [log.name]


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("duration_s", "long"),
        ("duration_s", [1]),
        ("outcome", "perhaps"),
        ("verdict", 7),
        ("why", "\ud800"),
        ("resets", 1 << 70),
        ("resets", 0.5),
        ("resets", True),
    ],
)
def test_a_row_that_the_table_cannot_hold_is_no_row(tmp_path, folder, column, value):
    log, journal = folder / "a0.tlog", tmp_path / "table.csv.journal"
    (row,) = run([log], Config(), journal, Counted())
    begin, line = journal.read_text().splitlines()
    key, _ = json.loads(line)
    journal.write_text(f"{begin}\n{json.dumps([key, {**row, column: value}])}\n")
    again = Counted()
    assert run([log], Config(), journal, again) == [row]
    assert again.asked == [log.name]


def test_what_is_no_file_or_has_no_end_is_no_journal_and_is_refused_at_once(tmp_path, folder):
    log, journal = folder / "a0.tlog", tmp_path / "table.csv.journal"
    os.mkfifo(journal)
    with pytest.raises(ConfigError, match="is not a regular file"):
        run([log], Config(), journal, Counted())
    journal.unlink()
    with journal.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(ConfigError, match="is larger than any journal of a batch"):
        run([log], Config(), journal, Counted())
    assert journal.stat().st_size == 1 << 40
    journal.unlink()
