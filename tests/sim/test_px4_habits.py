"""The habits of PX4."""

import math
from collections import Counter

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.nav.earth import pressure_altitude
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import IDEAL, parse
from tests.sim.imitated import cycles, flown, planned, run, stamps
from tests.sim.wire import US, ask, named, read

HIGH = (("HIGHRES_IMU", 250.0),)


def test_px4_streams_as_its_onboard_mode_does_and_asks_for_the_time_ten_times_a_second():
    messages, _ = flown("px4:missing=0")
    names = Counter(name for name, _ in messages)
    assert names["HIGHRES_IMU"] == 300  # 50 Hz
    assert names["GPS_RAW_INT"] == 48  # 8 Hz
    assert names["TIMESYNC"] == 60
    assert "SIM_STATE" not in names
    assert "RAW_IMU" not in names


@pytest.mark.parametrize(("asked", "given"), [(250, 250), (200, 125), (100, 250 / 3), (60, 50)])
def test_px4_gives_whole_divisions_of_its_rate(asked, given):
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0"))
    autopilot.receive(ask("HIGHRES_IMU", asked), now_ns=0)
    messages, _ = run(autopilot, cycles("px4")[:500])
    assert len(named(messages, "HIGHRES_IMU")) == pytest.approx(2 * given, abs=1)


def test_px4_slows_its_streams_down_without_a_word_when_the_link_is_too_slow():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0,MAV_1_RATE=9000"))
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == 0  # nevertheless
    messages, size = run(autopilot, cycles("px4"))
    assert 20.0 < len(named(messages, "HIGHRES_IMU")) / 6.0 < 100.0
    assert size / 6.0 < 9000.0 + 400.0  # TIMESYNC is not counted


def test_px4_never_slows_a_stream_below_a_twentieth():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0,MAV_1_RATE=100"))
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    messages, _ = run(autopilot, cycles("px4"))
    assert len(named(messages, "HIGHRES_IMU")) == 75  # 12.5 Hz
    assert len(named(messages, "HEARTBEAT")) == 6  # never slowed down


