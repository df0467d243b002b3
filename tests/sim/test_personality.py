import dataclasses
import functools
import itertools
import math
from collections import Counter

import numpy as np
import pytest

from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from ekf_companion.nav.earth import pressure_altitude
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import parse as fault
from sim_autopilot.firmware import PERSONALITIES, parse
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Asker, Bench
from sim_autopilot.reception import sentence
from tests.sim.wire import US, ask, command, named, read

START = 15.0
"""Seconds into the scenario at which the flights of these tests begin: in motion."""


@functools.cache
def planned(name, duration=6.0, quiet=False, rate=None):
    """Give a flight that suits a personality."""
    numbers = PERSONALITIES[name].suited(SimConfig())
    imu = {} if rate is None else {"rate": rate}
    if quiet:
        imu |= {"gyro_noise": 0.0, "gyro_bias_instability": 0.0, "gyro_bias_start": 0.0}
    numbers = dataclasses.replace(numbers, imu=dataclasses.replace(numbers.imu, **imu))
    return Flight.plan("figure-eight", numbers, duration=duration, skip=START)


@functools.cache
def cycles(name, duration=6.0):
    return list(planned(name, duration).cycles())


@functools.cache
def flown(text, rates=(), duration=6.0, faults=(), rate=None):
    """Give what an autopilot says that is asked for some messages, and the bench."""
    personality = parse(text)
    asker = Asker(dict(rates)) if rates else None
    flight = planned(personality.name, duration, rate=rate)
    bench = Bench(flight, asker, personality=personality, faults=[fault(f) for f in faults])
    return read(frame for _, frame in bench.frames()), bench


def heard(autopilot, cycles):
    """Give what it says in some cycles."""
    frames = []
    for cycle in cycles:
        autopilot.cycle(cycle)
        frames += autopilot.data_to_send()
    return read(frames), sum(map(len, frames))


def stamps(messages):
    return np.array([message.time_usec for message in messages])


# PX4

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
    messages, _ = heard(autopilot, cycles("px4")[:500])
    assert len(named(messages, "HIGHRES_IMU")) == pytest.approx(2 * given, abs=1)


def test_px4_slows_its_streams_down_without_a_word_when_the_link_is_too_slow():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0,MAV_1_RATE=9000"))
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == 0  # nevertheless
    messages, size = heard(autopilot, cycles("px4"))
    assert 20.0 < len(named(messages, "HIGHRES_IMU")) / 6.0 < 100.0
    assert size / 6.0 < 9000.0 + 400.0  # TIMESYNC is not counted


def test_px4_never_slows_a_stream_below_a_twentieth():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0,MAV_1_RATE=100"))
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    messages, _ = heard(autopilot, cycles("px4"))
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


def test_px4_targets_its_time_requests_and_an_old_one_does_not():
    for name, target in (("px4", US), ("px4-old", (0, 0)), ("px4-1.13", (0, 0))):
        autopilot = Autopilot(SimConfig(), personality=parse(name))
        autopilot.receive(Sender(*US).message("HEARTBEAT", type=18, autopilot=8), now_ns=0)
        autopilot.receive(Sender(*US).message("TIMESYNC", tc1=0, ts1=5), now_ns=7)
        autopilot.cycle(cycles("px4")[0])
        answer, request = named(read(autopilot.data_to_send()), "TIMESYNC")
        assert (answer.tc1, answer.ts1) == (7, 5)
        for one in (answer, request):
            assert (one.target_system, one.target_component) == target


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


def test_the_firmwares_differ_in_what_they_fuse_by_default():
    assert parse("px4").parameters["EKF2_EV_CTRL"] == 0
    assert parse("px4-old").parameters["EKF2_EV_CTRL"] == 15
    assert parse("px4-old").parameters["EKF2_GPS_CTRL"] == 7
    assert "EKF2_EV_CTRL" not in parse("px4-1.13").parameters
    assert parse("px4-1.13:EKF2_AID_MASK=9").parameters["EKF2_AID_MASK"] == 9
    for name in ("ardupilot", "ardupilot-old"):
        assert parse(name).parameters["VISO_TYPE"] == 0
        assert parse(name).parameters["EK3_SRC1_POSXY"] == 3


# ArduPilot

FULL = (
    ("HIGHRES_IMU", 250.0),
    ("GPS_RAW_INT", 10.0),
    ("ATTITUDE", 10.0),
    ("GPS_GLOBAL_ORIGIN", 1.0),
)


