import dataclasses
import struct

import pytest

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from sim_autopilot.autopilot import Autopilot, Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

CONFIG = SimConfig()
US, THEM = (1, 194), (1, 1)


@pytest.fixture(scope="module")
def cycles():
    return list(Flight.plan("figure-eight", CONFIG, duration=9.0).cycles())


def sent(autopilot):
    """Return name and fields of all messages to be sent."""
    frames = Splitter().feed(b"".join(autopilot.data_to_send()))
    return [(LAYOUTS[frame.message_id].name, unpack(frame)) for frame in frames]


def flown(autopilot, cycles):
    for cycle in cycles:
        autopilot.cycle(cycle)
    return sent(autopilot)


def named(messages, name):
    return [fields for is_name, fields in messages if is_name == name]


def command(number, *parameters, target=THEM):
    values = {f"param{i}": value for i, value in enumerate(parameters, 1)}
    return Sender(*US).message(
        "COMMAND_LONG",
        command=number,
        target_system=target[0],
        target_component=target[1],
        **values,
    )


def test_messages_come_at_their_set_rates(cycles):
    messages = flown(Autopilot(CONFIG), cycles)
    counts = {name: len(named(messages, name)) for name in dict(messages)}
    assert counts == {
        "HEARTBEAT": 9,
        "HIGHRES_IMU": 2250,
        "GPS_RAW_INT": 45,
        "ATTITUDE": 450,
        "GLOBAL_POSITION_INT": 90,
        "LOCAL_POSITION_NED": 90,
        "SIM_STATE": 225,
        "SYSTEM_TIME": 9,
        "EXTENDED_SYS_STATE": 18,
        "GPS_GLOBAL_ORIGIN": 9,
        "TIMESYNC": 90,
    }


def test_imu_fields_carry_the_samples_and_say_what_is_new(cycles):
    messages = named(flown(Autopilot(CONFIG), cycles), "HIGHRES_IMU")
    assert [m.time_usec for m in messages] == [20_004_000 + 4000 * k for k in range(2250)]
    for message, cycle in zip(messages, cycles, strict=True):
        assert (message.xgyro, message.ygyro, message.zgyro) == pytest.approx(
            cycle.gyro_b, rel=1e-6
        )
        assert (message.xacc, message.yacc, message.zacc) == pytest.approx(cycle.accel_b, rel=1e-6)
        assert message.fields_updated & 0x3F == 0x3F
        assert bool(message.fields_updated & 64) == (cycle.mag_b is not None)
        assert bool(message.fields_updated & 512) == (cycle.baro is not None)
    assert sum(bool(m.fields_updated & 64) for m in messages) == 450
    assert sum(bool(m.fields_updated & 512) for m in messages) == 225


def test_a_slower_imu_stream_still_announces_every_compass_sample_it_can(cycles):
    autopilot = Autopilot(CONFIG)
    autopilot.receive(command(511, IDS["HIGHRES_IMU"], 100_000), now_ns=0)
    messages = named(flown(autopilot, cycles), "HIGHRES_IMU")
    assert len(messages) == 90
    assert all(m.fields_updated & 64 for m in messages[1:])


def test_a_fix_says_where_it_was_and_how_good_it_is(cycles):
    messages = named(flown(Autopilot(CONFIG), cycles), "GPS_RAW_INT")
    fixes = [cycle.fix for cycle in cycles if cycle.fix is not None]
    assert [m.time_usec for m in messages] == [20_200_000 + 200_000 * k for k in range(45)]
    assert [m.lat for m in messages] == [round(fix.lat * 57.29577951308232 * 1e7) for fix in fixes]
    assert {(m.h_acc, m.v_acc, m.vel_acc, m.fix_type, m.yaw) for m in messages} == {
        (1000, 1500, 100, 3, 0)
    }
    assert all(0 <= m.cog < 36000 for m in messages)


def test_two_antennas_report_the_nose_and_north_is_not_zero():
    config = dataclasses.replace(CONFIG, gnss=dataclasses.replace(CONFIG.gnss, yaw=True))
    flight = Flight.plan("static", config, duration=3.0)
    yaws = [m.yaw for m in named(flown(Autopilot(config), flight.cycles()), "GPS_RAW_INT")]
    assert all(2500 < yaw < 4500 for yaw in yaws)  # 35 degrees, sigma 2
    cycle = next(c for c in flight.cycles() if c.fix is not None)
    autopilot = Autopilot(config)
    autopilot.cycle(cycle._replace(fix=cycle.fix._replace(yaw=0.0)))
    assert named(sent(autopilot), "GPS_RAW_INT")[0].yaw == 36000


def test_an_interval_is_set_cleared_restored_and_acknowledged(cycles):
    autopilot = Autopilot(CONFIG)
    number = IDS["ATTITUDE"]
    for interval, count in ((100_000, 90), (-1, 0), (0, 450)):
        autopilot.receive(command(511, number, interval), now_ns=0)
        messages = flown(autopilot, cycles)
        (ack,) = named(messages, "COMMAND_ACK")
        assert (ack.command, ack.result) == (511, 0)
        assert (ack.target_system, ack.target_component) == US
        assert len(named(messages, "ATTITUDE")) == count