def test_px4_corrects_its_imu_by_bias_estimates_that_step():
    messages, _ = flown("px4:missing=0", HIGH, 8.0)
    raw = {cycle.t_ns // 1000: cycle.gyro_b[0] for cycle in cycles("px4", 8.0)}
    taken = np.array([raw[m.time_usec] - m.xgyro for m in named(messages, "HIGHRES_IMU")])
    steps = np.flatnonzero(np.abs(np.diff(taken)) > 1e-6)
    assert 6 <= len(steps) <= 8  # once a second
    # and comes nearer to the bias
    bias = planned("px4", 8.0).imu.gyro_bias_b[:, 0].mean()
    assert abs(taken[-1] - bias) < 0.6 * abs(bias)


def test_px4_averages_over_one_interval_and_at_a_lower_rate_never_shows_the_others():
    messages, bench = flown(
        "px4:missing=0,bias_step=0", (("HIGHRES_IMU", 125.0),), 1.0, rate=1000.0
    )
    sent, imu = named(messages, "HIGHRES_IMU")[-50:], bench.flight.imu
    zero = bench.flight.first_ns // 1000
    for message in sent:
        last = (message.time_usec - zero) // 1000
        mean = imu.gyro_b[last - 3 : last + 1].mean(axis=0)
        assert (message.xgyro, message.ygyro, message.zgyro) == pytest.approx(mean, abs=1e-6)
    assert set(np.diff(stamps(sent))) == {8000}  # every other interval of 4 ms


def test_px4_leaves_out_one_or_two_samples_in_a_hundred():
    messages, _ = flown("px4", HIGH, 8.0)
    seen = stamps(named(messages, "HIGHRES_IMU"))
    seen = seen[seen > 21_000_000]
    missing = 1.0 - len(seen) / (7.0 * 250)
    assert 0.008 < missing < 0.022


def test_px4_says_pressure_in_pascal_and_repeats_what_is_not_new_with_its_bits_clear():
    messages, bench = flown("px4:missing=0", HIGH, 8.0)
    sent = named(messages, "HIGHRES_IMU")
    alt = pressure_altitude(sent[-1].abs_pressure)
    assert alt == pytest.approx(bench.flight.baro.alt[-1], abs=0.5)
    stale = [m for m in sent if not m.fields_updated & 64]
    assert len(stale) > len(sent) / 2
    assert all(m.xmag != 0.0 for m in stale[20:])


def test_px4_does_not_know_the_time_of_its_first_fixes():
    messages, _ = flown("px4", HIGH, 8.0)
    times = stamps(named(messages, "GPS_RAW_INT"))
    assert list(times[:38]) == [0] * 38
    assert (times[42:] > 20_000_000).all()


def test_px4_marks_a_silent_receiver_once_a_second():
    messages, _ = flown("px4", faults=("gnss-outage:start=1,duration=4",))
    markers = [m for m in named(messages, "GPS_RAW_INT") if m.fix_type == 0]
    assert len(markers) == 4
    for m in markers:
        assert (m.time_usec, m.lat, m.eph, m.vel, m.cog) == (0, 0, 65535, 65535, 65535)
        assert m.satellites_visible == 255


def test_px4_says_no_fix_with_true_coordinates_in_another_outage():
    messages, _ = flown("px4", faults=("gnss-outage:start=1,duration=4,how=nofix",))
    lost = [m for m in named(messages, "GPS_RAW_INT") if m.fix_type == 0]
    assert len(lost) == 32
    assert {round(m.lat * 1e-7, 2) for m in lost} == {47.40}


def time_messages(personality, answers=1):
    """Return answers to our requests, and the autopilot's own request."""
    autopilot = Autopilot(SimConfig(), personality=personality)
    autopilot.receive(Sender(*US).message("HEARTBEAT", type=18, autopilot=8), now_ns=0)
    for k in range(answers):
        autopilot.receive(Sender(*US).message("TIMESYNC", tc1=0, ts1=5 + k), now_ns=7)
    autopilot.cycle(cycles("px4")[0])
    *answered, request = named(read(autopilot.data_to_send()), "TIMESYNC")
    assert [(m.tc1, m.ts1) for m in answered] == [(7, 5 + k) for k in range(answers)]
    return answered, request


def targets(*messages):
    return [(m.target_system, m.target_component) for m in messages]


def test_an_old_px4_sends_its_times_to_everybody():
    for name in ("px4-old", "px4-1.13"):
        (answer,), request = time_messages(parse(name))
        assert targets(answer, request) == [(0, 0), (0, 0)]
    (answer,), _ = time_messages(IDEAL[Kind.PX4])
    assert targets(answer) == [US]


def test_px4_answers_with_target_ids_that_nobody_set():
    """As 1.17 does in its own simulation; only its requests are to everybody."""
    answers, request = time_messages(parse("px4"), 100)
    assert targets(request) == [(0, 0)]
    assert len(set(targets(*answers))) > 90
    assert not {US, (0, 0)} & set(targets(*answers))


def test_px4_sends_its_own_odometry_with_numbers_on_the_diagonal_only():
    sent = named(flown("px4:missing=0")[0], "ODOMETRY")
    assert len(sent) == 167  # 30 Hz of 250 are 27.8
    for m in sent:
        assert (m.estimator_type, m.frame_id, m.child_frame_id) == (8, 1, 12)
        known = [k for k, value in enumerate(m.pose_covariance) if not math.isnan(value)]
        assert known == [0, 6, 11, 15, 18, 20]
        assert abs(1.0 - math.hypot(*m.q)) < 1e-5


@pytest.mark.parametrize("name", ["RAW_IMU", "SIM_STATE"])
def test_px4_fails_to_give_what_it_does_not_have(name):
    autopilot = Autopilot(SimConfig(), personality=parse("px4"))
    autopilot.receive(ask(name, 100), now_ns=0)
    assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == 4
