import copy
from pathlib import Path

import pytest

from sim_autopilot import demo, figure, score_table
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.score import Witness

GOOD = {
    "scenario": "figure-eight",
    "seed": 1,
    "score_after_s": 10.0,
    "odometry": {"received": 10, "scored": 9, "rate_hz": 30.0, "resets": 0},
    "origin": "GPS_GLOBAL_ORIGIN",
    "latency_ms": {"p50": 1.0, "p99": 2.0, "max": 3.0},
    **{key: {"rms": limit, "p95": 1.0, "max": 2.0} for key, limit in demo.LIMITS.items()},
}


def test_a_score_at_its_limits_passes():
    assert demo.complaints(GOOD, Path("daemon.log")) == []


@pytest.mark.parametrize("key", demo.LIMITS)
@pytest.mark.parametrize("factor", [1.01, float("nan")])
def test_every_limit_is_held(key, factor):
    score = copy.deepcopy(GOOD)
    score[key]["rms"] *= factor
    (complaint,) = demo.complaints(score, Path("daemon.log"))
    assert complaint.startswith(score_table.TITLES[key])


def test_silence_is_a_failure():
    score = copy.deepcopy(GOOD)
    score["odometry"]["scored"] = 0
    (complaint,) = demo.complaints(score, Path("daemon.log"))
    assert "no ODOMETRY" in complaint


def test_the_limits_are_those_of_the_project():
    assert list(demo.LIMITS.values()) == [0.6, 0.9, 0.15, 0.5, 0.5, 1.5]


def test_the_picture_is_drawn_even_of_silence(tmp_path):
    pytest.importorskip("matplotlib")
    flight = Flight.plan("figure-eight", SimConfig(), duration=12.0)
    witness = Witness(flight)
    figure.draw(tmp_path / "demo.png", flight, witness, witness.score())
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.campaign
def test_whoever_waits_sees_every_four_seconds_that_it_flies(tmp_path):
    told = []
    demo.fly(tmp_path, duration=12.0, seed=1, on_progress=told.append)
    assert told[0] == "planning the flight"
    assert told[1] == "flying for 12 s"
    assert "flying, 4 of 12 s" in told
    assert "flying, 8 of 12 s" in told
    assert told[-1] == "drawing the figure"
    log = (tmp_path / "daemon.log").read_text()
    assert "failed" not in log  # of what nobody needs
    assert "SCALED_PRESSURE: not offered; only autopilots whose inertial message has no" in log
