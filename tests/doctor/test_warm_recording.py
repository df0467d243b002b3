"""The recording of a daemon that went on from a checkpoint, and so asked before a heartbeat."""

from ekf_companion.checkpoint import Clocks
from ekf_companion.companion import Companion
from ekf_companion.config import Config, LinkConfig
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Means
from ekf_companion.doctor.finding import Mark
from ekf_companion.doctor.witness import Witness
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.layout import IDS
from ekf_companion.resumption import Resumption
from sim_autopilot.autopilot import Autopilot
from sim_autopilot.flight import Flight
from tests.doctor.patients import simulated

SLOW = Config(link=LinkConfig(imu_rate=100.0))
CLOCKS = Clocks(1_800_000_000_000_000_000, 0, bytes(16))
BREAK = 815
"""Turns of the first run: the second begins between two heartbeats."""


def recorded(system_id):
    """Give the stamps and frames that the second of two runs recorded."""
    sim = simulated(system_id=system_id)
    autopilot, companion, record = Autopilot(sim), Companion(SLOW), []
    for number, cycle in enumerate(Flight.plan("hover", sim, duration=16.0).cycles()):
        now_ns = cycle.t_ns
        if number == BREAK:
            clocks = CLOCKS.later(now_ns)
            resumption = Resumption(companion.checkpoint(clocks), clocks, now_ns)
            companion = Companion(SLOW, is_recording=True, resumption=resumption)
        autopilot.cycle(cycle)
        companion.receive(b"".join(autopilot.data_to_send()), now_ns)
        companion.tick(now_ns)
        autopilot.receive(b"".join(companion.data_to_send()), now_ns)
        record += companion.session.take_record()
    return record


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

        witness = Witness(SLOW, Means.RECORDING)
        for stamp_us, raw in record:
            witness.receive(raw, stamp_us * 1000)
            witness.data_to_send(stamp_us * 1000)
        evidence = witness.evidence(record[-1][0] * 1000)
        assert evidence.messages["HIGHRES_IMU"].answer == "accepted"
        assert evidence.messages["HIGHRES_IMU"].asked == 100.0
        assert [f.stage.value for f in diagnose(evidence) if f.mark is Mark.FAILED] == []
