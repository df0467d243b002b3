"""Several inertial units over real sockets: one fails in flight, and a replay does the same."""

import pytest

from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SpareConfig
from sim_autopilot.faults import fault
from tests.daemon.test_hub import assert_a_replay_sends_the_same, fly

CONFIG = """
link: {spare_imu_rate: 125}
output: {odometry: {mode: always, age_limit: 10}}
"""


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("imu-stuck", "stuck"),
        ("imu-gap", "silent"),
        ("imu-step", "off from the others by a step"),
    ],
)
def test_a_unit_that_fails_in_flight_is_left_for_another(tmp_path, kind, why):
    failing = fault.parse(f"{kind}:start=12,duration=99")
    spare = SpareConfig(units=2)
    flown = fly(tmp_path, Kind.ARDUPILOT, CONFIG, faults=[failing], duration=16.0, spare=spare)
    assert f"Inertial sensor 1 is used: 0 is {why}" in flown.words
    last = max(message.time_usec for message in flown.of("ODOMETRY"))
    begin = min(message.time_usec for message in flown.of("ODOMETRY"))
    assert last - begin > 10e6
    assert_a_replay_sends_the_same(flown.record, "ODOMETRY")
