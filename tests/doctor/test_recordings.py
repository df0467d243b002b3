"""Recordings that begin before the autopilot's heartbeat, or end after it was switched off."""

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig
from ekf_companion.doctor.collector import EvidenceCollector
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Means
from ekf_companion.doctor.stage import Outcome, Stage
from ekf_companion.engine.checkpoint import Clocks
from ekf_companion.engine.companion import Companion
from ekf_companion.engine.warm_start import WarmStart
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.flight import Flight
from tests.doctor.simulated import simulated

SLOW = Config(link=LinkConfig(imu_rate=100.0))
CLOCKS = Clocks(1_800_000_000_000_000_000, 0, bytes(16))
BREAK = 815
"""Turns of the first run: the second begins between two heartbeats."""


def recorded(system_id):
    """Return the stamps and frames that the second of two runs recorded."""
    sim = simulated(system_id=system_id)
    autopilot, companion, record = Autopilot(sim), Companion(SLOW), []
    for number, cycle in enumerate(Flight.plan("hover", sim, duration=16.0).cycles()):
        now_ns = cycle.t_ns
        if number == BREAK:
            clocks = CLOCKS.later(now_ns)
            warm_start = WarmStart(companion.checkpoint(clocks), clocks, now_ns)
            companion = Companion(SLOW, is_recording=True, warm_start=warm_start)
        autopilot.cycle(cycle)
        companion.receive(b"".join(autopilot.data_to_send()), now_ns)
        companion.tick(now_ns)
        autopilot.receive(b"".join(companion.data_to_send()), now_ns)
        record += companion.session.outbox.take_record()
    return record


def diagnosed(record):
    collector = EvidenceCollector(SLOW, Means.RECORDING)
    for stamp_us, raw in record:
        collector.receive(raw, stamp_us * 1000)
        collector.data_to_send(stamp_us * 1000)
    return collector.evidence(record[-1][0] * 1000)


def test_an_autopilot_switched_off_before_the_board_sent_what_it_sent():
    sim = simulated(system_id=1)
    autopilot, companion, record = Autopilot(sim), Companion(SLOW, is_recording=True), []
    for cycle in Flight.plan("hover", sim, duration=10.0).cycles():
        now_ns = cycle.t_ns
        autopilot.cycle(cycle)
        companion.receive(b"".join(autopilot.data_to_send()), now_ns)
        companion.tick(now_ns)
        autopilot.receive(b"".join(companion.data_to_send()), now_ns)
        record += companion.session.outbox.take_record()
    asked = len(record)
    for _ in range(300):
        now_ns += 50_000_000
        companion.tick(now_ns)
        record += companion.session.outbox.take_record()
    said = [frame.message_id for _, raw in record[asked:] for frame in Splitter().feed(raw)]
    assert IDS["COMMAND_LONG"] in said  # it is asked again when it falls silent
    evidence = diagnosed(record)
    assert [f.stage.value for f in diagnose(evidence) if f.outcome is Outcome.FAILED] == []
    assert evidence.messages["HIGHRES_IMU"].rate > 90.0


def test_what_was_answered_before_the_first_heartbeat_is_heard():
    for system_id in (1, 7):
        record = recorded(system_id)
        ids = [frame.message_id for _, raw in record for frame in Splitter().feed(raw)]
        heartbeats = [
            k
            for k, (_, raw) in enumerate(record)
            if raw[5] == system_id and raw[6:10] == b"\1\0\0\0"
        ]
        assert ids.index(IDS["COMMAND_ACK"]) < heartbeats[0]

        evidence = diagnosed(record)
        assert evidence.messages["HIGHRES_IMU"].answer == "accepted"
        assert evidence.messages["HIGHRES_IMU"].asked == 100.0
        assert [f.stage.value for f in diagnose(evidence) if f.outcome is Outcome.FAILED] == []


@pytest.mark.parametrize("begin", [0, 2_000_000])
def test_a_second_path_is_named_and_its_frames_are_not_lost(begin):
    record = recorded(1)
    alone = record[0][0] + begin
    second = [(stamp_us + 400_000, raw) for stamp_us, raw in record if stamp_us >= alone]
    found = diagnosed(sorted([*record, *second], key=lambda one: one[0]))
    (rates,) = (one for one in diagnose(found) if one.stage is Stage.RATES)
    assert any("come by two paths, on one of them 0.4" in one.cause for one in rates.problems)
    # Which of two is late is not known in the first moments
    assert found.frames.lost <= (600 if begin == 0 else 0)
    (rates,) = (one for one in diagnose(diagnosed(record)) if one.stage is Stage.RATES)
    assert not any("two paths" in one.cause for one in rates.problems)
