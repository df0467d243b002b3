"""The habits of ArduPilot."""

import itertools

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse
from sim_autopilot.loop import Bench, StreamRequester
from tests.sim.imitated import FULL, START, cycles, flown, planned, run, stamps
from tests.sim.wire import US, ask, command, named, read


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
    bench = Bench(
        planned("ardupilot"), StreamRequester({"GPS_RAW_INT": 4.9}), personality=parse("ardupilot")
    )
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
    messages, _ = run(autopilot, cycles("ardupilot")[:1200])
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
    messages, _ = run(autopilot, cycles("ardupilot")[:1600])
    assert len(named(messages, "RAW_IMU")) / 4.0 == pytest.approx(40, abs=2)
