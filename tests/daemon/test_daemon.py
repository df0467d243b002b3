"""The daemon as a process of its own, over real sockets and pseudo-terminals.

The fake autopilot flies faster than time: the estimate goes by its stamps. What the daemon recorded
is then converted, and both must have said the same, to the bit.
"""

import asyncio
import contextlib
import csv
import itertools
import json
import os
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tty
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.speed.daemon import SO_TIMESTAMPNS
from ekf_companion.cli.status import fetch
from ekf_companion.config.config import Config, load_config
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.daemon.daemon import Daemon as InThisProcess
from ekf_companion.engine.pipeline import QUALITY
from ekf_companion.logs import tlog
from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS, LAYOUTS
from ekf_companion.mavlink.session import RATES
from ekf_companion.nav import projection, so3
from ekf_companion.nav.state import Status
from ekf_companion.replay import run as replay
from ekf_companion.review import convert
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import HomeConfig, SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.fly import fly, over, run
from tests.daemon.waiting import LIMIT

SPEED = 3.0
"""Of the flights; the daemon's own clock is the wall's."""
US = 194
SYSTEM = 7
POWEROFF = 7
WATCHDOG = 4.0
"""Its period, s; the filter must feed it in time on a busy machine too."""
ODOMETRY = IDS["ODOMETRY"]
HEARD = 620
"""How many ODOMETRY of a flight are heard: of 15 s all but the first, while it aligns, and a last
second."""
BODY_FRD, LOCAL_NED = 12, 1
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 511, 512


class Daemon:
    """``ekf-companion run`` in its own process."""

    def __init__(self, folder, *options, config="link:\n", environment=None, **process):
        self.folder = folder
        self.config = folder / "config.yaml"
        self.config.write_text(config)
        self.words = folder / "words.txt"
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", "run"]
        with self.words.open("wb") as words:
            self._process = subprocess.Popen(
                [*command, "--config", str(self.config), *options],
                stdout=words,
                stderr=subprocess.STDOUT,
                env={**os.environ, **(environment or {})},
                **process,
            )

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()

    def wait_for(self, words, seconds=LIMIT):
        end = time.monotonic() + seconds
        while words not in self.words.read_text():
            assert time.monotonic() < end, self.words.read_text()
            time.sleep(0.01)

    @property
    def number(self):
        """The number of its process."""
        return self._process.pid

    def wait(self):
        return self._process.wait(LIMIT)

    def kill(self, number):
        self._process.send_signal(number)

    def hang_up(self):
        """Ask it to read its configuration again."""
        self.kill(signal.SIGHUP)

    def stop(self, number=signal.SIGTERM):
        """Ask it to end; return its exit code."""
        self._process.send_signal(number)
        return self.wait()


class Wire:
    """A link of the fake autopilot, which keeps what it heard, and may be a bad one."""

    def __init__(self, link, seed=None):
        self.address = link.address
        self.heard = []
        self.sent = []
        self.count = Counter()
        """Of what was heard, by the message's number."""
        self.is_asked_for_all = False
        """Whether the last of the daemon's requests was heard: for the version."""
        self._link = link
        self._splitter = Splitter()
        self._seed = seed
        self._rngs = {}
        """Each message has its own, by its number: how often is answered is the daemon's timing."""
        self._held = []

    def send(self, frame):
        self.sent.append(frame)
        for data in [frame] if self._seed is None else self._disturbed(frame):
            self._link.send(data)

    async def receive(self):
        received = await self._link.receive()
        self.heard.append(received.data)
        for frame in self._splitter.feed(received.data):
            self.count[frame.message_id] += 1
            if frame.message_id == IDS["COMMAND_LONG"]:
                self.is_asked_for_all |= unpack(frame).command == REQUEST_MESSAGE
        return received

    def frames(self):
        splitter = Splitter()
        return [frame for data in self.heard for frame in splitter.feed(data)]

    def _disturbed(self, frame):
        """Return what becomes of a frame: lost, doubled, damaged, cut, overtaken, or itself."""
        message = int.from_bytes(frame[7:10], "little")
        rng = self._rngs.setdefault(message, np.random.default_rng((self._seed, message)))
        held, self._held = self._held, []
        match int(rng.integers(0, 40)):
            case 0:
                out = []
            case 1:
                out = [frame, frame]
            case 2:
                out = [rng.bytes(int(rng.integers(1, 30))), frame]
            case 3:
                place = int(rng.integers(0, len(frame)))
                out = [frame[:place] + bytes([frame[place] ^ 0x40]) + frame[place + 1 :]]
            case 4:
                place = int(rng.integers(1, len(frame)))
                out = [frame[:place], frame[place:]]
            case 5:
                self._held = [frame]
                out = []
            case _:
                out = [frame]
        return out + held


