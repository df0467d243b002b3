"""The daemon flies while the fault hypotheses decide, over real sockets; a replay is the same."""

import itertools
import json
import re
import socket

import numpy as np
import pytest

from sim_autopilot.autopilot import Kind
from sim_autopilot.faults import fault
from tests.daemon.test_daemon import (
    ODOMETRY,
    Daemon,
    Record,
    assert_same_as_its_estimates,
    assert_same_as_its_messages,
    fly_over,
    free_port,
    plan,
)
from tests.daemon.test_http import ask
from tests.daemon.test_hub import assert_a_replay_sends_the_same, fly

CONFIG = "weigh_faults: act\noutput: {odometry: {mode: always, age_limit: 10}}\n"
WRONG = (
    "gnss-jump:start=20,duration=8,east=60",
    "gnss-outage:start=42,duration=6",
    "baro-step:start=56,duration=60,height=12",
)
LONG = 66.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return a flight with a glitch, an outage and a barometer that jumps."""
    folder = tmp_path_factory.mktemp("act")
    faults = [fault.parse(one) for one in WRONG]
    return fly(folder, Kind.PX4, CONFIG, faults=faults, duration=LONG)


def texts(flown):
    """Return what the pilot reads, without the sender."""
    said = (one.text.rstrip(b"\0").decode() for one in flown.of("STATUSTEXT"))
    return [one.removeprefix("Companion: ") for one in said]


def test_the_pilot_reads_what_is_wrong_and_that_it_is_over(flown):
    read = texts(flown)
    glitch = read.index("GNSS 60 m off, corrected")
    # a busy machine may lose samples in the outage, which is told then
    lost = next(k for k, one in enumerate(read) if one.endswith(", dead reckoning"))
    # the daemon's clock is slower than the flight's: what has to last may come later
    assert read.index("GNSS right again") > glitch
    assert glitch < lost < max(k for k, one in enumerate(read) if one == "estimate OK")
    (baro,) = [one for one in read if one.startswith("barometer")]
    assert re.fullmatch(r"barometer 1[123] m off, corrected", baro)
    assert not [one for one in read if one.startswith(("degraded", "estimate invalid"))]


def test_the_receiver_is_called_false_and_right_again(flown):
    states = [(m.raim_state, m.spoofing_state) for m in flown.of("GNSS_INTEGRITY")]
    assert set(states[:-1]) == {(3, 3)}
    assert states[-1] == (2, 0)
    glitch = [m for m in flown.of("ESTIMATOR_STATUS") if m.flags & 1024]
    assert 6 <= len(glitch) <= 14


def test_odometry_does_not_follow_and_says_so(flown):
    sent = flown.of("ODOMETRY")
    assert sum(m.quality == 100 for m in sent) > 0.8 * len(sent)
    steps = [
        np.hypot(b.x - a.x, b.y - a.y)
        for a, b in itertools.pairwise(sent)
        if b.time_usec - a.time_usec < 100_000
    ]
    assert max(steps) < 10.0  # of the 60 m of the glitch nothing comes through


def test_a_replay_of_it_sends_the_same(flown):
    """Rule 38: live is replay, to the bit."""
    names = ("ODOMETRY", "ESTIMATOR_STATUS", "GNSS_INTEGRITY", "GPS_GLOBAL_ORIGIN")
    assert_a_replay_sends_the_same(flown.record, *names)


def test_what_is_wrong_is_in_a_converted_file_too(flown):
    report = json.loads(flown.record.convert(".csv").with_suffix(".csv.json").read_text())
    kinds = [one["kind"] for one in report["faults"]]
    assert kinds[0] == "position_step"
    assert "baro_step" in kinds


def test_over_a_bad_wire_it_is_the_same_too(tmp_path):
    """Frames that are lost, doubled and swapped, and late fixes: the same bits (rule 38)."""
    port = free_port()
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    with Daemon(tmp_path, *options, config=CONFIG + "http: {port: 0}\n") as daemon:
        daemon.wait_for(": open")
        fly_over(
            f"udpout:127.0.0.1:{port}",
            plan(120.0, boot=2.0, skip=12.0),
            Kind.PX4,
            3,
            12.0,
            lambda wire: wire.count[ODOMETRY] > 200,
        )
        assert daemon.stop() == 0
    record = Record(tmp_path / "flight.tlog", daemon.config)
    assert len(assert_same_as_its_estimates(record)) > 200
    assert_same_as_its_messages(record)


def test_its_memory_is_bounded_and_its_status_has_the_protection_level(tmp_path):
    port, http_port = free_port(), free_port(socket.SOCK_STREAM)
    config = f"{CONFIG}http: {{port: {http_port}}}\n"
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{port}", config=config) as daemon:
        daemon.wait_for(f"Status on http://127.0.0.1:{http_port}/")
        fly_over(f"udpout:127.0.0.1:{port}", plan(20.0, boot=20.0), Kind.PX4)
        data = json.loads(ask(f"http://127.0.0.1:{http_port}", "/status")[2])
    estimator = data["estimator"]
    assert 0.0 < estimator["protection_horizontal"] < 20.0
    assert estimator["wrong"] == estimator["suspected"] == []
    # the hypotheses of each snapshot of the window, beside what a daemon without them needs
    assert 20.0 < data["process"]["rss_mb"] < 200.0
