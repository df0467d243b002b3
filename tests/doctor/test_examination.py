"""The command over real sockets, pseudo-terminals and recordings."""

import gzip
import json
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.doctor.evidence import Source
from ekf_companion.mavlink.codec import Sender, pack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from ekf_companion.mavlink.signing import Signing
from sim_autopilot.__main__ import app as simulator
from tests.paths import DATA

ENOUGH = slice(250_000)
REBOOT = slice(300_000, 700_000)
"""Bytes of a recording that tell it; where it is cut, it is damaged."""


def doctor(*arguments):
    """Run it; give its exit code, and its results by stage."""
    result = CliRunner().invoke(app, ["doctor", "--json", *map(str, arguments)])
    assert isinstance(result.exception, SystemExit | None), result.output
    report = json.loads(result.stdout)
    return result.exit_code, {stage["stage"]: stage for stage in report["stages"]}, report


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


def first_trouble(stages):
    return next(stage for stage in stages.values() if stage["verdict"] == "failed")


GUARDED = "parameters: {EKF2_EV_CTRL: 15, EKF2_GPS_CTRL: 7}"
PATIENT = "link: {imu_rate: 100}\ntimesync: {largest_rtt: 0.5}\n"
"""On a machine that has other work."""


class Examined:
    """A simulated flight and the command, each a process of its own."""

    def __init__(self, stack, folder, parameters, seconds):
        self.record, faults = folder / "flight.tlog", folder / "faults.yaml"
        faults.write_text(parameters)
        config = folder / "ours.yaml"
        config.write_text(PATIENT)
        port = free_port()
        flight = ["sim_autopilot", "fly", "--scenario", "hover", "--duration", "60"]
        flight += ["--imu-rate", "100", "--link", f"udpout:127.0.0.1:{port}"]
        flight += ["--config", str(faults), "--log", str(self.record)]
        ours = ["ekf_companion", "doctor", "--json", "--link", f"udpin:127.0.0.1:{port}"]
        ours += ["--config", str(config), "--seconds", str(seconds)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        start = [sys.executable, "-m"]
        self._flying = stack.enter_context(subprocess.Popen([*start, *flight], **quiet))
        stack.callback(self._flying.kill)
        self._doctor = stack.enter_context(
            subprocess.Popen([*start, *ours], stdout=subprocess.PIPE)
        )
        stack.callback(self._doctor.kill)

    def read(self):
        """Return exit code, results by stage, and the whole report."""
        report = json.loads(self._doctor.communicate()[0])
        self._flying.send_signal(signal.SIGINT)  # the record is written to its end
        self._flying.wait()
        stages = {result["stage"]: result for result in report["stages"]}
        return self._doctor.returncode, stages, report


@pytest.fixture(scope="module", autouse=True)
def live(tmp_path_factory):
    """Two at once, from the first test to the last, as they wait most of their time."""
    with ExitStack() as stack:
        well = Examined(stack, tmp_path_factory.mktemp("well"), "{}", 40)
        guarded = Examined(stack, tmp_path_factory.mktemp("guarded"), GUARDED, 16)
        yield {"well": well, "guarded": guarded}


def test_a_port_that_another_program_has_is_named_with_the_program():
    port = free_port()
    hold = "import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM);"
    hold += f"s.bind(('127.0.0.1', {port})); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", hold]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        code, stages, _ = doctor("--link", f"udpin:127.0.0.1:{port}", "--seconds", 10)
        holder.stdin.close()
    assert code == 5
    assert f"(process {holder.pid}" in stages["link"]["troubles"][0]["cause"]
    assert stages["bytes"]["verdict"] == "unknown"


def test_a_wire_that_another_program_has_is_named_with_the_program():
    ours, theirs = os.openpty()
    device = os.ttyname(theirs)
    hold = f"import serial, sys; s = serial.Serial({device!r}, exclusive=True);"
    hold += "print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", hold]
    try:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
            holder.stdout.readline()
            _, stages, _ = doctor("--link", f"serial:{device}:57600", "--seconds", 10)
            holder.stdin.close()
    finally:
        os.close(ours)
        os.close(theirs)
    assert f"(process {holder.pid}" in stages["link"]["troubles"][0]["cause"]


def test_a_device_that_is_not_there_is_given_up_soon():
    code, stages, _ = doctor("--link", "serial:/dev/ttyNONE:57600", "--seconds", 3600)
    assert code == 5
    assert "There is no /dev/ttyNONE" in stages["link"]["troubles"][0]["cause"]


def test_a_file_that_is_no_serial_port_is_said_to_be_none(tmp_path):
    (tmp_path / "tty").write_text("")
    _, stages, _ = doctor("--link", f"serial:{tmp_path / 'tty'}", "--seconds", 10)
    assert stages["link"]["verdict"] == "failed"
    assert "cannot be set up as a serial port" in stages["link"]["troubles"][0]["cause"]