def plan(duration, *, boot, skip=0.0):
    config = SimConfig(system_id=SYSTEM, home=replace(HomeConfig(), boot=boot))
    return Flight.plan("figure-eight", config, duration=duration, skip=skip)


class Open:
    """A flight that goes on until it is told to land: how long a start takes is the machine's."""

    def __init__(self, flight):
        self._flight = flight
        self._is_landing = threading.Event()

    def __getattr__(self, name):
        return getattr(self._flight, name)

    def cycles(self):
        return itertools.takewhile(lambda _: not self._is_landing.is_set(), self._flight.cycles())

    def land(self):
        self._is_landing.set()


class Until:
    """A flight of a least time (s) that lands once its wire has heard enough.

    How long that takes a busy machine, or a bad wire that loses answers, is theirs.
    """

    def __init__(self, flight, wire, least, is_enough):
        self._flight = flight
        self._wire = wire
        self._least = least
        self._is_enough = is_enough

    def __getattr__(self, name):
        return getattr(self._flight, name)

    def cycles(self):
        cycles = self._flight.cycles()
        first = next(cycles)
        least_ns = first.t_ns + round(self._least * 1e9)
        yield first
        yield from itertools.takewhile(
            lambda cycle: cycle.t_ns < least_ns or not self._is_enough(self._wire), cycles
        )


def fly_over(url, flight, kind, seed=None, least=None, is_enough=None):
    """Fly, for a least time (s) and until it is enough; give the wire with what came back."""

    async def body(link):
        wire = Wire(link, seed)
        flown = flight if is_enough is None else Until(flight, wire, least, is_enough)
        await fly(flown, wire, personality=kind, speed=SPEED, wait=LIMIT)
        return wire

    return run(over(url, body))


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def manager(folder):
    """Listen as systemd does; give its address and the list of what it is told, with the times.

    The times are the kernel's, of the sending: the thread that listens shares its interpreter with
    the fake autopilot, and on a busy machine is half a second late.
    """
    told = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        ours.bind(str(folder / "notify"))

        def listen():
            while True:
                words, ancillary, _, _ = ours.recvmsg(1000, 64)
                if not words:
                    return
                seconds, nanoseconds = struct.unpack("@ll", ancillary[0][2])
                sent = seconds + nanoseconds * 1e-9 + time.monotonic() - time.time()
                told.append((sent, words.decode()))

        thread = threading.Thread(target=listen)
        thread.start()
        yield str(folder / "notify"), told
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
            end.sendto(b"", str(folder / "notify"))
        thread.join()


