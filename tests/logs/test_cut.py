"""Files that end too early: the verdict says so, and the advice is about that."""

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.errors import LogError
from ekf_companion.logs import dataflash, tlog, ulog
from ekf_companion.logs.recording import CUT, counted, damaged_places
from sim_autopilot.__main__ import app as simulator
from tests.logs.test_dataflash import new_log
from tests.logs.test_ulog import COMBINED
from tests.logs.test_ulog import Writer as UlogWriter


def ulog_bytes(rows=50):
    log = UlogWriter([COMBINED])
    for i in range(rows):
        log.row(0, 1_000_000 + 10_000 * i, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8)
    return bytes(log.data)


def written(path, data):
    path.write_bytes(data)
    return path


def test_a_file_that_ends_within_a_message_has_that_in_its_damage(tmp_path):
    whole = new_log()
    assert dataflash.read(written(tmp_path / "a.bin", whole)).damage.words == ""
    cut = dataflash.read(written(tmp_path / "b.bin", whole[:-5]))
    assert (cut.damage.words, cut.damage.share) == (CUT, 0.0)
    whole = ulog_bytes()
    assert ulog.read(written(tmp_path / "a.ulg", whole)).damage.words == ""
    assert ulog.read(written(tmp_path / "b.ulg", whole[:-5])).damage.words == CUT


def test_the_verdict_names_it(tmp_path):
    words = ("generate", "--duration", "30", "--imu-rate", "50", "-o", tmp_path / "whole.tlog")
    assert CliRunner().invoke(simulator, [*map(str, words)]).exit_code == 0
    data = (tmp_path / "whole.tlog").read_bytes()
    assert tlog.read(tmp_path / "whole.tlog").damage.words == ""
    cut = written(tmp_path / "cut.tlog", data[:-7])
    result = CliRunner().invoke(app, ["convert", str(cut), "-o", str(tmp_path / "cut.csv")])
    assert result.stdout.splitlines()[0].endswith(f", {CUT}")


@pytest.mark.parametrize(("suffix", "read"), [(".bin", dataflash.read), (".ulg", ulog.read)])
def test_of_a_file_without_any_sample_it_is_said_that_it_is_cut(tmp_path, suffix, read):
    whole = new_log() if suffix == ".bin" else ulog_bytes()
    path = written(tmp_path / f"tiny{suffix}", whole[:100])
    with pytest.raises(LogError, match="ends after 100 bytes, before any sample: the recording"):
        read(path)


def test_one_is_no_plural():
    assert [counted(n, "run") for n in (1, 2)] == ["1 run", "2 runs"]
    assert damaged_places(1) == "a damaged place"
