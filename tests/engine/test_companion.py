"""Session and pipeline joined, without a socket and without a clock."""

import itertools
import logging
from dataclasses import replace

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig, OdometryConfig, OutputConfig
from ekf_companion.core.settings.settings import GateSettings
from ekf_companion.engine.announcer import SILENCE_NS
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import Sender
from tests.engine.conversation import SECOND_NS, STREAMING, converse, cycles, messages, named


@pytest.mark.parametrize(
    "without",
    [
        ("GPS_RAW_INT", "GLOBAL_POSITION_INT"),
        ("HIGHRES_IMU",),
        ("HEARTBEAT",),
    ],
)
def test_nothing_is_estimated_where_something_is_missing(without):
    said = converse(Companion(Config()), cycles(4.0, without=without))
    assert named("HEARTBEAT", said)
    assert not named("ODOMETRY", said)
    assert not named("ESTIMATOR_STATUS", said)


def test_a_flight_is_answered_at_the_rates_of_its_stamps():
    odometry = OdometryConfig(mode="always", rate=25.0, frame="LOCAL_NED")
    config = Config(output=OutputConfig(odometry=odometry))
    said = converse(Companion(config), cycles(5.0))
    odometry = named("ODOMETRY", said)
    assert {m.frame_id for m in odometry} == {1}
    stamps = [m.time_usec for m in odometry]
    assert {after - before for before, after in itertools.pairwise(stamps)} == {40_000}
    status = [m.time_usec for m in named("ESTIMATOR_STATUS", said)]
    assert {after - before for before, after in itertools.pairwise(status)} == {1_000_000}
    origins = [m.time_usec for m in named("GPS_GLOBAL_ORIGIN", said)]
    assert origins[0] == stamps[0], "the first estimate is about an origin that nobody was told"
    assert origins[1:] == status
    names = [one.name for one in said]
    assert names.index("GPS_GLOBAL_ORIGIN") < names.index("ODOMETRY")


def test_an_estimate_that_was_never_valid_is_not_sent():
    config = replace(STREAMING, gate=GateSettings(limit_position=1e-3))
    said = converse(Companion(config), cycles(4.0))
    assert not named("ODOMETRY", said)
    assert {m.flags for m in named("ESTIMATOR_STATUS", said)} == {1}  # attitude
    assert named("HEARTBEAT", said)[-1].system_status == 5  # critical


def test_the_bytes_may_come_in_any_pieces():
    pieces = b"".join(data for _, data in cycles(4.0))
    whole, torn = Companion(STREAMING), Companion(STREAMING)
    whole.receive(pieces, 0)
    for start in range(0, len(pieces), 101):
        torn.receive(pieces[start : start + 101], 0)
    odometry = named("ODOMETRY", messages(whole))
    assert odometry
    assert odometry == named("ODOMETRY", messages(torn))


def test_an_autopilot_that_falls_silent_is_missed_once(caplog):
    caplog.set_level(logging.INFO)
    companion = Companion(Config())
    last_ns = [t_ns for t_ns, data in cycles(1.5) if not companion.receive(data, t_ns)][-1]
    for k in range(80):
        companion.tick(last_ns + k * SECOND_NS // 10)
    assert caplog.text.count("Autopilot found: system 1, component 1, px4") == 1
    assert caplog.text.count("Autopilot lost") == 1


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "Nothing heard for 10 s; check the wire"),
        (b"\x55" * 100, "No heartbeat of an autopilot in 100 bytes; check the baud rate"),
    ],
)
def test_an_autopilot_that_is_never_heard_is_missed_once(caplog, data, sentence):
    companion = Companion(Config())
    companion.tick(0)
    companion.receive(data, 0)
    companion.tick(SILENCE_NS - 1)
    assert caplog.text == ""
    companion.tick(SILENCE_NS)
    companion.tick(2 * SILENCE_NS)
    assert caplog.text.count(sentence) == 1


def test_an_autopilot_that_is_heard_is_not_called_silent(caplog):
    converse(Companion(Config()), cycles(10.5))
    assert "heard" not in caplog.text


@pytest.mark.parametrize(
    ("answer", "cause"),
    [
        (None, "it answers none of our requests, so it does not hear us: check our TX wire"),
        (2, "requests: HIGHRES_IMU: denied, RAW_IMU: denied, "),
        (0, "requests: HIGHRES_IMU: accepted, SCALED_IMU2: accepted"),
    ],
)
def test_samples_of_an_autopilot_that_never_come_are_missed_once(caplog, answer, cause):
    companion, autopilot = Companion(Config()), Sender(1, 1)
    for step in range(300):
        now_ns = step * SECOND_NS // 10
        data = b"" if step % 10 else autopilot.message("HEARTBEAT", type=2, autopilot=3)
        companion.receive(data, now_ns)
        companion.tick(now_ns)
        for command in named("COMMAND_LONG", messages(companion)) if answer is not None else ():
            ack = autopilot.message("COMMAND_ACK", command=command.command, result=answer)
            companion.receive(ack, now_ns)
        if step == 99:
            assert "No inertial sample" not in caplog.text
    assert caplog.text.count(f"No inertial sample of the autopilot has come in 10 s: {cause}") == 1
    assert "fills the link" not in caplog.text


def test_a_reboot_is_said_and_the_estimate_begins_anew(caplog):
    companion = Companion(STREAMING)
    said = converse(companion, cycles(4.0))
    assert named("ODOMETRY", said)
    # The same stamps again, of other samples: four seconds back
    again = converse(companion, cycles(0.8, seed=2))
    assert caplog.text.count("Autopilot rebooted") == 1
    assert not named("ODOMETRY", again)
    assert {m.system_status for m in named("HEARTBEAT", again)} <= {2, 4}
    assert named("COMMAND_LONG", again)


def test_a_heartbeat_says_no_more_how_an_old_estimate_was():
    """Two seconds after the last inertial sample; and again how it is, once they come again."""
    flight = list(cycles(12.0))
    companion, half = Companion(STREAMING), len(flight) // 2
    assert named("HEARTBEAT", converse(companion, flight[:half]))[-1].custom_mode == 3
    last_ns, said = flight[half - 1][0], []
    for k in range(1, 60):
        companion.tick(last_ns + k * SECOND_NS // 10)
        said += messages(companion)
    assert [m.custom_mode for m in named("HEARTBEAT", said)][-3:] == [0, 0, 0]
    later = [(t_ns + SECOND_NS, data) for t_ns, data in flight[half:]]
    assert named("HEARTBEAT", converse(companion, later))[-1].custom_mode in (3, 4)


def test_whom_nobody_lets_in_is_missed_for_that_reason(caplog):
    companion = Companion(Config(link=LinkConfig(allow_systems=[9])))
    for t_ns, data in cycles(1.0):
        companion.receive(data, t_ns)
        companion.tick(t_ns)
    companion.tick(t_ns + SILENCE_NS)
    assert "frames: system is not in link.allow_systems; link.allow_systems, link" in caplog.text


def test_the_last_heartbeat_says_goodbye():
    companion = Companion(Config())
    companion.close(0)
    (last,) = messages(companion)
    assert (last.name, last.fields.system_status) == ("HEARTBEAT", 7)
