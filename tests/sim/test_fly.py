import asyncio
import contextlib
import json
import socket
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.errors import CompanionError
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from sim_autopilot.__main__ import app
from sim_autopilot.config import SimConfig
from sim_autopilot.firmware import parse as parse_personality
from sim_autopilot.flight import Flight
from sim_autopilot.fly import Pace, fly, over, play, run
from sim_autopilot.recording import TlogWriter

CONFIG = SimConfig()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Oracle:
    """Answers inertial samples with the truth, as an estimator without error would."""

    def __init__(self, flight, url):
        self.link = Link(parse_url(url))
        self.counts = {}
        self._flight = flight

    async def run(self):
        pump = asyncio.create_task(self.link.run())
        splitter, us = Splitter(), Sender(1, 194)
        try:
            while True:
                data, *_ = await self.link.receive()
                for frame in splitter.feed(data):
                    self.counts[frame.message_id] = self.counts.get(frame.message_id, 0) + 1
                    if frame.message_id == IDS["HEARTBEAT"]:
                        self.link.send(us.message("HEARTBEAT", type=18, autopilot=8))
                        self.link.send(us.message("TIMESYNC", tc1=0, ts1=1))
                        self.link.send(self._origin(us))
                    elif frame.message_id == IDS["HIGHRES_IMU"]:
                        self.link.send(self._odometry(us, unpack(frame).time_usec))
        finally:
            pump.cancel()
            await asyncio.gather(pump, return_exceptions=True)

    def _origin(self, us):
        home = CONFIG.home
        return us.message(
            "GPS_GLOBAL_ORIGIN",
            latitude=round(home.lat * 1e7),
            longitude=round(home.lon * 1e7),
            altitude=round(home.alt * 1e3),
        )

    def _odometry(self, us, time_usec):
        truth = self._flight.truth_at(np.array([time_usec * 1000]))
        x, y, z = truth.pos_n[0]
        vx, vy, vz = so3.rotate(so3.conjugate(truth.q_nb), truth.vel_n)[0]
        return us.message(
            "ODOMETRY",
            time_usec=time_usec,
            frame_id=20,
            child_frame_id=12,
            **{"x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz},
            q=tuple(truth.q_nb[0]),
            reset_counter=1,
        )


def test_a_flight_over_a_socket_is_scored(tmp_path):
    flight = Flight.plan("figure-eight", CONFIG, duration=2.0, skip=14.0)
    port = free_port()
    oracle = Oracle(flight, f"udpin:127.0.0.1:{port}")

    async def both():
        answering = asyncio.create_task(oracle.run())
        try:
            with TlogWriter(tmp_path / "flight.tlog", CONFIG.home.unix) as log:
                flown = await over(
                    f"udpout:127.0.0.1:{port}", lambda link: fly(flight, link, log=log, wait=60.0)
                )
            # A busy machine may read the last of them a moment later
            async with asyncio.timeout(60.0):
                while oracle.counts[IDS["HIGHRES_IMU"]] < 500:
                    await asyncio.wait({answering}, timeout=0.01)
            return flown
        finally:
            answering.cancel()
            await asyncio.gather(answering, return_exceptions=True)

    flown = run(both())
    assert oracle.counts[IDS["HIGHRES_IMU"]] == 500
    assert oracle.counts[IDS["TIMESYNC"]] >= 20  # its own, and its answers
    score = flown.witness.score(after=0.0)
    assert score["odometry"]["scored"] == 500
    assert score["origin"] == "GPS_GLOBAL_ORIGIN"
    assert score["horizontal_m"]["max"] < 1e-4  # float32, and the origin's rounding
    assert score["velocity_mps"]["max"] < 1e-4
    assert 0.0 < score["latency_ms"]["p50"] <= score["latency_ms"]["p99"]
    assert len(flown.pace.late_ns) == 500

    recorded = tlog.read(tmp_path / "flight.tlog")
    ids = recorded.records.all()["message_id"].tolist()
    assert ids.count(IDS["HIGHRES_IMU"]) == ids.count(IDS["ODOMETRY"]) == 500


def test_nobody_answering_is_said_in_a_sentence():
    flight = Flight.plan("static", CONFIG, duration=1.0)
    url = f"udpout:127.0.0.1:{free_port()}"
    with pytest.raises(CompanionError, match="nobody answered"):
        run(over(url, lambda link: fly(flight, link, wait=0.3)))


def test_recorded_frames_are_played_at_their_spacing():
    port = free_port()
    sent = Sender(1, 1)
    asked_ns = []

    def frames():
        for number in range(21):
            asked_ns.append(time.monotonic_ns())  # the frame before has been sent
            yield number * 10_000_000, sent.message("HEARTBEAT", autopilot=12)

    async def both():
        theirs = Link(parse_url(f"udpin:127.0.0.1:{port}"))
        pump = asyncio.create_task(theirs.run())
        try:
            await asyncio.sleep(0)
            count = await over(
                f"udpout:127.0.0.1:{port}", lambda link: play(frames(), link, speed=2.0)
            )
            return count, [await theirs.receive() for _ in range(count)]
        finally:
            pump.cancel()
            await asyncio.gather(pump, return_exceptions=True)

    count, received = run(both())
    assert count == len(received) == 21
    # 10 ms each at twice the speed, and none of them early
    for number, now_ns in enumerate(asked_ns[1:]):
        assert now_ns - asked_ns[0] >= number * 5_000_000


def test_the_autopilots_clock_runs_at_its_speed_from_the_first_time_on():
    begin_ns = time.monotonic_ns()
    pace = Pace(7_000_000_000, speed=2.0)
    end_ns = time.monotonic_ns()
    assert pace.shown_ns(begin_ns) <= 7_000_000_000 <= pace.shown_ns(end_ns)
    assert pace.shown_ns(end_ns + 1_500_000_000) - pace.shown_ns(end_ns) == 3_000_000_000


def test_what_the_autopilot_refused_and_what_went_wrong_is_in_the_score(tmp_path):
    port, score = free_port(), tmp_path / "score.json"
    personality = parse_personality("px4")
    flight = Flight.plan("figure-eight", personality.suited(CONFIG), duration=2.0, skip=14.0)
    oracle = Oracle(flight, f"udpin:127.0.0.1:{port}")

    def answer():
        loop = asyncio.SelectorEventLoop()
        task = loop.create_task(oracle.run())
        loop.call_later(100.0, task.cancel)
        stop.append(lambda: loop.call_soon_threadsafe(task.cancel))
        with contextlib.suppress(asyncio.CancelledError):
            loop.run_until_complete(task)
        loop.close()

    stop = []
    thread = threading.Thread(target=answer)
    thread.start()
    result = CliRunner().invoke(
        app,
        ["fly", "--link", f"udpout:127.0.0.1:{port}", "--skip", "14", "--duration", "2",
         "--personality", "px4", "--score", str(score), "--score-after", "0", "--wait", "60",
         "--fault", "cut:start=0.5,duration=0.5"],
    )  # fmt: skip
    stop[0]()
    thread.join()
    assert result.exit_code == 0, result.output
    found = json.loads(score.read_text())
    assert found["autopilot"]["personality"] == "px4"
    (cut,) = found["faults"]
    assert cut["fault"] == "cut:start=0.5,duration=0.5,way=both"
    assert cut["odometry"] < 20  # of 25
    assert "right again" in result.output
    accepted = found["autopilot"]["accepted"]
    assert 20 <= accepted <= 110  # 50 Hz of two seconds without the cut
    assert f"odometry: accepted {accepted}, refused 0" in result.output