@dataclass
class Record:
    """A .tlog: stamps (us), frames, and whose they are."""

    path: Path
    config: Path

    def __post_init__(self):
        log = tlog.read(self.path)
        stamped = list(log.frames())
        self.stamps = [stamp for stamp, _ in stamped]
        self.raw = [raw for _, raw in stamped]
        # One of an unknown message is seen to end where another begins
        self.frames = [Splitter().feed(raw + raw)[0] for raw in self.raw]
        self.damaged = log.damaged

    def of(self, *names, component=US):
        """Return stamp (us) and message of each frame of these kinds, in order."""
        ids = [IDS[name] for name in names]
        return [
            (stamp, unpack(frame))
            for stamp, frame in zip(self.stamps, self.frames, strict=True)
            if frame.message_id in ids and frame.component_id == component
        ]

    def sent(self):
        """Return our frames that were sent; one that was withheld has the number of the next."""
        ours = [frame for frame in self.frames if frame.component_id == US]
        return [
            one
            for one, after in itertools.zip_longest(ours, ours[1:])
            if after is None or after.sequence != one.sequence
        ]

    def payloads(self, name):
        """Return what we sent of a kind, as bytes, zeros at the end restored."""
        size = LAYOUTS[IDS[name]].size
        return [
            frame.payload.ljust(size, b"\0")
            for frame in self.frames
            if frame.message_id == IDS[name] and frame.component_id == US
        ]

    def convert(self, suffix):
        out = self.path.with_name(f"converted{suffix}")
        if not out.exists():
            command = [sys.executable, "-W", "error", "-m", "ekf_companion", "convert"]
            command += [str(self.path), "-o", str(out), "--config", str(self.config)]
            told = subprocess.run([*command, "--json"], check=True, stdout=subprocess.PIPE).stdout
            out.with_name(f"{out.name}.json").write_bytes(told)
        return out


# A flight over UDP: a clean one, and, after a reboot, one over a bad wire


@dataclass
class Flown:
    record: Record
    clean: Wire
    bad: Wire
    told: list
    code: int
    last_words: list
    words: str


UDP_CONFIG = """
output:
  odometry:
    rate: 50
    age_limit: 10  # of a busy machine
gnss:
  lever_arm: [0.02, -0.01, 0.05]
"""


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("udp")
    port = free_port()
    url = f"udpout:127.0.0.1:{port}"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(folder / "flight.tlog"))
    with manager(folder) as (address, told):
        environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": str(round(WATCHDOG * 1e6))}
        with Daemon(folder, *options, config=UDP_CONFIG, environment=environment) as daemon:
            daemon.wait_for(": open")
            # A busy machine hears the last of them too late: it flies on until it has heard enough
            clean = plan(120.0, boot=20.0)
            clean = fly_over(
                url, clean, Kind.PX4, None, 15.0, lambda wire: wire.count[ODOMETRY] >= HEARD
            )
            # Its clock begins anew, and it comes from another port
            bad = plan(120.0, boot=2.0, skip=12.0)
            bad = fly_over(url, bad, Kind.PX4, 3, 12.0, lambda wire: wire.is_asked_for_all)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
                listener.connect(("127.0.0.1", port))
                listener.settimeout(0.1)
                hello = Sender(SYSTEM, 1).message("HEARTBEAT", type=2, autopilot=12)
                answers = b""
                while not answers:  # as soon as the flight's own port has been silent for a second
                    listener.send(hello)
                    with contextlib.suppress(TimeoutError):
                        answers = listener.recv(1000)
                code = daemon.stop()
                listener.setblocking(False)
                last_words = []
                with contextlib.suppress(BlockingIOError):
                    while True:
                        last_words += Splitter().feed(listener.recv(1000))
            words = daemon.words.read_text()
    record = Record(folder / "flight.tlog", daemon.config)
    return Flown(record, clean, bad, told, code, last_words, words)


@pytest.fixture(scope="module")
def reboot(flown):
    """Return the stamp (us) of the first frame of the second flight."""
    theirs = [k for k, raw in enumerate(flown.record.raw) if raw[6] == 1]
    return flown.record.stamps[theirs[len(flown.clean.sent)]]


def until(stamp, messages):
    return [message for sent, message in messages if sent < stamp]


def test_odometry_comes_at_the_configured_rate(flown, reboot):
    stamps = [message.time_usec for message in until(reboot, flown.record.of("ODOMETRY"))]
    assert set(np.diff(stamps)) == {20_000}
    sent = [unpack(f).time_usec for f in flown.record.sent() if f.message_id == ODOMETRY]
    heard = [unpack(f).time_usec for f in flown.clean.frames() if f.message_id == ODOMETRY]
    assert heard == sent[: len(heard)]
    assert len(heard) >= HEARD
    # From the end of the alignment to the end of the flight
    assert stamps[-1] > 20_000_000 + 15_000_000 - 20_000
    assert len(stamps) > 600


