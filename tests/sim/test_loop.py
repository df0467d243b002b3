"""The bench: an autopilot with its faults, and whoever is at the other end."""

import functools
import time

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.mavlink.codec import Sender
from sim_autopilot.config import SimConfig
from sim_autopilot.episodes import USUAL, episodes, error_series
from sim_autopilot.faults.fault import KINDS, parse
from sim_autopilot.firmware import PERSONALITIES
from sim_autopilot.flight import Flight
from sim_autopilot.loop import Bench, StreamRequester
from sim_autopilot.personality import Kind
from tests.sim.wire import SECOND_NS, ask, named, read

START_NS = 20 * SECOND_NS


@functools.cache
def flight(name=None, duration=12.0, skip=15.0):
    config = SimConfig() if name is None else PERSONALITIES[name].suited(SimConfig())
    return Flight.plan("figure-eight", config, duration=duration, skip=skip)


def bench(*texts, peer=None, name=None, duration=12.0, skip=15.0, **options):
    return Bench(
        flight(name, duration, skip),
        peer,
        personality=Kind.PX4 if name is None else PERSONALITIES[name],
        faults=[parse(text) for text in texts],
        **options,
    )


def seconds(frames, name):
    """Return the arrival (s of flight) and the fields of each message of a name."""
    return [
        ((t_ns - START_NS) * 1e-9, fields)
        for t_ns, frame in frames
        for fields in named(read([frame]), name)
    ]


class Timer:
    """Asks for the time ten times a second, reads and sets a parameter, and asks for a stream."""

    def __init__(self):
        self.answers = []
        """Our time of asking, theirs, and our time of hearing."""
        self.values = []
        self._us = Sender(1, 194)
        self._out = []
        self._next_ns = None

    def receive(self, data, now_ns):
        for name, frame in read([data]):
            if name == "TIMESYNC":
                (sync,) = named([(name, frame)], name)
                if sync.tc1:
                    self.answers.append((sync.ts1, sync.tc1, now_ns))
            elif name == "PARAM_VALUE":
                self.values.append(named([(name, frame)], name)[0].param_value)

    def tick(self, now_ns):
        if self._next_ns is None:
            self._next_ns = now_ns
            self._out += [
                self._us.message("PARAM_SET", param_id=b"VISO_TYPE", param_value=1, param_type=6),
                ask("GPS_RAW_INT", 5),
            ]
        if now_ns >= self._next_ns:
            self._next_ns += SECOND_NS // 10
            self._out.append(self._us.message("TIMESYNC", tc1=0, ts1=now_ns))

    def data_to_send(self):
        out, self._out = self._out, []
        return out


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_same_seed_gives_the_same_bytes_under_every_fault(kind):
    def frames():
        run = bench(f"{kind}:start=0.5,duration=0.7", peer=StreamRequester({"HIGHRES_IMU": 250.0}),
                    name="px4", duration=2.0)  # fmt: skip
        return list(run.frames())

    assert frames() == frames()


def test_a_reboot_is_silence_then_a_clock_from_zero_and_requests_forgotten():
    frames = list(bench("reboot:start=3,duration=2", peer=StreamRequester({"HIGHRES_IMU": 250.0}),
                        name="px4").frames())  # fmt: skip
    t = np.array([(t_ns - START_NS) * 1e-9 for t_ns, _ in frames])
    assert not ((t > 3.0) & (t < 5.0)).any()
    imu = seconds(frames, "HIGHRES_IMU")
    after = [(at, m.time_usec) for at, m in imu if at > 5.0]
    assert after[0][1] * 1e-6 == pytest.approx(2.0, abs=0.05)  # counted from the reboot
    assert all(at - stamp * 1e-6 == pytest.approx(3.0, abs=1e-3) for at, stamp in after)
    assert len(after) == pytest.approx(7 * 50, abs=12)  # the default again: nobody asked anew
    unix = {round(m.time_unix_usec * 1e-6 - at, 1) for at, m in seconds(frames, "SYSTEM_TIME")}
    assert len(unix) == 1  # the world's time goes on
    first = next(frame for t_ns, frame in frames if t_ns >= START_NS + 5 * SECOND_NS)
    assert first[4] == 0  # the sequence begins anew


def test_a_clock_fault_moves_every_stamp_and_nothing_else():
    frames = list(bench("clock-jump:start=4,by=0.5").frames())
    for name in ("HIGHRES_IMU", "GPS_RAW_INT"):
        for at, m in seconds(frames, name):
            assert m.time_usec * 1e-6 - 20.0 - at == pytest.approx(0.5 if at >= 4 else 0, abs=1e-5)
    plain = list(bench().frames())
    assert [t for t, _ in frames] == [t for t, _ in plain]


