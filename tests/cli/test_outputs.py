"""Outputs for which there is no room: a sentence, and the older file as it was."""

import resource
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from sim_autopilot.__main__ import app as sim

ROOM = 8192
"""Bytes that a file may have."""
OUTPUTS = {
    "convert": [".csv", ".tlog", ".mcap", ".parquet", ".tum", ".kml", ".gpx", ".ulg"],
    "convert --smooth": [".csv", ".parquet"],
    "report": [".html"],
    "compare --skip 5 --plot": [".png", ".svg"],
    "observability --plot": [".png"],
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "flight.tlog"
    words = ("generate", "--scenario", "figure-eight", "--duration", "20", "--imu-rate", "100")
    result = CliRunner().invoke(sim, [*words, "-o", str(path)])
    assert result.exit_code == 0, result.output
    return path


CASES = [
    pytest.param(words, suffix, marks=[] if suffix in (".tlog", ".html") else pytest.mark.campaign)
    for words, suffixes in OUTPUTS.items()
    for suffix in suffixes
]


@pytest.mark.parametrize(("words", "suffix"), CASES)
def test_a_full_disk_is_a_sentence_and_leaves_the_older_file(log, tmp_path, words, suffix):
    command, *options = words.split()
    out = tmp_path / f"out{suffix}"
    out.write_text("older")
    option = options.pop() if options and options[-1] == "--plot" else "-o"
    run = [sys.executable, "-m", "ekf_companion", command, str(log), *options, option, str(out)]
    done = subprocess.run(
        run,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM)),
    )
    assert done.returncode not in (0, -25), done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    assert "cannot be written" in " ".join(done.stderr.split()), done.stderr
    assert out.read_text() == "older"
    assert [one.name for one in tmp_path.iterdir()] == [out.name]
