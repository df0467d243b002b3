"""The data set of a fleet: complete, byte for byte the same, whatever was interrupted."""

import resource
import shutil
from pathlib import Path

import pytest
from pyarrow import parquet
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import Config
from ekf_companion.errors import ConfigError, LogError
from ekf_companion.fleet import campaign, dataset
from ekf_companion.fleet.executor import KILLED
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.load import builds, load
from ekf_companion.fleet.row import COLUMNS, examine, failed
from sim_autopilot.__main__ import app as sim
from tests.fleet.in_place import InPlace


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    root = tmp_path_factory.mktemp("logs")
    words = ("generate", "--scenario", "figure-eight", "--duration", "12", "--imu-rate", "50")
    result = CliRunner().invoke(sim, [*words, "-o", str(root / "a.tlog")])
    assert result.exit_code == 0, result.output
    whole = (root / "a.tlog").read_bytes()
    (root / "b.tlog").write_bytes(whole[:9000] + bytes(5000) + whole[14000:])
    (root / "c.bin").write_bytes(b"\xfd\xa3\x95" * 900)
    return root


def fill(logs, place, executor=None, config=None):
    executor = executor or InPlace()
    return campaign.run(Listing([str(logs)]), config or Config(), str(place), executor), executor


def files(place):
    return {path.relative_to(place): path.read_bytes() for path in sorted(place.rglob("*.parquet"))}


def test_the_tables_hold_each_log_its_events_and_its_histograms(logs, tmp_path):
    account, _ = fill(logs, tmp_path)
    assert account.lines() == ["3 logs: 2 estimated, 1 failed"]
    rows = load(str(tmp_path)).to_pylist()
    assert [Path(row["log"]).name for row in rows] == ["a.tlog", "b.tlog", "c.bin"]
    assert [{name: row[name] for name in COLUMNS} for row in rows] == [
        examine(logs / name, Config()) for name in ("a.tlog", "b.tlog", "c.bin")
    ]
    histograms = load(str(tmp_path), "histograms").to_pylist()
    by_name = {one["quantity"]: one for one in histograms if one["log"].endswith("a.tlog")}
    assert {"innovation_position_north", "nis_velocity", "gyro_noise"} <= by_name.keys()
    fixes = by_name["innovation_velocity_north"]
    assert fixes["below"] + sum(fixes["counts"]) + fixes["above"] > 20
    assert abs(fixes["mean"]) < 1.0 < 2.0 > fixes["std"] > 0.1
    faults = [one for one in load(str(tmp_path), "events").to_pylist() if one["kind"] == "fault"]
    assert {one["log"][-6:] for one in faults} == {"a.tlog", "b.tlog"}


