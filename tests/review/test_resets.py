"""Resets are counted by one rule, whoever names them; reboots of the autopilot beside them."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import Config
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.fleet.row import examine
from ekf_companion.nav.measurements import Restart
from ekf_companion.nav.state import COLUMNS, Table
from ekf_companion.review.account import resets_of, sentences
from sim_autopilot.__main__ import app as sim


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Return the bytes of three flights of the same vehicle."""
    folder = tmp_path_factory.mktemp("flights")
    found = []
    for seed in (2, 3, 4):
        path = folder / f"{seed}.tlog"
        asked = ["generate", "--duration", "30", "--imu-rate", "50", "--seed", str(seed)]
        assert CliRunner().invoke(sim, [*asked, "-o", str(path)]).exit_code == 0
        found.append(path.read_bytes())
    return found


def holed(flight):
    """Leave out some four seconds of a flight: what ends the gap resets the estimate."""
    middle, part = len(flight) // 2, len(flight) // 7
    return flight[:middle] + flight[middle + part :]


@pytest.mark.parametrize(
    ("order", "reboots"),
    [("ab", 1), ("Ab", 1), ("aB", 1), ("AB", 1), ("A", 0), ("a", 0), ("aBc", 2)],
    ids=["none", "before", "after", "both", "no reboot", "whole", "two reboots"],
)
def test_summary_json_verdict_and_batch_count_the_same_resets(flights, order, reboots, tmp_path):
    parts = dict(zip("abc", flights, strict=True))
    parts |= {"A": holed(flights[0]), "B": holed(flights[1])}
    log, out = tmp_path / "flight.tlog", tmp_path / "out.csv"
    log.write_bytes(b"".join(parts[one] for one in order))
    said = CliRunner().invoke(app, ["convert", str(log), "-o", str(out)]).output
    found = json.loads(
        CliRunner().invoke(app, ["convert", str(log), "-o", str(out), "--json"]).stdout
    )
    with out.open() as file:
        counts = np.array([int(float(one["reset_count"])) for one in csv.DictReader(file)])
    row = examine(log, Config())
    resets = found["resets"]
    assert found["reboots"] == row["reboots"] == reboots
    assert row["resets"] == resets
    assert int(np.maximum(np.diff(counts, prepend=0), 0).sum()) == resets + reboots
    assert (resets > 0) == any(one.isupper() for one in order)
    said = " ".join(said.split())
    assert f"resets: {resets}{'' if resets else ';'}" in said
    assert (f"reboots: {reboots};" in said) == (reboots > 0)
    assert ("the autopilot rebooted" in row["verdict"]) == (reboots > 0)
    words = f"{resets} reset{'s' * (resets > 1)} (last: "
    assert (words in row["verdict"]) == (resets > 0)
    assert "last: clock" not in said + row["verdict"]
    assert (row["last_reset"] is not None) == (resets > 0)


def test_a_reboot_before_anything_was_estimated_hides_no_reset():
    pipeline = Pipeline(FilterSettings())
    pipeline.process(Restart())
    assert (pipeline.resets, pipeline.reboots) == (0, 0)


def test_two_resets_at_one_measurement_are_two_in_python():
    values = np.zeros((4, len(COLUMNS) - 1))
    values[:, COLUMNS.index("reset_count") - 1] = [0.0, 0.0, 2.0, 2.0]
    table = Table(stamp_ns=np.arange(4) * 10_000_000, values=values)
    assert resets_of(table) == 2
    assert any("2 resets, at 0.0 s: " in one for one in sentences(table, *_nothing()))


def _nothing():
    from ekf_companion.nav.buffer import EventBuffer

    return EventBuffer(1).take(), {}
