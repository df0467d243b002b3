"""The daemon killed in flight, and started again by what it left on the disk."""

import itertools
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from ekf_companion.engine.warm_start import PACE_NS
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import HomeConfig, SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.fly import Flown, fly, over, run
from tests.daemon.test_daemon import SYSTEM, Daemon, Open, Record, free_port

pytestmark = pytest.mark.campaign

CONFIG = "output: {odometry: {rate: 50, age_limit: 10}}\n"
RUNS = (3.0, 4.5, 4.5)
"""Seconds for which each of three runs of the daemon estimates: killed, stopped, stopped."""
LARGEST = {"off": 20_480, "act": 204_800}
"""Bytes of a checkpoint, at most: with the fault hypotheses it is larger by those."""
BUSY = 15.0
"""Seconds in which a busy machine does what takes a moment."""


class Ear:
    """A link of the fake autopilot that notes when it heard what."""

    def __init__(self, link):
        self.address = link.address
        self.heard = []
        self.send = link.send
        self._link = link

    async def receive(self):
        received = await self._link.receive()
        self.heard.append((time.monotonic(), received.data))
        return received

    def runs(self):
        """Return times and message ids of each run of the daemon: each counts its frames from 0."""
        runs = []
        for heard, data in self.heard:
            for frame in Splitter().feed(data):
                if frame.message_id == IDS["HEARTBEAT"] and frame.sequence == 0:
                    runs.append([])
                runs[-1].append((heard, frame.message_id))
        return [run for run in runs if IDS["ODOMETRY"] in dict(map(reversed, run))]


@dataclass
class Restarted:
    ear: Ear
    flown: Flown
    records: list[Record]
    words: list[str]
    folder: Path
    largest: int
    """Size of a checkpoint."""


@pytest.fixture(scope="module", params=["off", "act"])
def restarted(tmp_path_factory, request):
    """Fly in real time: the two clocks are compared. The second of three runs follows a kill."""
    folder = tmp_path_factory.mktemp("restart")
    port = free_port()
    sim = SimConfig(system_id=SYSTEM, home=replace(HomeConfig(), boot=100.0))
    flight = Open(Flight.plan("figure-eight", sim, duration=240.0, skip=12.0))
    result = []

    async def body(link):
        ear = Ear(link)
        return ear, await fly(flight, ear, personality=Kind.PX4, wait=60.0)

    def take_off():
        result.append(run(over(f"udpin:127.0.0.1:{port}", body)))

    pilot = threading.Thread(target=take_off)
    pilot.start()
    records, words = [], []
    try:
        for number, seconds in enumerate(RUNS):
            own = folder / str(number)
            own.mkdir()
            options = ("--link", f"udpout:127.0.0.1:{port}", "--record", str(own / "flight.tlog"))
            keeping = ("--checkpoint", str(folder / "checkpoint"))
            config = f"{CONFIG}weigh_faults: '{request.param}'\n"
            with Daemon(own, *options, *keeping, config=config) as daemon:
                daemon.wait_for("Estimate is OK" if number == 0 else "Going on from a checkpoint")
                time.sleep(seconds)
                if number > 0:
                    assert daemon.stop() == 0
            records.append(Record(own / "flight.tlog", daemon.config))
            words.append(daemon.words.read_text())
    finally:
        flight.land()
        pilot.join()
    return Restarted(*result[0], records, words, folder, LARGEST[request.param])


def first_of(record, name, component):
    return record.of(name, component=component)[0]


@pytest.mark.parametrize("number", [1, 2])
def test_it_estimates_within_a_second_of_its_first_sample(restarted, number):
    record = restarted.records[number]
    came, sample = first_of(record, "HIGHRES_IMU", 1)
    sent, odometry = first_of(record, "ODOMETRY", 194)
    assert (sent - came) * 1e-6 < BUSY
    # So it was seen from the other end, which knows where to send when it has heard a first word
    heard = restarted.ear.runs()[number]
    answer = next(when for when, message_id in heard if message_id == IDS["ODOMETRY"])
    assert answer - heard[0][0] < BUSY
    # It is the answer to the first fix, which comes five times a second; where a busy machine lets
    # the two clocks look apart, the samples first have to keep pace
    assert 0 <= odometry.time_usec - sample.time_usec < 500_000 + PACE_NS // 1000
    assert odometry.quality >= 50
    words = restarted.words[number]
    assert "Going on from a checkpoint that is" in words
    assert "not used" not in words
    assert "ALIGNING" not in words
    assert words.count(": restart; moved by") == 1


