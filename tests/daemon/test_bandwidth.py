"""Whether a line is as fast as its streams, before they choke it (MAVLINK: streams and baud)."""

import pytest

from ekf_companion.config.config import parse_config
from ekf_companion.daemon.bandwidth import capacity, overloads, size
from ekf_companion.link.address import parse_url
from ekf_companion.mavlink.codec import Sender


def found(url, **sections):
    link = {"url": url, **sections.pop("link", {})}
    return overloads(parse_config({"link": link, **sections}, "x.yaml"))


def test_a_slow_line_is_told_in_both_directions_with_the_keys_to_lower():
    theirs, ours = found("serial:/dev/ttyS1:38400")
    # 250 Hz of 75 bytes, and 10 Hz of 245 bytes
    assert theirs.startswith("serial:/dev/ttyS1:38400: the streams from the autopilot need 2")
    assert "bytes/s, and of this line they should take no more than 2304 (60%)" in theirs
    assert "; lower link.imu_rate, or raise the baud rate at both ends" in theirs
    assert "to the autopilot need 2" in ours
    assert "; lower output.odometry.rate, or raise" in ours


def test_odometry_that_is_sent_less_often_is_not_complained_of():
    """57600 baud carry fifteen a second, and as many are sent."""
    slow = {"link": {"imu_rate": 20.0, "gnss_rate": 5.0, "heading_rate": 2.0, "baro_rate": 5.0}}
    assert found("serial:/dev/ttyS1:57600", **slow) == []


def test_each_direction_is_judged_by_itself():
    slow = {"link": {"imu_rate": 8.0, "gnss_rate": 2.0, "heading_rate": 2.0, "baro_rate": 2.0}}
    (ours,) = found("serial:/dev/ttyS1:38400", **slow)
    assert "to the autopilot" in ours
    assert found("serial:/dev/ttyS1:38400", **slow, output={"odometry": {"rate": 5.0}}) == []
    assert found("serial:/dev/ttyS1:38400", **slow, output={"odometry": {"mode": "never"}}) == []


def test_a_global_position_is_counted_too():
    slow = {"link": {"imu_rate": 8.0, "gnss_rate": 2.0, "heading_rate": 2.0, "baro_rate": 2.0}}
    output = {"odometry": {"rate": 5.0}, "global_position": {"rate": 50.0}}
    (ours,) = found("serial:/dev/ttyS1:38400", **slow, output=output)
    assert "lower output.global_position.rate or output.odometry.rate" in ours


@pytest.mark.parametrize(
    ("url", "carries"),
    [
        ("serial:/dev/ttyS1:57600", 5760.0),
        ("serial:/dev/ttyACM0:57600", None),  # over USB the rate means nothing
        ("tcp:127.0.0.1:5760", None),
        ("udpin:0.0.0.0:14540", None),
    ],
)
def test_what_a_line_carries_is_known_of_a_wire(url, carries):
    assert capacity(parse_url(url)) == carries


@pytest.mark.parametrize(
    "url", ["serial:/dev/ttyACM0:921600", "udpin:0.0.0.0:14540", "tcp:127.0.0.1:5760"]
)
def test_a_fast_line_or_a_network_is_not_complained_of(url):
    assert found(url) == []


def test_the_streams_at_115200_baud_are_too_many_by_the_inertial_samples():
    (words,) = found("serial:/dev/ttyS1:115200", output={"odometry": {"rate": 20.0}})
    assert "lower link.imu_rate" in words


def test_a_signature_takes_its_share():
    assert size("HEARTBEAT", is_signed=False) == len(
        Sender(1, 1).message("HEARTBEAT", type=1, autopilot=1, mavlink_version=3)
    )
    assert size("HEARTBEAT", is_signed=True) == size("HEARTBEAT", is_signed=False) + 13