def test_nobody_to_connect_to_is_told():
    with socket.socket() as some:
        some.bind(("127.0.0.1", 0))  # bound, and not listening
        code, stages, _ = doctor("--link", f"tcp:127.0.0.1:{some.getsockname()[1]}")
    assert code == 5
    assert "Nobody listens there" in stages["link"]["troubles"][0]["cause"]


def test_a_wire_without_bytes_is_told():
    ours, theirs = os.openpty()
    try:
        code, stages, _ = doctor("--link", f"serial:{os.ttyname(theirs)}:57600", "--seconds", 1)
    finally:
        os.close(ours)
        os.close(theirs)
    assert code == 5
    assert stages["link"]["verdict"] == "ok"
    assert "Cross TX and RX" in stages["bytes"]["troubles"][0]["remedy"]


def test_garbage_is_told_and_listening_answers_nothing():
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        sender.setblocking(False)
        is_over = threading.Event()

        def babble():
            while not is_over.wait(0.05):
                sender.sendto(b"\x9c\x13\x80 garbage" * 20, ("127.0.0.1", port))

        talker = threading.Thread(target=babble)
        talker.start()
        try:
            link = f"udpin:127.0.0.1:{port}"
            code, stages, _ = doctor("--link", link, "--seconds", 1, "--listen")
        finally:
            is_over.set()
            talker.join()
        with pytest.raises(BlockingIOError):
            sender.recv(512)
    assert code == 5
    assert first_trouble(stages)["stage"] == "frames"


class Voice:
    """One who sends heartbeats to a port of ours, and hears what is answered."""

    def __init__(self, port, system_id, signing=None):
        self._sender = Sender(system_id, 1, signing)
        self._target = ("127.0.0.1", port)
        self._splitter = Splitter()
        self.heard = []

    def __enter__(self):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        return self

    def __exit__(self, *_):
        self._socket.close()

    def speak(self):
        payload = pack("HEARTBEAT", type=2, autopilot=12)
        self._socket.sendto(self._sender.frame("HEARTBEAT", payload, time.time_ns()), self._target)

    def listen(self):
        with suppress(BlockingIOError):
            while True:
                self.heard += self._splitter.feed(self._socket.recv(1024))


def between(autopilot, stranger, *arguments):
    """Run it while an autopilot speaks, and a stranger as soon as that has been answered."""
    is_over = threading.Event()

    def talk():
        while not is_over.wait(0.03):
            autopilot.speak()
            autopilot.listen()
            if autopilot.heard:
                stranger.speak()
                stranger.listen()

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        return doctor(*arguments)
    finally:
        is_over.set()
        talker.join()


def test_a_stranger_at_the_port_is_neither_heard_nor_answered():
    port = free_port()
    with Voice(port, 1) as autopilot, Voice(port, 2) as stranger:
        link = f"udpin:127.0.0.1:{port}"
        _, stages, report = between(autopilot, stranger, "--link", link, "--seconds", 1.5)
    assert report["autopilot"]["system_id"] == 1
    assert stages["source"]["saw"] == "1/1 PX4"
    assert "not from the autopilot's address" in stages["bytes"]["saw"]
    assert stranger.heard == []


def test_a_secret_is_used_as_the_daemon_would_and_its_file_of_times_is_left_alone(tmp_path):
    """Rule 34."""
    key, kept, port = bytes(range(32)), tmp_path / "state.signing", free_port()
    (tmp_path / "key").write_bytes(key)
    (tmp_path / "key").chmod(0o600)
    kept.write_bytes(Signing(key).state())
    before = sorted(tmp_path.iterdir()), kept.read_bytes()
    config = tmp_path.parent / f"{tmp_path.name}.yaml"
    config.write_text(
        f"signing: {{key_file: {tmp_path}/key}}\ncheckpoint: {{file: {tmp_path}/state}}\n"
    )
    with Voice(port, 1, Signing(key)) as autopilot, Voice(port, 2) as stranger:
        link = ("--link", f"udpin:127.0.0.1:{port}", "--seconds", 1.5)
        _, stages, report = between(autopilot, stranger, *link, "--config", config)
    assert report["autopilot"]["system_id"] == 1
    assert stages["source"]["verdict"] == "ok"
    assert stages["source"]["saw"] == "1/1 PX4; 2/1 PX4, refused"
    ears = Signing(key)
    assert {ears.verify(frame, time.time_ns()) for frame in autopilot.heard} == {""}
    assert stranger.heard == []
    assert (sorted(tmp_path.iterdir()), kept.read_bytes()) == before


# Recordings