def test_the_first_run_found_nothing_and_aligned(restarted):
    assert "checkpoint" not in restarted.words[0]
    assert "Estimate is ALIGNING" in restarted.words[0]


def test_what_was_lost_is_a_checkpoints_interval_and_the_way_up(restarted):
    """How long a start takes is the machine's; the last checkpoint is no older than a second."""
    for before, after, interval in (
        (restarted.records[0], restarted.records[1], 2.5),
        (restarted.records[1], restarted.records[2], 0.9),
    ):
        last = before.of("HIGHRES_IMU", component=1)[-1][1].time_usec
        first = first_of(after, "HIGHRES_IMU", 1)[1].time_usec
        number = restarted.records.index(after)
        said = restarted.words[number].split("a checkpoint that is ")[1].split(" s old")[0]
        assert 0.0 <= float(said) - (first - last) * 1e-6 + 0.51 < interval + 0.51


def test_the_count_of_resets_moves_on_with_every_restart(restarted):
    counts = [
        [message.reset_counter for _, message in record.of("ODOMETRY")]
        for record in restarted.records
    ]
    for before, after in itertools.pairwise(counts):
        assert (after[0] - before[-1]) % 255 in (
            1,
            2,
        )  # the restart, and the reset by its first fix
    for numbers in counts:
        assert {(after - before) % 255 for before, after in itertools.pairwise(numbers)} <= {0, 1}


def test_the_origin_stays_where_it_was(restarted):
    origins = {
        (message.latitude, message.longitude, message.altitude)
        for record in restarted.records
        for _, message in record.of("GPS_GLOBAL_ORIGIN")
    }
    ((latitude, longitude, _),) = origins
    # It is PX4's own, as it told it before the first ODOMETRY
    home = SimConfig().home
    assert (latitude, longitude) == (round(home.lat * 1e7), round(home.lon * 1e7))


@pytest.mark.parametrize("number", [1, 2])
def test_the_estimate_is_as_far_from_the_truth_as_its_sigma_says_again(restarted, number):
    sent = {message.time_usec for _, message in restarted.records[number].of("ODOMETRY")}
    ours = restarted.flown.witness.estimate()
    keep = np.isin(ours.t_ns // 1000, sorted(sent))
    assert np.count_nonzero(keep) > 0.9 * len(sent)  # a busy machine hears some of them too late
    error = restarted.flown.witness.error(ours)
    # The velocity's sigmas are sent along the body's axes, but are those of the one over ground
    std = np.hstack([ours.std[:, :6], np.tile(ours.std[:, 6:].max(axis=1), (3, 1)).T])
    ratios = (np.hstack([error.pos_n, error.euler, error.vel_n]) / std)[keep]
    # Of nine numbers one is beyond three sigma in every fortieth flight, and beyond four in none
    assert (np.abs(ratios[0]) < 4.0).all()
    assert (np.abs(ratios) < 3.0).mean() > 0.9
    late = keep & (ours.t_ns > ours.t_ns[keep][0] + 2_500_000_000)
    assert np.degrees(np.abs(error.euler[late, :2])).max() < 8.0
    assert np.abs(error.pos_n[late]).max() < 3.0


def test_a_whole_checkpoint_is_left_behind(restarted):
    kept = restarted.folder / "checkpoint"
    assert 3000 < kept.stat().st_size < restarted.largest
    assert not (restarted.folder / "checkpoint.new").exists()


def test_one_that_is_damaged_on_the_disk_is_said_and_stops_nothing(restarted, tmp_path):
    data = bytearray((restarted.folder / "checkpoint").read_bytes())
    data[1000] ^= 1
    (tmp_path / "checkpoint").write_bytes(data)
    options = ("--link", f"udpin:127.0.0.1:{free_port()}")
    with Daemon(tmp_path, *options, "--checkpoint", str(tmp_path / "checkpoint")) as daemon:
        daemon.wait_for(": open")
        assert daemon.stop() == 0
        assert "The checkpoint is not used: its checksum is wrong" in daemon.words.read_text()


def test_a_place_that_there_is_not_is_a_sentence_and_stops_no_flight(tmp_path):
    options = ("--link", f"udpin:127.0.0.1:{free_port()}")
    place = tmp_path / "none" / "checkpoint"
    with Daemon(tmp_path, *options, "--checkpoint", str(place)) as daemon:
        daemon.wait_for(": open")
        daemon.wait_for(f"{place}: No such file or directory; a restart would align anew")
        assert daemon.stop() == 0
