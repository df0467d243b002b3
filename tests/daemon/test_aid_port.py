"""Poses of others over real sockets: from software of this board, and on the autopilot's link."""

import asyncio
import contextlib
import json
import socket
import threading
import time
import urllib.request

import numpy as np
import pytest

from ekf_companion import Board
from ekf_companion.errors import LinkError
from ekf_companion.link.address import parse_aid, parse_url
from ekf_companion.mavlink.codec import Sender
from sim_autopilot import fly as live
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from tests.daemon.test_daemon import (
    SYSTEM,
    Daemon,
    Open,
    Record,
    assert_same_as_its_messages,
    free_port,
)
from tests.daemon.waiting import LIMIT, wait_until

AGE = 0.06
"""s; of a pose when it is sent."""


@contextlib.contextmanager
def resting(url):
    """Let an autopilot rest until the context ends; yield what puts bytes on its link."""
    flight = Open(Flight.plan("static", SimConfig(system_id=SYSTEM), duration=3600.0))
    links, loops = [], []

    async def body(link):
        links.append(link)
        loops.append(asyncio.get_running_loop())
        await live.fly(flight, link, personality=Kind.ARDUPILOT, wait=LIMIT)

    thread = threading.Thread(target=lambda: live.run(live.over(url, body)))
    thread.start()
    try:
        wait_until(lambda: links and loops)
        yield lambda data: loops[0].call_soon_threadsafe(links[0].send, data)
    finally:
        flight.land()
        thread.join()


def aid_of(port, name="visual_odometry"):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/status", timeout=LIMIT) as answer:
        return json.load(answer)["vehicle"]["aids"].get(name, {})


def places():
    rng = np.random.default_rng(1)
    while True:
        yield np.array([5.0, -6.0, 7.0]) + 0.01 * rng.standard_normal(3)


@pytest.mark.parametrize("way", ["aid port", "link"])
def test_a_pose_is_used_recorded_and_replayed(tmp_path, way):
    port, aid, estimates = free_port(), free_port(), free_port()
    http = free_port(socket.SOCK_STREAM)
    config = (
        f"link: {{aid_url: 'udpin:127.0.0.1:{aid}'}}\nhttp: {{port: {http}}}\n"
        f"output: {{monitors: ['udpout:127.0.0.1:{estimates}']}}\nvisual_odometry: {{use: true}}\n"
    )
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    with Daemon(tmp_path, *options, config=config) as daemon, Board(aid, estimates) as board:
        daemon.wait_for(f"udpin:127.0.0.1:{aid}: open")
        with resting(f"udpout:127.0.0.1:{port}") as put:
            camera, found = Sender(SYSTEM, 197), places()

            def is_used():
                place, now = next(found), time.time_ns()
                if way == "aid port":
                    board.send(t=now * 1e-9 - AGE, position=place, q=(1.0, 0.0, 0.0, 0.0))
                else:
                    pose = dict(zip("xyz", place.tolist(), strict=True), q=(1.0, 0.0, 0.0, 0.0))
                    pose |= {"frame_id": 20, "child_frame_id": 255, "estimator_type": 3}
                    stamp = (now - round(AGE * 1e9)) // 1000
                    put(camera.message("ODOMETRY", **pose, time_usec=stamp))
                time.sleep(0.05)
                one = aid_of(http)
                return one if one.get("state") == "used" else {}

            one = wait_until(is_used)
            estimate = board.read(timeout=LIMIT)
            # What the recording is to hold of ours comes once a second
            for _ in range(60):
                one = is_used() or one
        assert daemon.stop() == 0
    sender = "240/197" if way == "aid port" else f"{SYSTEM}/197"
    assert one["source"].startswith(f"{sender} ODOMETRY")
    assert estimate.quality >= 50
    assert np.abs(estimate.pos_n[:2]).max() < 10.0
    record = Record(tmp_path / "flight.tlog", daemon.config)
    system = 240 if way == "aid port" else SYSTEM
    poses = [f for f in record.frames if f[1:3] == (system, 197)]
    assert len(poses) >= 10
    assert_same_as_its_messages(record)


def test_what_is_travelled_is_used_and_replayed(tmp_path):
    port, aid, http = free_port(), free_port(), free_port(socket.SOCK_STREAM)
    config = f"link: {{aid_url: 'udpin:127.0.0.1:{aid}'}}\nhttp: {{port: {http}}}\n"
    config += "visual_velocity: {use: true}\n"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with Daemon(tmp_path, *options, config=config) as daemon, contextlib.closing(out):
        daemon.wait_for(f"udpin:127.0.0.1:{aid}: open")
        with resting(f"udpout:127.0.0.1:{port}"):
            camera, rng = Sender(240, 197), np.random.default_rng(1)

            def is_used():
                way = {"time_delta_usec": 50_000, "confidence": 80.0}
                way["position_delta"] = (0.001 * rng.standard_normal(3)).tolist()
                stamp = time.time_ns() // 1000 - 20_000
                said = camera.message("VISION_POSITION_DELTA", time_usec=stamp, **way)
                out.sendto(said, ("127.0.0.1", aid))
                time.sleep(0.05)
                one = aid_of(http, "visual_velocity")
                return one if one.get("state") == "used" else {}

            one = wait_until(is_used)
            for _ in range(40):
                is_used()
        assert daemon.stop() == 0
    assert one["source"].startswith("240/197 VISION_POSITION_DELTA")
    assert_same_as_its_messages(Record(tmp_path / "flight.tlog", daemon.config))


def test_where_nothing_of_it_is_used_a_sentence_says_so(tmp_path):
    aid = free_port()
    config = f"link: {{aid_url: 'udpin:127.0.0.1:{aid}'}}\nhttp: {{port: 0}}\n"
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{free_port()}", config=config) as daemon:
        daemon.wait_for("nothing that comes there is used; set visual_odometry.use")
        assert daemon.stop() == 0


def test_of_other_hosts_only_those_that_are_named_are_heard(tmp_path):
    port, aid = free_port(), free_port()
    config = (
        f"link: {{aid_url: 'udpin:0.0.0.0:{aid}', aid_peers: [192.0.2.7]}}\nhttp: {{port: 0}}\n"
        "visual_odometry: {use: true}\n"
    )
    with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{port}", config=config) as daemon:
        daemon.wait_for(f"udpin:0.0.0.0:{aid}: open")
        with Board(aid) as board:
            board.send(position=(1.0, 2.0, 3.0))
            daemon.wait_for("Datagrams from 127.0.0.1")
        assert daemon.stop() == 0


@pytest.mark.parametrize(
    ("url", "peers", "words"),
    [
        ("udpout:127.0.0.1:14560", (), "others send datagrams there; write udpin"),
        ("serial:/dev/ttyS1:921600", (), "others send datagrams there"),
        ("udpin:127.0.0.1:14540", (), "is the autopilot's own link"),
        ("udpin:0.0.0.0:14560", (), "anybody on the network could send there"),
        ("udpin::14560", (), "name in link.aid_peers who may"),
        ("udpin:0.0.0.0:14560", ("camera.local",), "takes numeric addresses"),
        ("nonsense", (), "not a link"),
    ],
)
def test_what_is_no_second_port_is_refused_with_a_sentence(url, peers, words):
    with pytest.raises(LinkError, match=words):
        parse_aid(url, peers, parse_url("udpin:0.0.0.0:14540"))
    assert parse_aid("udpin:127.0.0.1:14560", (), parse_url("udpin:0.0.0.0:14540")).port == 14560