def test_odometry_says_who_and_where_it_is(flown, reboot):
    for stamp, message in flown.record.of("ODOMETRY"):
        assert (message.frame_id, message.child_frame_id) == (LOCAL_NED, LOCAL_NED)
        assert message.estimator_type == 3  # PX4 refuses the true one
        assert message.reset_counter >= 1
        # After a reboot in flight the attitude is found anew
        assert message.quality == 100 or (message.quality == 50 and stamp > reboot)
    frames = [frame for frame in flown.record.frames if frame.component_id == US]
    assert {frame.system_id for frame in frames if frame.message_id == ODOMETRY} == {SYSTEM}


def test_nothing_is_said_before_the_alignment(flown, reboot):
    first = flown.record.of("HIGHRES_IMU", component=1)[0][1].time_usec
    spoken, odometry = flown.record.of("ODOMETRY")[0]
    assert odometry.time_usec >= first + 1_000_000  # a second of rest, at least
    before = until(spoken, flown.record.of("HEARTBEAT"))
    assert before
    assert {message.system_status for message in before} <= {1, 2}  # boot, calibrating
    # Nor between the reboot and the next alignment, which here is in motion
    samples = flown.record.of("HIGHRES_IMU", component=1)
    first = next(message for stamp, message in samples if stamp >= reboot).time_usec
    again = next(message for stamp, message in flown.record.of("ODOMETRY") if stamp >= reboot)
    assert again.time_usec > first + 1_000_000


def test_the_heart_beats_once_a_second(flown):
    beats = flown.record.of("HEARTBEAT")
    assert len(beats) >= 8
    for _, message in beats:
        assert (message.type, message.autopilot, message.base_mode) == (18, 8, 0)
        assert message.mavlink_version == 3
    periods = np.diff([stamp for stamp, _ in beats[:-1]])  # the last one says goodbye
    assert np.median(periods) == pytest.approx(1e6, abs=0.2e6)  # a busy machine may be late
    assert beats[-3][1].system_status == 4  # active


def test_every_message_is_asked_for_and_again_after_a_reboot(flown, reboot):
    asked = flown.record.of("COMMAND_LONG")
    for part in (
        [message for stamp, message in asked if stamp < reboot],
        [message for stamp, message in asked if stamp >= reboot],
    ):
        assert {message.command for message in part} == {SET_MESSAGE_INTERVAL, REQUEST_MESSAGE}
        assert {message.target_system for message in part} == {SYSTEM}
        # Spare compasses are asked of an ArduPilot only
        rates = {name: rate for name, rate in RATES.items() if not name.startswith("SCALED_IMU")}
        wanted = {IDS[name]: round(1e6 / rate) for name, rate in rates.items()}
        streams = [message for message in part if message.command == SET_MESSAGE_INTERVAL]
        assert {int(message.param1): message.param2 for message in streams} == wanted
        once = {message.param1 for message in part if message.command == REQUEST_MESSAGE}
        assert once == {IDS["AUTOPILOT_VERSION"], IDS["GPS_GLOBAL_ORIGIN"]}
    # ATTITUDE came at 50 Hz before
    stamps = [m.time_boot_ms for _, m in flown.record.of("ATTITUDE", component=1)]
    assert np.median(np.diff(stamps)[-50:]) == 100
    assert "Request for HIGHRES_IMU: accepted" in flown.words
    assert "Request for SCALED_PRESSURE: not offered; only autopilots" in flown.words
    assert flown.words.count("Autopilot rebooted") == 1


def test_the_autopilots_clock_is_compared_and_told(flown):
    ours = flown.record.of("TIMESYNC")
    assert any(message.tc1 == 0 for _, message in ours)
    asked = {message.ts1 for _, message in flown.record.of("TIMESYNC", component=1)}
    assert {message.ts1 for _, message in ours if message.tc1} <= asked