def test_ardupilot_says_nothing_but_its_heartbeat_until_it_is_asked():
    messages, _ = flown("ardupilot")
    assert {name for name, _ in messages} == {"HEARTBEAT", "TIMESYNC"}
    assert len(named(messages, "TIMESYNC")) == 1  # every 10 s


def test_ardupilot_stamps_when_it_sends_and_that_is_late_and_uneven():
    messages, bench = flown("ardupilot", FULL, 12.0)
    seen = stamps(named(messages, "HIGHRES_IMU"))
    late = (seen - 20_000_000) % 2500
    assert (np.diff(seen) > 0).all()
    assert 50 < late.mean() < 400
    assert late.max() > 500
    assert len(seen) / 12.0 == pytest.approx(250, abs=3)
    assert bench.flight.config.imu.rate == 400.0


def test_ardupilots_imu_lags_by_its_low_pass():
    flight = planned("ardupilot", 20.0, quiet=True)
    true = flight.trajectory.at(flight.imu.t).gyro_b[:, 1]
    shown = flight.imu.gyro_b[:, 1]
    errors = [np.std(shown[k:] - true[: len(true) - k]) for k in range(12)]
    assert np.argmin(errors) * 2.5 == pytest.approx(11.5, abs=2.0)  # ms, steps of 2.5


def test_ardupilots_magnetometer_is_a_million_times_too_large_and_always_new():
    messages, bench = flown("ardupilot", FULL, 12.0)
    sent = named(messages, "HIGHRES_IMU")
    assert sent[-1].xmag in (bench.flight.mag.mag_b[:, 0] * 1e6).astype(np.float32)
    assert np.hypot(sent[-1].xmag, sent[-1].ymag) > 1e5
    assert all(m.fields_updated & 64 and m.fields_updated & 512 for m in sent)
    assert sum(a.xmag == b.xmag for a, b in itertools.pairwise(sent)) > len(sent) / 2


def test_ardupilots_differential_pressure_is_no_pitot():
    messages, _ = flown("ardupilot", FULL, 12.0)
    sent = named(messages, "HIGHRES_IMU")[20:]
    ground = sent[0].abs_pressure - sent[0].diff_pressure
    for m in sent:
        assert m.diff_pressure == pytest.approx(m.abs_pressure - ground, abs=1e-3)
    assert 900.0 < ground < 1000.0  # hPa


def test_ardupilot_repeats_fixes_that_are_older_than_their_stamp():
    messages, bench = flown("ardupilot", FULL, 12.0)
    sent = [m for m in named(messages, "GPS_RAW_INT") if m.fix_type >= 3]
    assert len(sent) == pytest.approx(118, abs=3)
    assert len({m.time_usec for m in sent}) == pytest.approx(59, abs=2)  # 5 Hz
    assert all(m.time_usec % 1000 == 0 for m in sent)
    assert bench.flight.config.gnss.delay == 0.085


def test_ardupilot_sends_a_fix_up_to_a_fifth_of_a_second_late():
    bench = Bench(planned("ardupilot"), Asker({"GPS_RAW_INT": 4.9}), personality=parse("ardupilot"))
    waits = [
        t_ns * 1e-9 - m.time_usec * 1e-6
        for t_ns, frame in bench.frames()
        for m in named(read([frame]), "GPS_RAW_INT")
        if m.fix_type >= 3
    ]
    assert 0.1 < max(waits) < 0.21


def test_ardupilots_message_before_the_first_fix_is_far_off():
    messages, _ = flown("ardupilot", (("GPS_RAW_INT", 50.0),))
    sent = named(messages, "GPS_RAW_INT")
    first = [m for m in sent if m.fix_type < 3]
    assert first
    for m in first:
        assert abs(m.lat * 1e-7 - 47.3977) * 111.2 == pytest.approx(140, abs=2)  # km
    assert all(abs(m.lat * 1e-7 - 47.3977) < 0.01 for m in sent if m.fix_type >= 3)


