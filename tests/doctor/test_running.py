"""The stages by the status of a daemon that runs."""

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.doctor.report import lines
from ekf_companion.doctor.running import diagnose_running
from ekf_companion.doctor.stage import Outcome
from ekf_companion.status.judge import to_json
from tests.cli.served import serving_once
from tests.status.test_observer import Watched


@pytest.fixture(scope="module")
def snapshot():
    snapshot = Watched().fly(12.0).snapshot()
    link = replace(snapshot.link, is_open=True, opened=1, silent_s=0.0)
    return replace(snapshot, link=link)


def told(snapshot):
    return json.loads(to_json(snapshot))


def outcomes(status):
    return {result.stage.value: result.outcome for result in diagnose_running(status)}


def first_words(status):
    return "\n".join(line for _, line in lines(diagnose_running(status), 200))


def test_a_daemon_in_flight_fails_at_no_stage(snapshot):
    found = outcomes(told(snapshot))
    assert found.pop("values") is Outcome.UNKNOWN
    assert set(found.values()) <= {Outcome.OK, Outcome.WARNING}, found
    assert found["estimate"] is Outcome.OK


def test_what_comes_is_named_by_its_weight_and_what_does_not_apart(snapshot):
    said = first_words(told(snapshot))
    assert "HIGHRES_IMU, GPS_RAW_INT, ATTITUDE" in said
    assert " 0 of " not in said.partition("rates ")[2]
    assert "none of " in said


@pytest.mark.parametrize(
    ("changed", "stage", "words"),
    [
        ({"is_open": False, "failure": "No such file"}, "link", "is closed (No such file)"),
        ({"silent_s": float("nan"), "bytes_in": 0}, "bytes", "Not a byte has come over the link"),
        ({"silent_s": 12.0}, "bytes", "The link has been silent for 12.0 s"),
    ],
)
def test_a_link_that_brings_nothing_hides_what_follows(snapshot, changed, stage, words):
    status = told(replace(snapshot, link=replace(snapshot.link, **changed)))
    found = outcomes(status)
    assert found[stage] is Outcome.FAILED
    assert found["fused"] is Outcome.UNKNOWN
    assert words in first_words(status)
    assert "not reached: " in first_words(status)


def test_no_autopilot_no_samples_and_nothing_sent_are_named(snapshot):
    assert outcomes(told(replace(snapshot, peer=None)))["source"] is Outcome.FAILED
    silent = replace(snapshot.peer, is_heard=False, silent_s=9.0)
    status = told(replace(snapshot, peer=silent))
    assert "source: The autopilot has been silent for 9.0 s." in first_words(status)
    status = told(replace(snapshot, sample_age_s=8.0))
    assert "messages: " in first_words(status)
    assert outcomes(status)["messages"] is Outcome.FAILED
    output = replace(
        snapshot.output,
        is_streaming=False,
        is_allowed=False,
        reason="EKF2_EV_CTRL is 15",
        remedy="set EKF2_EV_CTRL to 0",
    )
    words = first_words(told(replace(snapshot, output=output)))
    assert "sent: ODOMETRY is not sent: EKF2_EV_CTRL is 15." in words
    assert "-> Set EKF2_EV_CTRL to 0" in words


def test_a_daemon_without_an_estimate_is_judged_too(snapshot):
    fresh = replace(snapshot, estimator=None, vehicle=None)
    assert outcomes(told(fresh))["estimate"] is Outcome.FAILED


def doctor(*words):
    return CliRunner().invoke(app, ["doctor", *map(str, words)])


def test_the_doctor_asks_a_daemon_by_its_address(snapshot):
    with serving_once(to_json(snapshot)) as url:
        result = doctor("--url", url, "--json")
    data = json.loads(result.stdout)
    assert data["means"] == "daemon"
    assert data["autopilot"]["family"] == "px4"
    assert data["stages"][0]["stage"] == "link"


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        (["--url", "udpin:0.0.0.0:14540"], 4, "(a link is named with --link)"),
        (["--url", "http://127.0.0.1:1"], 4, "nothing answers"),
        (["--url", "http://127.0.0.1:1", "--listen"], 2, "leave the other options out"),
    ],
)
def test_an_address_of_no_daemon_is_a_sentence(words, code, sentence):
    result = doctor(*words)
    assert result.exit_code == code
    assert sentence in result.stderr