@pytest.mark.parametrize(
    ("name", "part", "first_failed", "said"),
    [
        ("sitl-arducopter-square/flight.tlog", ENOUGH, None, "a million times too large"),
        ("sitl-px4-square/flight.tlog", ENOUGH, None, ""),
        (
            "tlog-transcoded-x500-mission/x500_mission_highres.tlog",
            ENOUGH,
            None,
            "numbers stand still",
        ),
        ("tlog-apm-2013-nebraska/2013-10-13_18-50-10.tlog", ENOUGH, "rates", "MAVLink 1 is spoken"),
        ("tlog-copter-canberra/flight.tlog", REBOOT, "rates", "it rebooted"),
        (
            "tlog-copter-vancouver/mission2_2018-09-25.tlog",
            ENOUGH,
            "rates",
            "a ground station sets them",
        ),
    ],
)
def test_recorded_flights_are_judged_as_a_pilot_would(name, part, first_failed, said, tmp_path):
    if not (DATA / name).is_file():
        pytest.skip(f"the recorded flight {name} is not on this machine")
    log = tmp_path / "cut.tlog"
    log.write_bytes((DATA / name).read_bytes()[part])
    code, stages, _ = doctor("--log", log)
    failed = [stage for stage, result in stages.items() if result["verdict"] == "failed"]
    assert failed[:1] == ([first_failed] if first_failed else [])
    assert code == (5 if first_failed else 0)
    causes = [trouble["cause"] for result in stages.values() for trouble in result["troubles"]]
    assert any(said in cause for cause in causes) or not said
    if not said:
        assert causes == []


def test_a_log_that_is_no_telemetry_is_refused_with_what_to_do(tmp_path):
    result = CliRunner().invoke(app, ["doctor", "--log", str(tmp_path / "flight.ulg.gz")])
    assert result.exit_code == 2
    assert "only a .tlog holds what came over a link; `ekf-companion report` " in result.output


@pytest.mark.parametrize("is_packed", [False, True])
def test_a_simulated_recording_is_judged_and_printed_in_lines(is_packed, tmp_path):
    log = tmp_path / "flight.tlog"
    options = ["--scenario", "hover", "--duration", "8", "--imu-rate", "100"]
    assert CliRunner().invoke(simulator, ["generate", "-o", str(log), *options]).exit_code == 0
    if is_packed:
        log = tmp_path / "flight.tlog.gz"
        log.write_bytes(gzip.compress((tmp_path / "flight.tlog").read_bytes()))
    result = CliRunner().invoke(app, ["doctor", "--log", str(log)])
    assert result.exit_code == 0
    assert result.stdout.startswith("-        link       a recording has none\nok       bytes ")
    assert "Nothing is wrong at any stage that can be seen here." in result.stdout
    assert logging.getLogger("ekf_companion").propagate


@pytest.mark.parametrize(
    "arguments",
    [
        ("--log", "flight.bin"),
        ("--log", "flight.tlog", "--listen"),
        ("--log", "flight.tlog", "--link", "udpin:0.0.0.0:14540"),
        ("--link", "com3"),
    ],
)
def test_what_cannot_be_meant_is_a_wrong_command_line(arguments):
    result = CliRunner().invoke(app, ["doctor", *arguments])
    assert result.exit_code == 2
    assert result.stderr.startswith("ekf-companion: ")


def test_a_recording_that_is_none_is_an_unreadable_log(tmp_path):
    (tmp_path / "no.tlog").write_bytes(b"no frames here")
    assert CliRunner().invoke(app, ["doctor", "--log", str(tmp_path / "no.tlog")]).exit_code == 3


# Whole flights, which have gone on beside all of the above


def test_a_flying_autopilot_is_found_well_and_sooner_than_the_seconds_given(live):
    code, stages, report = live["well"].read()
    assert report["seconds"] < 40.0
    assert report["means"] == "live"
    assert report["autopilot"]["version"] == "1.16.0"
    assert {stage["verdict"] for stage in stages.values()} == {"ok"}, stages
    assert code == 0
    assert "EKF2_EV_CTRL is 0" in stages["fused"]["saw"]


def test_a_guarded_link_is_found_over_a_socket(live):
    """Rule 25."""
    code, stages, _ = live["guarded"].read()
    assert code == 5
    assert first_trouble(stages)["stage"] == "sent"
    assert "Set EKF2_GPS_CTRL to 0" in stages["sent"]["troubles"][0]["remedy"]
    # The autopilot's own record: asked it was, and got nothing that it could fuse
    heard = [
        (f.component_id, f.message_id) for f in Splitter().feed(live["guarded"].record.read_bytes())
    ]
    assert (194, IDS["PARAM_REQUEST_READ"]) in heard
    assert (194, IDS["ODOMETRY"]) not in heard


@pytest.mark.parametrize(
    ("autopilot", "kind", "is_one"),
    [(12, 2, True), (0, 0, True), (8, 2, False), (3, 6, False), (12, 26, False), (0, 18, False)],
)
def test_rule_1_who_counts_as_an_autopilot_is_the_daemons_own_choice(autopilot, kind, is_one):
    source = Source(
        system_id=1, component_id=1, frames=9, heartbeats=1, autopilot=autopilot, type=kind
    )
    assert source.is_autopilot is is_one