@pytest.mark.parametrize(
    ("text", "asked", "result", "given"),
    [
        ("ardupilot", 300, 0, 333.3),
        ("ardupilot", 250, 0, 250.0),
        ("ardupilot", 400, 2, 0.0),
        ("ardupilot:loop_rate=50", 100, 2, 0.0),
        ("ardupilot:loop_rate=50", 40, 0, 40.0),
    ],
)
def test_ardupilots_intervals_are_whole_milliseconds_within_its_loop(text, asked, result, given):
    autopilot = Autopilot(planned("ardupilot").config, personality=parse(text))
    autopilot.receive(ask("RAW_IMU", asked), now_ns=0)
    assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == result
    messages, _ = heard(autopilot, cycles("ardupilot")[:1200])
    assert len(named(messages, "RAW_IMU")) / 3.0 == pytest.approx(given, rel=0.02)


def test_ardupilots_raw_imu_is_whole_milli_g_and_milliradians_cut_off():
    messages, _ = flown("ardupilot:loop_jitter=0", (("RAW_IMU", 333.0),))
    by_time = {cycle.t_ns // 1000: cycle for cycle in cycles("ardupilot")}
    sent = named(messages, "RAW_IMU")
    assert len(sent) > 1500
    for m in sent:
        cycle = by_time[m.time_usec]
        assert m.xgyro == int(cycle.gyro_b[0] * 1e3)
        assert m.zacc == int(cycle.accel_b[2] / 9.80665 * 1e3)


def test_ardupilots_heading_is_magnetic_until_the_origin_is_set():
    messages, bench = flown("ardupilot", FULL, 12.0)
    rows = np.array([(m.time_boot_ms * 1e-3, m.yaw) for m in named(messages, "ATTITUDE")])
    t, yaw = rows.T
    truth = bench.flight.trajectory.at(t - 20.0 + START)
    error = np.degrees(so3.wrap(yaw - truth.euler[:, 2]))
    declination = np.mean(error[t > 28.5]) - np.mean(error[t < 28.0])
    assert declination == pytest.approx(3.6, abs=1.5)  # Zurich, 2026
    origins = stamps(named(messages, "GPS_GLOBAL_ORIGIN")) * 1e-6
    assert len(origins)
    assert origins.min() > 28.0


def test_ardupilot_denies_its_odometry_and_an_old_one_highres_imu_too():
    for name, message in (("ardupilot", "ODOMETRY"), ("ardupilot-old", "HIGHRES_IMU")):
        autopilot = Autopilot(SimConfig(), personality=parse(name))
        autopilot.receive(ask(message, 50), now_ns=0)
        assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == 2


def test_an_old_ardupilot_gives_integers_only_and_part_of_what_is_requested():
    asked = (("HIGHRES_IMU", 250.0), ("SCALED_IMU2", 50.0), ("SCALED_PRESSURE", 10.0))
    messages, bench = flown("ardupilot-old", asked, 3.0)
    assert not named(messages, "HIGHRES_IMU")
    assert len(named(messages, "RAW_IMU")) / 3.0 == pytest.approx(250, abs=5)
    assert len(named(messages, "SCALED_IMU2")) / 3.0 == pytest.approx(50, abs=2)
    assert 900 < named(messages, "SCALED_PRESSURE")[-1].press_abs < 1000
    autopilot = bench.rig.autopilot
    for name, result in (("AUTOPILOT_VERSION", 0), ("SYSTEM_TIME", 3)):
        autopilot.receive(command(512, IDS[name]), now_ns=0)
        assert named(read(autopilot.data_to_send()), "COMMAND_ACK")[0].result == result


def test_a_ground_station_takes_the_rates_back_every_ten_seconds():
    messages, _ = flown("ardupilot-old:gcs_rate=4", (("RAW_IMU", 100.0),), 14.0)
    t = stamps(named(messages, "RAW_IMU")) * 1e-6 - 20.0
    before, _, after = np.histogram(t, [0.0, 9.9, 10.1, 14.1])[0]
    assert before == pytest.approx(9.9 * 100, rel=0.02)
    assert after == pytest.approx(4 * 4, abs=2)


def test_a_group_can_be_asked_for_and_is_held_to_the_loop_without_a_word():
    autopilot = Autopilot(
        planned("ardupilot").config, personality=parse("ardupilot-old:loop_rate=50")
    )
    autopilot.receive(
        Sender(*US).message(
            "REQUEST_DATA_STREAM",
            req_stream_id=1,
            req_message_rate=200,
            start_stop=1,
            target_system=1,
        ),
        now_ns=0,
    )
    messages, _ = heard(autopilot, cycles("ardupilot")[:1600])
    assert len(named(messages, "RAW_IMU")) / 4.0 == pytest.approx(40, abs=2)


# What becomes of ODOMETRY

POSE = {
    "q": (1.0, 0.0, 0.0, 0.0),
    "pose_covariance": (1.0,) * 21,
    "velocity_covariance": (1.0,) * 21,
}


def odometry(**fields):
    said = {"frame_id": 20, "child_frame_id": 12, "estimator_type": 3, **POSE, **fields}
    return Sender(*US).message("ODOMETRY", **said)


@pytest.mark.parametrize("name", ["px4", "px4-old"])
def test_px4_refuses_an_estimator_type_aloud_each_time(name):
    autopilot = Autopilot(SimConfig(), personality=parse(name))
    for k in range(3):
        autopilot.receive(odometry(estimator_type=5, time_usec=k * 33_000), now_ns=0)
    texts = named(read(autopilot.data_to_send()), "STATUSTEXT")
    assert [(m.severity, m.text) for m in texts] == [
        (2, b"ODOMETRY: estimator_type 5 unsupported")
    ] * 3
    said = sentence(autopilot.reception.summary())
    assert said == "odometry: accepted 0, refused 3: estimator_type 5 is refused (3)"


def test_an_old_px4_fuses_beside_gnss_what_a_new_one_does_not():
    for name, fused in (
        ("px4", 0),
        ("px4-old", 9),
        ("px4-1.13", 0),
        ("px4-1.13:EKF2_AID_MASK=9", 9),
    ):
        autopilot = Autopilot(SimConfig(), personality=parse(name))
        for k in range(10):
            autopilot.receive(odometry(time_usec=1000 + k * 33_000), now_ns=0)
        summary = autopilot.reception.summary()
        assert (summary["accepted"], summary["fused"]) == (10, fused)


def test_ardupilot_refuses_without_a_word():
    autopilot = Autopilot(SimConfig(), personality=parse("ardupilot:VISO_TYPE=1"))
    autopilot.receive(odometry(frame_id=1), now_ns=0)
    autopilot.receive(odometry(time_usec=50_000), now_ns=0)
    assert autopilot.data_to_send() == []
    assert sum(autopilot.reception.refused.values()) == 1
    assert autopilot.reception.accepted == 1


def test_reasons_are_counted_under_a_bounded_number_of_names():
    autopilot = Autopilot(SimConfig(), personality=parse("px4-old"))
    t = 0
    for k in range(100):
        t += 500_000 + k * 1000
        autopilot.receive(odometry(time_usec=t), now_ns=0)
    assert len(autopilot.reception.unfused) <= 33


# How one is chosen


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("px5", "no such personality; there are px4, px4-old"),
        ("px4:mising=0.1", "did you mean missing"),
        ("px4:missing=much", "must be a number"),
        ("px4:missing", "is not key=value"),
        ("px4:missing=1,missing=2", "stands twice"),
        ("px4:A_PARAMETER_TOO_LONG=1", "16 letters"),
    ],
)
def test_a_personality_that_cannot_be_meant_is_refused_with_a_remedy(text, words):
    with pytest.raises(ConfigError, match=words):
        parse(text)