def test_interrupted_and_resumed_the_files_are_the_same_bytes(logs, tmp_path):
    fill(logs, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        fill(logs, tmp_path / "cut", InPlace(most=1))
    assert not [one for one in files(tmp_path / "cut") if one.name.startswith("pack-")]
    account, again = fill(logs, tmp_path / "cut")
    assert (account.before, sorted(again.asked)) == (1, ["b.tlog", "c.bin"])
    assert files(tmp_path / "cut") == files(tmp_path / "whole")
    assert len(files(tmp_path / "whole")) == 3
    account, nothing = fill(logs, tmp_path / "cut")
    assert (account.lines(), nothing.asked) == (["3 logs: 3 done before"], [])


def test_a_pack_that_was_interrupted_counts_no_log_twice(logs, tmp_path):
    fill(logs, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        fill(logs, tmp_path / "cut", InPlace(most=2))
    shutil.copytree(tmp_path / "cut", tmp_path / "loose")
    fill(logs, tmp_path / "cut")
    # Its files are written, and the loose ones not yet deleted
    shutil.copytree(tmp_path / "loose", tmp_path / "cut", dirs_exist_ok=True)
    assert len(files(tmp_path / "cut")) > len(files(tmp_path / "whole"))
    for table in ("logs", "events", "histograms"):
        assert load(str(tmp_path / "cut"), table).equals(load(str(tmp_path / "whole"), table))


def test_other_content_is_another_row_and_a_touched_log_the_same(logs, tmp_path):
    own = Path(shutil.copytree(logs, tmp_path / "logs"))
    fill(own, tmp_path / "set")
    before = load(str(tmp_path / "set"))
    (own / "a.tlog").touch()
    fill(own, tmp_path / "set")
    for table in ("logs", "events", "histograms"):
        assert len({*load(str(tmp_path / "set"), table).column("key").to_pylist()}) <= 3
    assert load(str(tmp_path / "set")).column("key").equals(before.column("key"))
    (own / "a.tlog").write_bytes((own / "a.tlog").read_bytes()[:-300])
    _, executor = fill(own, tmp_path / "set")
    assert executor.asked == ["a.tlog"]
    assert len(load(str(tmp_path / "set"))) == 4


def test_each_configuration_has_a_partition_of_its_own(logs, tmp_path):
    fill(logs, tmp_path)
    before = files(tmp_path)
    fill(logs, tmp_path, config=Config(window=0.5))
    assert before.items() <= files(tmp_path).items()
    first, second = builds(str(tmp_path))
    with pytest.raises(ConfigError, match="several builds begin with ''"):
        load(str(tmp_path))
    settings = {
        load(str(tmp_path), of=str(one)).column("settings")[0].as_py()
        for one in builds(str(tmp_path))
    }
    assert settings == {"", "window = 0.5"}
    assert first.version == second.version


def test_a_log_that_kills_its_worker_has_a_row(logs, tmp_path):
    account, _ = fill(logs, tmp_path, InPlace(lost="b.tlog"))
    assert account.outcomes == {"estimated": 1, "failed": 2}
    rows = load(str(tmp_path)).to_pylist()
    assert [row["why"] for row in rows][1] == KILLED
    assert fill(logs, tmp_path)[1].asked == []


def test_a_file_that_is_none_of_its_own_is_named(logs, tmp_path):
    fill(logs, tmp_path)
    folder = next((tmp_path / "logs").rglob("*.parquet")).parent
    (folder / "zz.parquet").write_bytes(b"PAR1 and nothing")
    with pytest.raises(LogError, match=r"zz\.parquet: is no table of a fleet, or is damaged"):
        load(str(tmp_path))
    with pytest.raises(LogError, match=r"zz\.parquet"):
        fill(logs, tmp_path)


def test_a_file_without_rows_stops_no_pack_and_a_partition_without_files_is_empty(logs, tmp_path):
    place = f"{tmp_path}/results/"
    into = campaign.partition_of(place, Config())
    for table in dataset.TABLES:
        folder = Path(into.folder(table))
        folder.mkdir(parents=True)
        if table == "logs":
            assert len(load(place)) == 0
        parquet.write_table(dataset.schema(table).empty_table(), folder / "none.parquet")
    campaign.run(Listing([str(logs)]), Config(), place, InPlace())
    assert all(one.name.startswith("pack-") for one in Path(into.folder("logs")).iterdir())
    assert len(load(place)) == Listing([str(logs)]).total().logs


def test_what_has_no_room_leaves_nothing_behind(tmp_path):
    into = campaign.partition_of(f"{tmp_path}/results/", Config())
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limit[1]))
    try:
        with pytest.raises(LogError, match="File too large"):
            dataset.write_log(into, failed("a.tlog", "nothing"), 1, "content")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert not [one for one in tmp_path.rglob("*") if one.is_file()]


def test_a_folder_without_results_is_no_data_set(tmp_path):
    with pytest.raises(ConfigError, match="holds no results"):
        load(str(tmp_path))
    assert dataset.is_place(f"{tmp_path}/new/")
    assert dataset.is_place("s3://bucket/results")
    assert not dataset.is_place("table.csv")


def test_the_command_fills_a_data_set_and_says_what_was_done(logs, tmp_path):
    words = ["batch", str(logs), "-o", f"{tmp_path}/set/"]
    assert CliRunner().invoke(app, words).output.endswith("3 logs: 2 estimated, 1 failed\n")
    assert CliRunner().invoke(app, words).output.endswith("3 logs: 3 done before\n")
    both = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "t.csv")])
    assert both.exit_code == 2
    assert "a data set is written alone" in both.output
