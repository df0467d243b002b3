"""Listeners that are no autopilot, over real sockets: they get what the autopilot must not."""

import contextlib
import math
import socket
import threading
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ekf_companion.errors import LinkError
from ekf_companion.link.address import Kind, parse_monitor, parse_peer, parse_url
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.nav import so3
from sim_autopilot.autopilot import Kind as Stack
from sim_autopilot.config import HomeConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.daemon.test_daemon import (
    POWEROFF,
    SYSTEM,
    US,
    Daemon,
    Record,
    assert_same_as_its_messages,
    fly_over,
    free_port,
)

WITHHELD = {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 7}
NAMES = ("HEARTBEAT", "ODOMETRY", "GPS_GLOBAL_ORIGIN", "ESTIMATOR_STATUS")


class Listener:
    """One that is sent to, and answers each frame with what must not be heard."""

    def __init__(self, where="127.0.0.1"):
        self.heard = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((where, 0))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        other = Sender(99, 1)
        while True:
            data, sender = self._socket.recvfrom(1000)
            if not data:
                return
            self.heard.append(data)
            self._socket.sendto(other.message("HEARTBEAT", type=2, autopilot=3), sender)

    def close(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            end.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join(10.0)
        self._socket.close()

    def of(self, name):
        return [unpack(frame) for frame in self.frames() if frame.message_id == IDS[name]]

    def frames(self):
        return [frame for data in self.heard for frame in Splitter().feed(data)]


@dataclass
class Flown:
    record: Record
    wire: object
    monitor: Listener
    crowd: Listener
    nobody: int
    words: str


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Fly a PX4 that would fuse GNSS twice, before one monitor, a network and an empty place."""
    folder = tmp_path_factory.mktemp("monitors")
    port, nobody, own = free_port(), free_port(), free_port()
    monitor, crowd = Listener(), Listener("0.0.0.0")
    monitors = [
        f"udpout:127.0.0.1:{monitor.port}",
        f"udpbcast:127.255.255.255:{crowd.port}",
        f"udpout:127.0.0.1:{nobody}",
        f"udpout:127.0.0.1:{own}",
    ]
    odometry = "{rate: 50, age_limit: 10}"
    config = f"output: {{monitors: {monitors}, odometry: {odometry}}}\nhttp: {{port: 0}}\n"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(folder / "flight.tlog"))
    home = replace(HomeConfig(), boot=20.0)
    plan = SimConfig(system_id=SYSTEM, home=home, parameters=WITHHELD)
    flight = Flight.plan("figure-eight", plan, duration=12.0)
    with contextlib.ExitStack() as stack:
        for listener in (monitor, crowd):
            stack.callback(listener.close)
        with Daemon(folder, *options, config=config) as daemon:
            daemon.wait_for(f"udpin:127.0.0.1:{port}: open")
            url = f"udp://127.0.0.1:{own}@127.0.0.1:{port}"
            wire = fly_over(url, flight, Stack.PX4)
            assert daemon.stop() == 0
            words = daemon.words.read_text()
    return Flown(Record(folder / "flight.tlog", daemon.config), wire, monitor, crowd, nobody, words)


FOR_PX4 = ("pose_covariance", "velocity_covariance", "child_frame_id", "vx", "vy", "vz")
"""What PX4 is sent otherwise: covariances without the slow error, the velocity along n."""


def test_a_monitor_gets_the_odometry_that_the_guard_withholds_rule_25(flown):
    assert not [f for f in flown.wire.frames() if f.message_id == IDS["ODOMETRY"]]
    assert "ODOMETRY is withheld: EKF2_EV_CTRL is 15" in flown.words
    heard = flown.monitor.of("ODOMETRY")
    assert len(heard) > 300
    assert set(np.diff([message.time_usec for message in heard])) == {20_000}
    # Nor does it come by the other way, where the autopilot sends from a monitor's address
    assert flown.words.count("output.monitors: the autopilot sends from udpout:") == 1
    # It is what was withheld, but for what it says of itself
    withheld = {message.time_usec: message for _, message in flown.record.of("ODOMETRY")}
    # PX4's counts from its own origin, a monitor's from ours
    ours = flown.monitor.of("GPS_GLOBAL_ORIGIN")[-1]
    its = flown.record.of("GPS_GLOBAL_ORIGIN", component=1)[-1][1]
    north = 0.0111319 * (ours.latitude - its.latitude)
    east = 0.0111319 * math.cos(math.radians(47.4)) * (ours.longitude - its.longitude)
    for message in heard:
        if (theirs := withheld.get(message.time_usec)) is None:
            continue
        # PX4 is sent metres of its sphere, a monitor those of WGS-84, 0.3 % off; an origin is told
        # to a centimetre
        place = [message.x + north, message.y + east]
        assert place == pytest.approx([theirs.x, theirs.y], rel=4e-3, abs=0.02)
        own = {name: getattr(theirs, name) for name in (*FOR_PX4, "x", "y", "z")}
        assert message.z == pytest.approx(theirs.z, abs=1e-4)
        assert message._replace(estimator_type=3, **own) == theirs
        along_b = so3.rotate(so3.conjugate(np.array(theirs.q)), [theirs.vx, theirs.vy, theirs.vz])
        assert [message.vx, message.vy, message.vz] == pytest.approx(along_b, abs=1e-4)
        # An autopilot is told nothing of the slow error of the receiver
        assert message.pose_covariance[0] > theirs.pose_covariance[0]
    assert len(withheld.keys() & {message.time_usec for message in heard}) > 300


def test_towards_a_monitor_it_is_labelled_as_what_it_is_rule_19(flown):
    labels = {
        (m.frame_id, m.child_frame_id, m.estimator_type) for m in flown.monitor.of("ODOMETRY")
    }
    assert labels == {(1, 12, 5)}


def test_a_monitor_hears_who_and_how_we_are_and_where_the_origin_is(flown):
    assert {frame.message_id for frame in flown.monitor.frames()} == {IDS[name] for name in NAMES}
    assert len(flown.monitor.of("ESTIMATOR_STATUS")) >= 8
    (origin,) = {replace_time(m) for m in flown.monitor.of("GPS_GLOBAL_ORIGIN")}
    its = flown.record.of("GPS_GLOBAL_ORIGIN", component=1)[-1][1]
    assert abs(origin.latitude - its.latitude) + abs(origin.longitude - its.longitude) < 2000
    assert len(flown.monitor.of("HEARTBEAT")) >= 4
    assert flown.monitor.of("HEARTBEAT")[-1].system_status == POWEROFF
    ids = {(f.system_id, f.component_id) for f in flown.monitor.frames()}
    assert ids - {(1, US)} == {(SYSTEM, US)}  # before the autopilot was found we were of system 1


def replace_time(message):
    return message._replace(time_usec=0)


def test_its_frames_are_numbered_apart_and_none_is_missing(flown):
    for listener in (flown.monitor, flown.crowd):
        numbers = [frame.sequence for frame in listener.frames()]
        assert set(np.diff(numbers) % 256) == {1}
        assert len(numbers) > 300


def test_what_a_monitor_says_is_neither_heard_nor_recorded(flown):
    assert {frame.system_id for frame in flown.record.frames} == {SYSTEM, 1}
    assert "Several autopilots" not in flown.words
    assert len(flown.record.of("ESTIMATOR_STATUS")) < 20  # ours, once


def test_nothing_else_is_estimated_or_recorded_because_somebody_looks_on(flown):
    """Rule 38: live is replay, to the bit."""
    assert_same_as_its_messages(flown.record)


def test_an_address_where_nobody_listens_holds_nothing_up(flown):
    assert "bug" not in flown.words
    assert flown.words.count(f"udpout:127.0.0.1:{flown.nobody}: open") == 1


@pytest.mark.parametrize(
    ("url", "link", "peer", "sentence"),
    [
        (
            "tcp:10.0.0.2:5760",
            "udpin:0.0.0.0:14540",
            "",
            "a monitor is sent datagrams; write udpout",
        ),
        ("udp:10.0.0.2:14550", "udpin:0.0.0.0:14540", "", "a monitor is sent datagrams"),
        ("udpout:10.0.0.2:14550", "udpout:10.0.0.2:14550", "", "is the autopilot's own link"),
        ("udpout:10.0.0.2:14550", "udp://:14540@10.0.0.2:14550", "", "is the autopilot's own link"),
        ("udpout:10.0.0.2:14550", "udpin::14540", "10.0.0.2:14550", "is the autopilot's own link"),
        ("udpout:localhost:14540", "udpin:0.0.0.0:14540", "", "is the autopilot's own link"),
        ("udpbcast::14540", "udpin:0.0.0.0:14540", "", "is the autopilot's own link"),
        ("udpbcast::14550", "udpbcast::14550", "", "is the autopilot's own link"),
    ],
)
def test_what_is_no_monitor_is_refused_with_a_sentence(url, link, peer, sentence):
    address = parse_url(link)
    address = replace(address, peer=parse_peer(peer, address))
    with pytest.raises(LinkError, match=sentence):
        parse_monitor(url, address)


def test_another_port_of_the_autopilots_host_is_a_monitor():
    address = parse_monitor("udpout:127.0.0.1:14550", parse_url("udpin:127.0.0.1:14540"))
    assert (address.kind, address.is_send_only) == (Kind.UDP_OUT, True)


def test_a_map_is_given_our_position_under_an_id_of_its_own(tmp_path):
    port, monitor = free_port(), Listener()
    output = f"{{monitors: ['udpout:127.0.0.1:{monitor.port}'], monitor_position_rate: 5, "
    config = f"output: {output}monitor_system_id: 100}}\nhttp: {{port: 0}}\n"
    flight = Flight.plan("figure-eight", SimConfig(system_id=SYSTEM), duration=12.0)
    with contextlib.closing(monitor):
        with Daemon(tmp_path, "--link", f"udpin:127.0.0.1:{port}", config=config) as daemon:
            daemon.wait_for(f"udpin:127.0.0.1:{port}: open")
            wire = fly_over(f"udpout:127.0.0.1:{port}", flight, Stack.PX4)
            assert daemon.stop() == 0
        heard = monitor.of("GLOBAL_POSITION_INT")
        assert {frame.system_id for frame in monitor.frames()} == {100}
    assert len(heard) > 25
    home = flight.config.home
    assert heard[-1].lat == pytest.approx(home.lat * 1e7, abs=1e4)  # 100 m
    # The autopilot is told no such thing, and we keep its system id towards it
    ours = [frame for frame in wire.frames() if frame.component_id == US]
    assert IDS["GLOBAL_POSITION_INT"] not in {frame.message_id for frame in ours}
    assert 100 not in {frame.system_id for frame in ours}
