"""GNSS_INTEGRITY: the ground station is told that the receiver was found to be wrong."""

import itertools
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import development

from ekf_companion.config.config import Config
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink import encode
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.config import ImuConfig, SimConfig
from sim_autopilot.faults import fault
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench
from sim_autopilot.personality import Kind

OK, FAILED, DETECTED = 2, 3, 3
SECOND_NS = 1_000_000_000


class Tap:
    """A companion, and what it says, with the time."""

    def __init__(self, config=None):
        self.companion = Companion(config or Config())
        self.said = []

    def receive(self, data, now_ns):
        self.companion.receive(data, now_ns)

    def tick(self, now_ns):
        self.companion.tick(now_ns)
        self.now_ns = now_ns

    def data_to_send(self):
        data = self.companion.data_to_send()
        self.said += [(self.now_ns, frame) for one in data for frame in Splitter().feed(one)]
        return data

    def of(self, name):
        return [(t, unpack(frame)) for t, frame in self.said if frame.message_id == IDS[name]]


def flown(*faults, kind=Kind.PX4, weigh="off"):
    flight = Flight.plan("hover", SimConfig(imu=ImuConfig(rate=100.0)), duration=40.0)
    tap = Tap(replace(Config(), weigh_faults=weigh))
    Bench(flight, tap, personality=kind, faults=[fault.parse(one) for one in faults]).run()
    return tap.of("GNSS_INTEGRITY")


BOTH = pytest.mark.parametrize("weigh", ["off", "act"])


@BOTH
@pytest.mark.parametrize("kind", list(Kind))
def test_of_a_receiver_that_is_right_nothing_is_said(kind, weigh):
    assert not flown(kind=kind, weigh=weigh)


@BOTH
@pytest.mark.parametrize("kind", list(Kind))
def test_a_false_position_is_told_once_a_second_and_its_end_once(kind, weigh):
    found = flown("gnss-jump:start=15,duration=10,east=80", kind=kind, weigh=weigh)
    states = [(m.raim_state, m.spoofing_state) for _, m in found]
    assert (FAILED, DETECTED) in states
    assert states[-1] == (OK, 0)
    assert states.count((OK, 0)) == 1
    times = [t for t, _ in found]
    assert 6 <= len(found) <= 20
    assert all(b - a >= 0.9 * SECOND_NS for a, b in itertools.pairwise(times))
    assert {(m.id, m.jamming_state, m.authentication_state) for _, m in found} == {(0, 0, 0)}


@BOTH
def test_a_receiver_that_is_silent_is_no_false_one(weigh):
    assert not flown("gnss-outage:start=15,duration=10", weigh=weigh)


def test_pymavlink_reads_it_as_its_own_definition_says():
    payload = encode.gnss_integrity(1, is_caught=True, is_place_false=False)
    frame = Sender(1, 194).frame("GNSS_INTEGRITY", payload)
    m = development.MAVLink(None).decode(bytearray(frame))
    assert (m.get_type(), m.id, m.raim_state, m.spoofing_state) == ("GNSS_INTEGRITY", 1, 3, 0)
    assert (m.raim_hfom, m.raim_vfom) == (0xFFFF, 0xFFFF)
    unknown = (m.corrections_quality, m.system_status_summary, m.gnss_signal_quality)
    assert (*unknown, m.post_processing_quality) == (255, 255, 255, 255)
