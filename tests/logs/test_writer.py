"""Files of estimates: whole, or not there."""

import os
import subprocess

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs.csv_writer import Writer as CsvWriter
from ekf_companion.logs.writer import create
from ekf_companion.nav import reason
from ekf_companion.nav.state import COLUMNS, Reason, Status, Table
from ekf_companion.review.convert import convert
from sim_autopilot.__main__ import app as simulator

ROW = Table(stamp_ns=np.array([5_000]), values=np.zeros((1, len(COLUMNS) - 1)))


def test_a_file_has_its_name_once_it_is_complete(tmp_path):
    path = tmp_path / "out.csv"
    with CsvWriter(path) as writer:
        writer.write(ROW)
        assert not path.exists()
    assert [one.name for one in tmp_path.iterdir()] == ["out.csv"]
    assert len(path.read_text().splitlines()) == 2


def interrupted(path, error):
    with CsvWriter(path) as writer:
        writer.write(ROW)
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, LogError])
def test_what_is_interrupted_leaves_nothing_and_the_older_file_as_it_was(tmp_path, error):
    path = tmp_path / "out.csv"
    for before in (None, "older\n"):
        if before is not None:
            path.write_text(before)
        with pytest.raises(error):
            interrupted(path, error)
        assert [one.read_text() for one in tmp_path.iterdir()] == ([before] if before else [])


def test_a_pipe_is_written_as_it_is(tmp_path):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with subprocess.Popen(["cat", path], stdout=subprocess.PIPE) as reader:
        with create(path) as file:
            file.write(b"estimates")
        assert reader.communicate()[0] == b"estimates"


@pytest.mark.parametrize("suffix", [".csv", ".tlog"])
def test_ctrl_c_leaves_no_file(tmp_path, suffix):
    log, out = tmp_path / "flight.tlog", tmp_path / f"out{suffix}"
    made = CliRunner().invoke(simulator, ["generate", "-o", str(log), "--duration", "12"])
    assert made.exit_code == 0, made.output
    before = sorted(tmp_path.iterdir())

    def interrupt(done, total):
        assert len(list(tmp_path.iterdir())) > len(before)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        convert(log, out, Config(), progress=interrupt)
    assert sorted(tmp_path.iterdir()) == before


def test_a_line_has_each_number_to_the_bit_and_no_cell_for_what_is_unknown(tmp_path):
    rng = np.random.default_rng(7)
    values = (
        rng.standard_normal((3000, len(COLUMNS) - 1))
        * 10.0 ** rng.integers(-300, 300, 3000)[:, None]
    )
    values[rng.random(values.shape) < 0.1] = np.nan
    values[:40, :-3] = np.nan
    values[50:60, 3] = -0.0
    values[:, -3] = rng.integers(0, len(Status), 3000)
    values[:, -2] = np.arange(3000) // 700
    values[:, -1] = rng.integers(0, 1 << len(Reason), 3000)
    stamps = np.concatenate([[-7_000, 0], np.arange(1, 2999) * 4_000_000])
    with CsvWriter(tmp_path / "out.csv") as writer:
        writer.write(Table(stamp_ns=stamps, values=values))
    header, *lines = (tmp_path / "out.csv").read_text().split("\n")
    assert header.split(",") == COLUMNS
    assert lines.pop() == ""
    cells = [line.split(",") for line in lines]
    assert [int(row[0]) for row in cells] == (stamps // 1000).tolist()
    read = np.array([[float(cell or "nan") for cell in row[1:-3]] for row in cells])
    unknown = np.isnan(values[:, :-3])
    assert (np.isnan(read) == unknown).all()
    assert np.where(unknown, 0.0, read).tobytes() == np.nan_to_num(values[:, :-3]).tobytes()
    assert [row[-3:-1] for row in cells] == [
        [Status(int(status)).name.lower(), str(int(resets))] for status, resets in values[:, -3:-1]
    ]
    assert [reason.from_names(row[-1]) for row in cells] == values[:, -1].tolist()
