"""Outputs that cannot be written: a sentence, and the older file as it was."""

import ctypes
import os
import resource
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from sim_autopilot.__main__ import app as sim

ROOM = 4096
"""Bytes that a file may have."""
DROP_FROM_BOUNDING_SET, CAP_DAC_OVERRIDE = 24, 1
"""Of prctl(2): what lets root write to any folder."""
ESTIMATES = [".csv", ".tlog", ".mcap", ".parquet", ".tum", ".kml", ".gpx", ".ulg"]
FLIGHT = ["generate", "--scenario", "hover", "--duration", "5", "--imu-rate", "100"]
COMMANDS = {
    "convert LOG -o": ESTIMATES,
    "convert LOG --smooth -o": [".csv", ".parquet"],
    "convert LOG --filter ahrs -o": [".csv"],
    "report LOG -o": [".html"],
    "compare LOG --skip 5 --plot": [".png", ".svg"],
    "observability LOG --plot": [".png"],
    "calibrate delay LOG --plot": [".pdf"],
    "calibrate mag LOG --plot": [".png"],
    "batch LOG LOG2 LOG3 LOG4 -o": [".csv", ".parquet"],
    f"sim {' '.join(FLIGHT)} -o": [".tlog"],
    f"sim {' '.join(FLIGHT)} -o OTHER.tlog --truth": [".csv"],
}
QUICK = ["convert LOG -o.tlog", "report LOG -o.html", f"sim {' '.join(FLIGHT)} -o.tlog"]
CASES = [
    pytest.param(command, suffix, marks=[] if command + suffix in QUICK else pytest.mark.campaign)
    for command, suffixes in COMMANDS.items()
    for suffix in suffixes
]
IN_ANY_FOLDER = os.geteuid() == 0
"""Whether we may write there if nothing is dropped."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "flight.tlog"
    words = ("generate", "--scenario", "figure-eight", "--duration", "30", "--imu-rate", "100")
    result = CliRunner().invoke(sim, [*words, "-o", str(path)])
    assert result.exit_code == 0, result.output
    for number in (2, 3, 4):
        path.with_name(f"flight{number}.tlog").write_bytes(path.read_bytes())
    return path


def run(command, log, out, before=None, stdout=subprocess.PIPE):
    """Run a command that is to write a file, in a process of its own."""
    first, *words = command.split()
    module = ["sim_autopilot"] if first == "sim" else ["ekf_companion", first]
    logs = {"LOG": log, **{f"LOG{n}": log.with_name(f"flight{n}.tlog") for n in (2, 3, 4)}}
    logs["OTHER.tlog"] = log.with_name("other.tlog")
    words = [str(logs.get(word, word)) for word in words]
    return subprocess.run(
        [sys.executable, "-m", *module, *words, *([] if out is None else [str(out)])],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        preexec_fn=before,
    )


def check(done, words):
    """Check for one sentence, and the exit code of docs/COMMANDS.md: sim-autopilot has only one."""
    text = " ".join(done.stderr.split())
    assert "Traceback" not in text, done.stderr
    assert words in text, done.stderr
    assert done.returncode == (2 if "ekf-companion: " not in text else 3), done.stderr


def no_room():
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))


def no_right():
    """Write only where the owner may, root as anybody."""
    if IN_ANY_FOLDER:
        ctypes.CDLL(None).prctl(DROP_FROM_BOUNDING_SET, CAP_DAC_OVERRIDE, 0, 0, 0)


@pytest.mark.parametrize(("command", "suffix"), CASES)
def test_a_full_disk_is_a_sentence_and_leaves_the_older_file(log, tmp_path, command, suffix):
    out = tmp_path / f"out{suffix}"
    out.write_text("older")
    check(run(command, log, out, no_room), "cannot be written: File too large")
    assert out.read_bytes() == b"older"
    left = {one.name for one in tmp_path.iterdir()}
    assert left - {f"{out.name}.journal"} == {out.name}  # with which a batch goes on


@pytest.mark.parametrize(("command", "suffix"), CASES)
def test_a_device_without_room_is_a_sentence(log, tmp_path, command, suffix):
    out = tmp_path / f"out{suffix}"
    out.symlink_to("/dev/full")
    check(run(command, log, out), "cannot be written: No space left on device")
    assert out.is_symlink()


@pytest.mark.parametrize(("command", "suffix"), CASES)
def test_a_folder_that_takes_no_file_is_a_sentence(log, tmp_path, command, suffix):
    folder = tmp_path / "closed"
    folder.mkdir()
    out = folder / f"out{suffix}"
    out.write_text("older")
    folder.chmod(0o555)
    try:
        check(run(command, log, out, no_right), "cannot be written: Permission denied")
        assert out.read_bytes() == b"older"
        assert [one.name for one in folder.iterdir()] == [out.name]
    finally:
        folder.chmod(0o755)


@pytest.mark.parametrize(
    "command", ["convert LOG -o -", "compare LOG", "doctor --log LOG", "--version", "sim scenarios"]
)
def test_a_standard_output_without_room_is_a_sentence(log, command):
    with open("/dev/full", "w") as full:
        done = run(command, log, None, stdout=full)
    who = "sim-autopilot" if command.startswith("sim") else "ekf-companion"
    words = f"{who}: the standard output cannot be written: No space left on device\n"
    # On a busy machine a line of progress comes first
    assert (done.returncode, done.stderr.splitlines(keepends=True)[-1]) == (3, words)


def test_a_standard_output_that_is_closed_is_a_sentence(log):
    done = run("convert LOG -o -", log, None, lambda: os.close(1))
    assert done.returncode == 3
    assert done.stderr == "ekf-companion: -: the standard output is closed; name a file\n"


def test_a_reader_that_has_seen_enough_gets_no_words(log):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as pipe:
        done = run("convert LOG -o -", log, None, stdout=pipe)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_batch_goes_on_where_the_disk_was_full(log, tmp_path):
    out = tmp_path / "table.csv"
    journal = tmp_path / "table.csv.journal"
    command = "batch LOG LOG2 LOG3 LOG4 -o"
    check(run(command, log, out, no_room), "cannot be written: File too large")
    rows = journal.read_text().count("\n")
    assert rows > 1
    assert run(command, log, out).returncode == 0
    assert out.read_text().count("\n") == 5
    assert [one.name for one in tmp_path.iterdir()] == [out.name]


def test_links_in_a_circle_are_a_sentence_as_a_log_and_no_output_to_mistake(log, tmp_path):
    one, two = tmp_path / "one.csv", tmp_path / "two.csv"
    one.symlink_to(two)
    two.symlink_to(one)
    done = run(f"convert {one} -o", log, tmp_path / "out.csv")
    assert done.returncode == 3
    assert "Too many levels of symbolic links" in done.stderr
    done = run("convert LOG -o", log, one)
    assert done.returncode == 0, done.stderr
    assert one.read_text().startswith("time_us,")


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        ("report none.tlog", "bokeh", "report"),
        ("report none.tlog --png", "matplotlib.figure", "plot"),
        ("compare none.tlog --plot out.png", "matplotlib.figure", "plot"),
        ("observability none.tlog --plot out.png", "matplotlib.figure", "plot"),
        ("batch LOG -o out.parquet", "pyarrow.parquet", "formats"),
    ],
)
def test_a_missing_extra_is_noticed_before_any_log_is_read(
    tmp_path, monkeypatch, command, package, extra
):
    (tmp_path / "flight.bin").write_bytes(b"no log")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    done = CliRunner().invoke(app, command.replace("LOG", "flight.bin").split())
    assert done.exit_code == 1
    named = package.partition(".")[0]
    assert f"needs {named}, which is not installed: {sys.executable} -m pip in" in done.stderr
    assert f"[{extra}]" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["flight.bin"]
