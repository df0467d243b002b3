"""The doctor names who else sends the autopilot poses."""

import pytest

from ekf_companion.config.config import parse_config
from ekf_companion.doctor import peer
from ekf_companion.doctor.collector import EvidenceCollector
from ekf_companion.doctor.evidence import Means
from tests.mavlink.conversation import ARDUPILOT, SECOND, Voice


def judged(*others, name="VISION_POSITION_ESTIMATE", heartbeat=None):
    collector = EvidenceCollector(parse_config({}, "x.yaml"), Means.LISTENING)
    autopilot = Voice(family=ARDUPILOT)
    for k in range(100):
        now_ns = k * SECOND // 20
        if k % 20 == 0:
            collector.receive(autopilot.heartbeat(), now_ns)
        for other in others:
            if heartbeat is not None and k % 20 == 0:
                collector.receive(other.say("HEARTBEAT", **heartbeat), now_ns)
            collector.receive(other.say(name, usec=now_ns // 1000), now_ns)
    return peer.source(collector.evidence(5 * SECOND))


@pytest.mark.parametrize("heartbeat", [None, {"type": 6, "autopilot": 8}])
def test_a_second_source_is_named_and_is_no_ground_station(heartbeat):
    found = judged(Voice(1, 197), heartbeat=heartbeat)
    assert "1/197 sends VISION_POSITION_ESTIMATE" in found.saw
    assert "ground station" not in found.saw
    (trouble,) = found.problems
    assert "System 1, component 197 sends VISION_POSITION_ESTIMATE at 20 Hz" in trouble.cause


def test_without_one_nothing_is_said():
    assert list(judged().problems) == []