def test_the_recording_holds_every_frame_of_both_sides(flown, reboot):
    """A clean wire: all that was sent and heard, in its order."""
    before = [raw for stamp, raw in zip(flown.record.stamps, flown.record.raw, strict=True)]
    count = len(flown.clean.sent)
    theirs = [raw for raw in before if raw[6] == 1]
    assert theirs[:count] == flown.clean.sent
    ours = [frame.raw for frame in flown.record.sent()]
    heard = [frame.raw for frame in flown.clean.frames()]
    start = ours.index(heard[0])
    assert ours[start : start + len(heard)] == heard
    # Of the bad wire's damage nothing is kept that another reader would trip over
    assert flown.record.damaged == 0
    assert sorted(set(np.diff(flown.record.stamps)))[0] >= 0


def test_sigterm_ends_it_in_time_with_a_goodbye(flown):
    assert flown.code == 0
    assert flown.words.endswith("INFO ekf_companion.daemon.daemon: Stopped\n")
    goodbye = [unpack(f) for f in flown.last_words if f.message_id == IDS["HEARTBEAT"]][-1]
    assert goodbye.system_status == POWEROFF
    assert flown.record.of("HEARTBEAT")[-1][1].system_status == POWEROFF
    assert flown.record.raw[-1] == flown.last_words[-1].raw


def test_systemd_is_told_of_every_state(flown):
    told = [words for _, words in flown.told]
    assert told[0] == "READY=1"
    assert told[-1] == "STOPPING=1"
    assert {words.partition("=")[0] for words in told[1:-1]} == {"WATCHDOG", "STATUS"}
    states = [words.partition("=")[2] for words in told if words.startswith("STATUS=")]
    assert states[0].startswith("waiting for an autopilot; ")
    assert any(state.startswith("ok: the estimate is OK, ") for state in states)
    beats = np.diff([when for when, words in flown.told if words == "WATCHDOG=1"])
    assert np.median(beats) == pytest.approx(WATCHDOG / 2, abs=0.2 * WATCHDOG)
    assert beats.max() < WATCHDOG


# The same flight live and converted