def test_the_configuration_goes_before_the_personality():
    config = SimConfig()
    slow = dataclasses.replace(config, imu=dataclasses.replace(config.imu, rate=100.0))
    assert parse("ardupilot").suited(slow).imu.rate == 100.0
    assert parse("ardupilot").suited(config).imu.rate == 400.0
    assert parse("px4").suited(config).gnss.rate == 8.0


@pytest.mark.parametrize("name", list(PERSONALITIES))
def test_the_same_seed_gives_the_same_bytes(name):
    def frames():
        flight = planned.__wrapped__(name, 1.5)
        bench = Bench(flight, Asker(dict(FULL)), personality=PERSONALITIES[name])
        return list(bench.frames())

    assert frames() == frames()


def test_a_rebooted_autopilot_begins_its_numbers_anew():
    autopilot = Autopilot(planned("px4").config, personality=parse("px4:missing=0"))
    autopilot.parameters["EKF2_EV_CTRL"] = 3
    autopilot.receive(ask("HIGHRES_IMU", 250), now_ns=0)
    autopilot.reboot()
    assert autopilot.data_to_send() == []
    messages, _ = heard(autopilot, cycles("px4")[:500])
    assert messages[0][1].sequence == 0
    assert len(named(messages, "HIGHRES_IMU")) == 100  # 50 Hz again
    assert autopilot.parameters["EKF2_EV_CTRL"] == 3
