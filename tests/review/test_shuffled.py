"""A .tlog whose frames are not in the order in which they came is named where that costs."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.logs import tlog
from sim_autopilot.__main__ import app as sim

SHUFFLED = "frames not in the order in which they came"
BACK = "samples not in the order of their stamps"
LATE = "of the inertial samples came too late to be used"


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Return the stamp, us, and the frame of each record of a flight."""
    path = tmp_path_factory.mktemp("flight") / "flight.tlog"
    asked = ["generate", "--duration", "25", "--imu-rate", "100", "--seed", "2", "-o", str(path)]
    assert CliRunner().invoke(sim, asked).exit_code == 0
    return [*tlog.read(path).frames()]


def delayed(records, seconds, seed=1):
    """Return records in an order in which each comes up to so much later."""
    rng = np.random.default_rng(seed)
    late = [stamp_us + rng.uniform(0.0, seconds * 1e6) for stamp_us, _ in records]
    return [records[i] for i in np.argsort(late, kind="stable")]


def restamped(records):
    """Return records with stamps that ascend: as of a recorder that got them in that order."""
    stamps = sorted(stamp_us for stamp_us, _ in records)
    return [(stamp_us, frame) for stamp_us, (_, frame) in zip(stamps, records, strict=True)]


def said_of(records, folder):
    path = folder / "flight.tlog"
    path.write_bytes(b"".join(stamp_us.to_bytes(8, "big") + frame for stamp_us, frame in records))
    result = CliRunner().invoke(app, ["convert", str(path), "-o", str(folder / "out.csv")])
    # Errors go where the line of progress does, which a busy machine shows
    return " ".join((result.stdout or result.output).split())


@pytest.mark.parametrize("seconds", [0.5, 2.0, 10.0, 1e6], ids=str)
def test_shuffled_frames_are_named_in_the_verdict_and_in_a_note(records, seconds, tmp_path):
    said = said_of(delayed(records, seconds), tmp_path)
    verdict, _, notes = said.partition("flight.tlog:")
    assert SHUFFLED in verdict
    assert not verdict.startswith("good")
    assert re.search(r"so \d+% of the inertial samples gave no estimate", notes)
    assert "sort its records by their stamps" in notes


@pytest.mark.parametrize("seconds", [0.5, 2.0, 1e6], ids=str)
def test_frames_that_came_shuffled_are_named_by_what_they_cost(records, seconds, tmp_path):
    said = said_of(restamped(delayed(records, seconds)), tmp_path)
    assert not said.startswith("good")
    assert any(words in said.partition("flight.tlog:")[0] for words in (BACK, LATE))


def test_a_log_that_is_read_backwards_says_why_it_gives_nothing(records, tmp_path):
    said = said_of(records[::-1], tmp_path)
    assert SHUFFLED in said or "sort its records by their stamps" in said


def test_a_log_in_order_and_one_whose_recorders_clock_was_set_are_not_named(records, tmp_path):
    set_back = [(t - 5_000_000 * (i > len(records) // 2), f) for i, (t, f) in enumerate(records)]
    for some in (records, set_back):
        said = said_of(some, tmp_path)
        assert said.startswith("good")
        assert "in the order" not in said
        assert "gave no estimate" not in said


def test_frames_of_two_wires_that_cross_within_a_sample_cost_nothing(records, tmp_path):
    assert SHUFFLED not in said_of(delayed(records, 0.001), tmp_path)