def assert_same_as_its_estimates(record):
    """Every ODOMETRY that was sent is the row of its stamp.

    Attitude and velocity are so to the bit; the position is the same place, in the metres of the
    autopilot's projection.
    """
    with record.convert(".csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_stamp = {int(row["time_us"]): row for row in rows}
    assert len(by_stamp) == len(rows)
    sent = []
    # By their order: what one read of a busy board brings has one stamp
    for stamp, message in record.of("ODOMETRY", "GPS_GLOBAL_ORIGIN"):
        if type(message).__name__ == "GPS_GLOBAL_ORIGIN":
            begun = message
            continue
        sent.append((stamp, message))
        origin = *np.deg2rad((begun.latitude * 1e-7, begun.longitude * 1e-7)), begun.altitude * 1e-3
        row = by_stamp[message.time_usec]

        def vector(names, row=row):
            return np.array([float(row[name]) for name in names.split()])

        q_nb = vector("q_w q_x q_y q_z")
        unit = q_nb / np.sqrt(q_nb @ q_nb)
        turned = -unit if unit[0] < 0.0 else unit
        assert np.float32(message.q).tobytes() == turned.astype(np.float32).tobytes()
        sphere = projection.PX4 if message.frame_id == LOCAL_NED else projection.ARDUPILOT
        place = sphere.to_geodetic(message.x, message.y, *origin[:2])
        # GPS_GLOBAL_ORIGIN has a centimetre; an ArduPilot's datum of height is told by 0.1 m
        assert place == pytest.approx(np.deg2rad(vector("lat_deg lon_deg")), abs=2e-9)
        assert origin[2] - message.z == pytest.approx(float(row["alt_m"]), abs=0.102)
        vel_n, said = vector("vel_n vel_e vel_d"), (message.vx, message.vy, message.vz)
        if message.child_frame_id == BODY_FRD:
            expected = (so3.to_matrix(q_nb).T @ vel_n).astype(np.float32)
            assert np.float32(said).tobytes() == expected.tobytes()
        else:
            # Turned there and back in single precision
            assert said == pytest.approx(vel_n, rel=1e-5, abs=1e-5)
        # Beside the resets, jumps are told that were none; the last before a silence has failed
        assert message.reset_counter > int(row["reset_count"])
        assert message.quality in (QUALITY[Status[row["status"].upper()]], -1)
    return sent


def assert_same_as_its_messages(record):
    converted = Record(record.convert(".tlog"), record.config)
    for name in ("ODOMETRY", "ESTIMATOR_STATUS", "GPS_GLOBAL_ORIGIN"):
        ours = record.payloads(name)
        assert ours
        assert converted.payloads(name) == ours
    # The original frames are all there, and of ours nothing but the estimates
    theirs = [raw for raw in record.raw if raw[6] != US]
    assert [raw for raw in converted.raw if raw[6] != US] == theirs


def test_the_converted_recording_gives_the_same_estimates(flown):
    """Rule 38: live is replay, to the bit."""
    assert len(assert_same_as_its_estimates(flown.record)) > 1000


def test_the_converted_recording_does_not_depend_on_how_it_is_cut(flown, tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "CHUNK", 997)
    convert.convert(flown.record.path, tmp_path / "cut.csv", load_config(flown.record.config))
    assert (tmp_path / "cut.csv").read_bytes() == flown.record.convert(".csv").read_bytes()


def test_the_converted_recording_gives_the_same_messages(flown):
    """Rule 38: live is replay, to the bit."""
    assert_same_as_its_messages(flown.record)


def test_the_flight_held_what_makes_the_two_differ_where_they_can(flown):
    """Late fixes, lost and doubled frames and a reboot: else sameness shows little."""
    report = json.loads(flown.record.convert(".csv").with_suffix(".csv.json").read_text())
    assert report["late"] > 50
    refused = report["refused_by_decoder"]
    assert refused["lost"] > 20
    assert refused["late"] > 20
    assert report["arrivals"]["imu"]["estimated"] > 6000


# The same over a serial line that is unplugged


class Cable:
    """Two pseudo-terminals, and a thread that carries bytes between them in odd pieces."""

    def __init__(self, *places):
        self._masters, self._slaves = [], []
        for place in places:
            master, slave = os.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._masters.append(master)
            self._slaves.append(slave)
            place.unlink(missing_ok=True)
            place.symlink_to(os.ttyname(slave))
        self._end, self._stop = os.pipe()
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()

    def _carry(self):
        left, right = self._masters
        sizes = itertools.cycle([7, 1000, 64, 1, 333])
        while True:
            ready, _, _ = select.select([left, right, self._end], [], [])
            if self._end in ready:
                return
            for master in ready:
                with contextlib.suppress(BlockingIOError):
                    other = right if master is left else left
                    data = os.read(master, next(sizes))
                    while data:
                        select.select([], [other], [], 1.0)
                        data = data[os.write(other, data) :]

    def unplug(self):
        os.write(self._stop, b"x")
        self._thread.join()
        for descriptor in (*self._masters, *self._slaves, self._end, self._stop):
            os.close(descriptor)


@dataclass
class Wired:
    record: Record
    first: Wire
    second: Wire
    code: int
    words: str


@pytest.fixture(scope="module")
def wired(tmp_path_factory):
    folder = tmp_path_factory.mktemp("serial")
    here, there = folder / "companion", folder / "autopilot"
    url = f"serial:{there}:921600"
    config = (
        f"link: {{url: 'serial:{here}:921600'}}\n"
        f"record: {{path: {folder}/flight.tlog}}\n"
        "imu: {lag: 0.002}\n"
        "output: {odometry: {jumps: tell, age_limit: 10}}\n"
    )
    cable = Cable(here, there)
    with Daemon(folder, config=config) as daemon:
        daemon.wait_for(": open")
        first = plan(120.0, boot=16.0)
        first = fly_over(url, first, Kind.ARDUPILOT, None, 14.0, lambda w: w.count[ODOMETRY] > 100)
        cable.unplug()
        daemon.wait_for("trying again")
        cable = Cable(here, there)
        # How long the first took is the machine's
        frames = Splitter().feed(b"".join(first.sent))
        last = max(unpack(f).time_usec for f in frames if f.message_id == IDS["HIGHRES_IMU"])
        second = fly_over(url, plan(7.5, boot=last * 1e-6, skip=10.0), Kind.ARDUPILOT)
        code = daemon.stop(signal.SIGINT)
        words = daemon.words.read_text()
    cable.unplug()
    record = Record(folder / "flight.tlog", daemon.config)
    return Wired(record, first, second, code, words)


@pytest.mark.campaign
def test_a_serial_line_carries_the_flight(wired):
    heard = [unpack(f).time_usec for f in wired.first.frames() if f.message_id == ODOMETRY]
    assert len(heard) > 100
    # A line that answers nothing for a moment gets fewer
    stamps = [message.time_usec for _, message in wired.record.of("ODOMETRY")]
    assert np.median(np.diff(stamps)) == pytest.approx(1e6 / 30, abs=4000)
    types = {message.estimator_type for _, message in wired.record.of("ODOMETRY")}
    assert types == {5}  # ArduPilot takes the true one
    assert wired.code == 0


@pytest.mark.campaign
def test_a_serial_line_that_was_unplugged_is_taken_up_again(wired):
    heard = [unpack(f).time_usec for f in wired.second.frames() if f.message_id == ODOMETRY]
    assert heard
    assert wired.words.count(": open") == 2


@pytest.mark.campaign
def test_the_serial_recording_gives_the_same_estimates(wired):
    """Rule 38: live is replay, to the bit."""
    assert len(assert_same_as_its_estimates(wired.record)) > 200


@pytest.mark.campaign
def test_the_serial_recording_gives_the_same_messages(wired):
    """Rule 38: live is replay, to the bit."""
    assert_same_as_its_messages(wired.record)


# When something is wrong


def test_what_its_own_loop_waits_for_is_no_queue_in_the_line():
    async def stall():
        config = Config()
        config = replace(
            config,
            link=replace(config.link, url=f"udpin:127.0.0.1:{free_port()}"),
            http=replace(config.http, port=0),
        )
        with InThisProcess(config) as daemon:
            daemon._observer.on_late_timer(0.3)
            daemon._run_periodic(unix_clock())
            return daemon._companion.session.delivery.lag.loop_ns

    assert asyncio.run(stall()) == pytest.approx(0.3e9, rel=1e-6)


def test_it_stops_while_it_still_tries_to_connect(tmp_path):
    port = free_port(socket.SOCK_STREAM)
    with Daemon(tmp_path, "--link", f"tcp:127.0.0.1:{port}") as daemon:
        daemon.wait_for("trying again")
        assert daemon.stop() == 0


def test_a_port_that_another_daemon_has_is_said_with_its_process_and_leaves_no_recording(tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    options = "--link", f"udpin:127.0.0.1:{free_port()}", "--record"
    with Daemon(first, *options, str(first / "flight.tlog")) as holder:
        holder.wait_for(": open")
        with Daemon(second, *options, str(second / "flight.tlog")) as late:
            late.wait_for("another daemon of this project, ekf-companion (process ")
            assert "stop it with `" in late.words.read_text()
            assert late.stop() == 0
        assert holder.stop() == 0
    assert (first / "flight.tlog").stat().st_size > 0
    assert not (second / "flight.tlog").exists()


def test_it_stops_while_a_name_is_looked_up_in_vain():
    code = (
        "import socket, time\n"
        "socket.getaddrinfo = lambda *_, **__: print('asked', flush=True) or time.sleep(600)\n"
        "from ekf_companion.cli import app\n"
        "app(['run', '--link', 'udpout:autopilot.local:14550'])\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"asked\n"
        process.terminate()
        assert process.wait(LIMIT) == 0  # sooner than the name is looked up


def test_a_name_of_no_host_is_said_once(tmp_path):
    with Daemon(tmp_path, "--link", "udpout:a..b:14550") as daemon:
        daemon.wait_for("a..b is no name of a host; trying again until it opens")
        assert daemon.stop() == 0


def test_a_tcp_peer_that_restarts_is_found_again(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(LIMIT)
        with Daemon(tmp_path, "--link", f"tcp:127.0.0.1:{server.getsockname()[1]}") as daemon:
            for _ in range(2):
                peer, _ = server.accept()
                with peer:
                    peer.settimeout(LIMIT)
                    frames = Splitter().feed(peer.recv(1000))
                    assert frames[0].message_id == IDS["HEARTBEAT"]
            assert daemon.stop() == 0


def test_a_full_disk_is_said_once_and_stops_nothing(tmp_path):
    def allow_little():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    port = free_port()
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(tmp_path / "flight.tlog"))
    with (
        Daemon(tmp_path, *options, preexec_fn=allow_little) as daemon,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        daemon.wait_for(": open")
        peer.connect(("127.0.0.1", port))
        peer.settimeout(LIMIT)
        hello = Sender(SYSTEM, 1).message("HEARTBEAT", type=2, autopilot=12)
        for _ in range(3):
            for _ in range(50):
                peer.send(hello)
            beaten = time.monotonic()
            while IDS["HEARTBEAT"] not in [f.message_id for f in Splitter().feed(peer.recv(1000))]:
                assert time.monotonic() < beaten + LIMIT
        assert daemon.stop() == 0
        words = daemon.words.read_text()
    assert words.count("File too large; not all is recorded") == 1
    assert words.count("bytes are missing") == 1
    assert len(tlog.read(tmp_path / "flight.tlog")) > 20


def test_a_bug_ends_it_with_its_traceback_and_a_sentence(tmp_path):
    """Where a task breaks, the others end, and systemd may start it again."""
    code = (
        "from ekf_companion.engine.companion import Companion\n"
        "Companion.tick = lambda self, now_ns: 1 // 0\n"
        "from ekf_companion.cli import app\n"
        f"app(['run', '--link', 'udpin:127.0.0.1:{free_port()}'])\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=LIMIT
    )
    assert result.returncode == 1
    assert result.stderr.count("Traceback (most recent call last)") >= 1
    assert result.stderr.count("Ended by a bug") == 1
    last = result.stderr.splitlines()[-1]
    assert last.startswith("ekf-companion: ended by a bug (ZeroDivisionError); the traceback")


def test_a_link_that_is_none_is_a_sentence(tmp_path):
    with Daemon(tmp_path, "--link", "com3") as daemon:
        assert daemon.wait() == 2
        assert daemon.words.read_text().startswith("ekf-companion: com3: not a link; write for")


def test_a_recording_without_a_folder_is_a_sentence_and_stops_no_flight(tmp_path):
    """Rule 39: the disk is in nobody's way; systemd would start it in vain each second."""
    link, port = free_port(), free_port(socket.SOCK_STREAM)
    config = f"http: {{port: {port}}}\n"
    place = tmp_path / "none" / "flight.tlog"
    options = ("--link", f"udpin:127.0.0.1:{link}", "--record", str(place))
    with Daemon(tmp_path, *options, config=config) as daemon:
        daemon.wait_for(f"record.path: {place}: No such file or directory; nothing is recorded")
        wire = fly_over(f"udpout:127.0.0.1:{link}", plan(4.0, boot=20.0), Kind.PX4)
        assert any(frame.message_id == IDS["HEARTBEAT"] for frame in wire.frames())
        daemon.wait_for("Status on")
        heard = fetch(f"http://127.0.0.1:{port}").data
        trouble = f"{place}: No such file or directory"
        assert heard["process"]["recording_trouble"] == trouble
        assert heard["process"]["unrecorded_bytes"] > 0
        assert daemon.stop() == 0


HUNG_OPEN = """
import os, time

real = os.open
os.open = lambda path, *a, **b: time.sleep(600.0 * (".tlog" in str(path))) or real(path, *a, **b)
from ekf_companion.cli import app

app(["run", "--link", "udpout:127.0.0.1:{port}", "--record", "{folder}/flight.tlog"])
"""


def test_a_disk_that_does_not_open_the_recording_delays_no_heartbeat(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(LIMIT)
        code = HUNG_OPEN.format(port=peer.getsockname()[1], folder=tmp_path)
        with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) as process:
            assert Splitter().feed(peer.recv(1000))[0].message_id == IDS["HEARTBEAT"]
            process.terminate()
            assert process.wait(LIMIT) == 0
            assert b"the disk is too slow; the end may be missing" in process.stderr.read()