@pytest.mark.parametrize(("kind", "result"), [(Kind.PX4, 4), (Kind.ARDUPILOT, 2)])
def test_a_stream_that_it_does_not_have_is_refused(kind, result):
    autopilot = Autopilot(CONFIG, kind)
    autopilot.receive(command(511, IDS["ODOMETRY"], 20_000), now_ns=0)
    assert named(sent(autopilot), "COMMAND_ACK")[0].result == result


def test_a_message_is_sent_once_on_request(cycles):
    autopilot = Autopilot(CONFIG)
    flown(autopilot, cycles[:1])
    autopilot.receive(command(512, IDS["AUTOPILOT_VERSION"]), now_ns=0)
    autopilot.receive(command(512, IDS["SYSTEM_TIME"]), now_ns=0)
    autopilot.receive(command(512, IDS["ODOMETRY"]), now_ns=0)
    autopilot.receive(command(400, 1.0), now_ns=0)
    messages = sent(autopilot)
    assert [name for name, _ in messages] == [
        "AUTOPILOT_VERSION",
        "COMMAND_ACK",
        "SYSTEM_TIME",
        "COMMAND_ACK",
        "COMMAND_ACK",
        "COMMAND_ACK",
    ]
    assert [ack.result for ack in named(messages, "COMMAND_ACK")] == [0, 0, 3, 3]


def test_what_is_meant_for_others_is_left_alone():
    autopilot = Autopilot(CONFIG)
    autopilot.receive(command(511, IDS["ATTITUDE"], 1000, target=(2, 1)), now_ns=0)
    autopilot.receive(command(511, IDS["ATTITUDE"], 1000, target=(1, 100)), now_ns=0)
    assert sent(autopilot) == []


def test_a_time_request_is_answered_with_its_own_stamp_and_the_time():
    autopilot = Autopilot(CONFIG)
    autopilot.receive(Sender(*US).message("TIMESYNC", tc1=0, ts1=123456789012), now_ns=777)
    ((name, reply),) = sent(autopilot)
    assert (name, reply.tc1, reply.ts1) == ("TIMESYNC", 777, 123456789012)
    assert (reply.target_system, reply.target_component) == US


def test_its_own_time_requests_measure_the_round_trip(cycles):
    autopilot = Autopilot(CONFIG)
    request = named(flown(autopilot, cycles[:1]), "TIMESYNC")[0]
    answer = Sender(*US).message("TIMESYNC", tc1=5, ts1=request.ts1)
    autopilot.receive(answer, now_ns=request.ts1 + 300)
    assert autopilot.round_trips_ns == [300]
    assert named(sent(autopilot), "TIMESYNC") == []


def test_parameters_are_read_and_set_as_each_autopilot_encodes_them():
    for kind, name in ((Kind.PX4, b"EKF2_EV_CTRL"), (Kind.ARDUPILOT, b"VISO_TYPE")):
        autopilot = Autopilot(CONFIG, kind)
        wire = struct.unpack("<f", struct.pack("<i", 15))[0] if kind is Kind.PX4 else 15.0
        us = Sender(*US)
        data = us.message("PARAM_REQUEST_READ", param_id=name, param_index=-1)
        data += us.message("PARAM_SET", param_id=name, param_value=wire, param_type=6)
        data += us.message("PARAM_REQUEST_READ", param_id=b"NO_SUCH", param_index=-1)
        autopilot.receive(data, now_ns=0)
        before, after = (value for _, value in sent(autopilot))
        assert (before.param_id, before.param_value) == (name, 0.0)
        assert (after.param_id, after.param_value) == (name, wire)
        assert autopilot.parameters[name.decode()] == 15


def test_it_is_armed_before_it_leaves_the_ground(cycles):
    armed = next(cycle.t_ns for cycle in cycles if cycle.is_armed)
    flying = next(cycle.t_ns for cycle in cycles if not cycle.is_landed)
    assert not cycles[0].is_armed
    assert flying - armed == 1_000_000_000
    beats = named(flown(Autopilot(CONFIG, Kind.ARDUPILOT), cycles), "HEARTBEAT")
    assert [bool(beat.base_mode & 128) for beat in beats] == [False] * 5 + [True] * 4
    assert {(beat.autopilot, beat.type) for beat in beats} == {(3, 2)}


def test_a_flight_repeats_bit_by_bit_and_another_seed_differs():
    def frames(seed):
        autopilot = Autopilot(CONFIG)
        for cycle in Flight.plan("hover", CONFIG, seed=seed, duration=3.0).cycles():
            autopilot.cycle(cycle)
        return b"".join(autopilot.data_to_send())

    assert frames(4) == frames(4)
    assert frames(4) != frames(5)