def test_no_inertial_sample_means_no_inertial_message():
    frames = list(bench("imu-gap:start=4,duration=1").frames())
    t = np.array([at for at, _ in seconds(frames, "HIGHRES_IMU")])
    assert not ((t >= 4.0) & (t < 5.0)).any()
    assert len(t) == 3000 - 250
    assert any(4.0 < at < 5.0 for at, _ in seconds(frames, "ATTITUDE"))


def test_no_number_goes_out_as_one_where_the_message_has_no_other():
    run = bench("imu-nan:start=1,duration=1", peer=StreamRequester({"RAW_IMU": 100.0}),
                name="ardupilot-old", duration=3.0)  # fmt: skip
    inside = [m for at, m in seconds(run.frames(), "RAW_IMU") if 1.1 < at < 1.9]
    assert inside
    assert {(m.xgyro, m.zacc) for m in inside} == {(0, 0)}


def test_the_peer_is_answered_in_the_autopilots_time_over_a_slow_link():
    timer = Timer()
    run = bench(peer=timer, name="ardupilot", latency=0.004, peer_offset_ns=10**12, peer_ppm=50.0)
    frames = list(run.frames())
    assert len(timer.answers) == pytest.approx(119, abs=3)
    for asked, shown, heard in timer.answers:
        assert heard - asked == pytest.approx(8_000_000, abs=4_100_000)  # in turns of the loop
        middle = (asked + heard) / 2 / (1 + 50e-6) - 10**12 / (1 + 50e-6)
        assert shown == pytest.approx(middle, abs=2_100_000)
    assert timer.values == [1.0]
    assert run.rig.autopilot.parameters["VISO_TYPE"] == 1
    assert len(seconds(frames, "GPS_RAW_INT")) > 50


def test_what_the_peer_says_is_lost_too():
    timer = Timer()
    bench("cut:start=2,duration=5,way=in", peer=timer).run()
    hearing = np.array([heard - START_NS for _, _, heard in timer.answers]) * 1e-9
    assert not ((hearing > 2.1) & (hearing < 7.0)).any()
    assert ((hearing > 7.0).sum(), (hearing < 2.0).sum()) == pytest.approx((50, 20), abs=3)


def test_an_asker_is_granted_one_stream_after_the_other_or_the_integers():
    for name, message in (("ardupilot", "HIGHRES_IMU"), ("ardupilot-old", "RAW_IMU")):
        asker = StreamRequester({"HIGHRES_IMU": 100.0, "ATTITUDE": 10.0})
        found = {
            name
            for name, _ in read(f for _, f in bench(peer=asker, name=name, duration=2.0).frames())
        }
        assert {message, "ATTITUDE"} <= found


def test_a_companion_is_scored_fault_by_fault():
    """The estimator's own errors are not judged here, only that they are seen where they are."""
    faults = ["gnss-jump:start=15,duration=2,east=60", "cut:start=20,duration=1"]
    # Unguarded: this firmware fuses ours, and that is what shall be seen
    odometry = OdometryConfig(mode="always")
    peer = Companion(Config(output=OutputConfig(odometry=odometry)))
    run = bench(*faults, peer=peer, name="px4-old", duration=25.0, skip=0.0)
    witness = run.run()
    errors = error_series(witness, run.flight)
    assert (np.diff(errors.t) > 0).all()
    assert errors.size.shape == (len(errors.t), 3)
    quiet = (errors.t > 10.0) & (errors.t < 15.0)
    assert errors.size[quiet, 0].max() < USUAL[0]
    (_, jump), (_, cut) = episodes(errors, [parse(text) for text in faults], USUAL)
    assert jump.count == pytest.approx(60, abs=3)
    assert cut.count <= 2
    assert 0.0 <= cut.recovery < 5.0
    reception = run.rig.autopilot.reception
    assert reception.fused > 400
    assert witness.count == reception.accepted


def test_a_flight_waits_for_nothing(monkeypatch):
    def no_sleep(seconds):
        raise AssertionError(f"a sleep of {seconds} s")

    monkeypatch.setattr(time, "sleep", no_sleep)
    run = bench(peer=Companion(Config()), duration=12.0)
    start = time.process_time()
    run.run()
    assert time.process_time() - start < 12.0  # 0.4 s on an idle machine
