"""What a hub sends beside ODOMETRY, over real sockets, and that a replay sends the same."""

from dataclasses import dataclass

import pytest

from ekf_companion.mavlink.codec import unpack
from ekf_companion.mavlink.messages import IDS
from sim_autopilot import fly as live
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig, SpareConfig
from sim_autopilot.faults import fault
from sim_autopilot.firmware import parse
from sim_autopilot.flight import Flight
from tests.daemon.test_daemon import SPEED, SYSTEM, US, Daemon, Record, Until, Wire, free_port
from tests.daemon.waiting import LIMIT

ALONE = SpareConfig()
"""One sensor of each kind."""


@dataclass
class Flown:
    """A flight with a daemon."""

    record: Record
    wire: object
    words: str

    def of(self, name):
        """Return what reached the autopilot of a message."""
        return [unpack(f) for f in self.wire.frames() if f.message_id == IDS[name]]


def fly(folder, kind, config, faults=(), duration=12.0, is_enough=None, spare=ALONE, **parameters):
    """Fly with a real daemon, until it is enough of what was heard, if that is given."""
    port = free_port()
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(folder / "flight.tlog"))
    plan = SimConfig(system_id=SYSTEM, parameters=parameters, spare=spare)
    flight = Flight.plan("figure-eight", plan, duration=duration)

    async def body(link):
        wire = Wire(link, None)
        flown = flight if is_enough is None else Until(flight, wire, 8.0, is_enough)
        await live.fly(flown, wire, personality=kind, faults=faults, speed=SPEED, wait=LIMIT)
        return wire

    with Daemon(folder, *options, config=f"{config}\nhttp: {{port: 0}}\n") as daemon:
        daemon.wait_for(f"udpin:127.0.0.1:{port}: open")
        wire = live.run(live.over(f"udpout:127.0.0.1:{port}", body))
        assert daemon.stop() == 0
        words = daemon.words.read_text()
    return Flown(Record(folder / "flight.tlog", daemon.config), wire, words)


def assert_a_replay_sends_the_same(record, *names):
    """Rule 38: live is replay, to the bit."""
    converted = Record(record.convert(".tlog"), record.config)
    for name in names:
        assert converted.payloads(name) == record.payloads(name) != []


NAMES = {Kind.PX4: "GLOBAL_POSITION_SENSOR", Kind.ARDUPILOT: "COMMAND_INT"}
GIVEN = "output: {global_position: {rate: 5}}"
SLOT = {f"EKF2_AGP{k}_CTRL": 0 for k in range(4)} | {"EKF2_AGP0_ID": 194, "EKF2_AGP0_CTRL": 1}


def test_px4_without_gnss_is_given_our_global_position(tmp_path):
    flown = fly(tmp_path, Kind.PX4, GIVEN, **SLOT, EKF2_GPS_CTRL=0)
    given = flown.of("GLOBAL_POSITION_SENSOR")
    assert len(given) > 20
    assert {(m.target_system, m.id, m.source) for m in given} == {(SYSTEM, US, 6)}
    assert_a_replay_sends_the_same(flown.record, "ODOMETRY", "GLOBAL_POSITION_SENSOR")


@pytest.mark.parametrize("kind", list(Kind))
def test_beside_its_own_gnss_no_autopilot_takes_it(tmp_path, kind):
    flown = fly(tmp_path, kind, GIVEN, **SLOT)
    assert not flown.of("GLOBAL_POSITION_SENSOR")
    if kind is Kind.PX4:
        assert "set EKF2_GPS_CTRL 0" in flown.words
        assert flown.record.of("GLOBAL_POSITION_SENSOR")
    else:
        assert len(flown.of("COMMAND_INT")) > 20
        answers = [m for _, m in flown.record.of("COMMAND_ACK", component=1) if m.command == 43003]
        assert {answer.result for answer in answers} == {4}
    assert_a_replay_sends_the_same(flown.record, "ODOMETRY", NAMES[kind])


@pytest.mark.parametrize(
    ("firmware", "names"),
    [
        ("px4-1.8:EKF2_AID_MASK=24", {"VISION_POSITION_ESTIMATE"}),
        ("ardupilot-4.0", {"VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE"}),
    ],
)
def test_firmware_that_knows_no_odometry_is_sent_what_it_knows(tmp_path, firmware, names):
    always = "output: {odometry: {mode: always, age_limit: 10}}"
    pose = IDS["VISION_POSITION_ESTIMATE"]
    options = {"duration": 600.0, "is_enough": lambda wire: wire.count[pose] > 120}
    flown = fly(tmp_path, parse(firmware), always, **options)
    for name in ("VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE"):
        assert (len(flown.of(name)) > 100) is (name in names)
    # ODOMETRY until its version is known
    before = max((message.time_usec for message in flown.of("ODOMETRY")), default=0)
    assert before < flown.of("VISION_POSITION_ESTIMATE")[0].usec
    assert_a_replay_sends_the_same(flown.record, *names)


@pytest.mark.parametrize("weigh", ["'off'", "act"])
def test_a_receiver_that_is_caught_is_told(tmp_path, weigh):
    jump = fault.parse("gnss-jump:start=12,duration=4,east=80")
    config = f"output: {{odometry: {{age_limit: 10}}}}\nweigh_faults: {weigh}"
    flown = fly(tmp_path, Kind.PX4, config, faults=[jump], duration=20.0)
    states = [(m.raim_state, m.spoofing_state) for m in flown.of("GNSS_INTEGRITY")]
    assert (3, 3) in states
    assert_a_replay_sends_the_same(flown.record, "GNSS_INTEGRITY")
