"""The command over real sockets, pseudo-terminals and recordings."""

import json
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.layout import IDS
from sim_autopilot.__main__ import app as simulator

FLIGHTS = Path(__file__).parents[3] / "shared" / "data"
ENOUGH = 1_000_000
"""Bytes of a recording."""


def doctor(*arguments):
    """Run it; give its exit code, and its findings by stage."""
    result = CliRunner().invoke(app, ["doctor", "--json", *map(str, arguments)])
    assert isinstance(result.exception, SystemExit | None), result.output
    report = json.loads(result.stdout)
    return result.exit_code, {finding["stage"]: finding for finding in report["stages"]}, report


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.bind(("127.0.0.1", 0))
        return some.getsockname()[1]


def first_trouble(stages):
    return next(stage for stage in stages.values() if stage["verdict"] == "failed")


def test_a_flying_autopilot_is_found_well_and_sooner_than_the_seconds_given():
    port = free_port()
    command = [sys.executable, "-m", "sim_autopilot", "fly", "--scenario", "hover"]
    command += ["--link", f"udpout:127.0.0.1:{port}", "--duration", "60", "--imu-rate", "100"]
    flying = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        begin = time.monotonic()
        code, stages, report = doctor("--link", f"udpin:127.0.0.1:{port}", "--seconds", 40)
        assert time.monotonic() - begin < 40.0
    finally:
        flying.kill()
        flying.wait()
    assert report["means"] == "live"
    assert report["autopilot"]["version"] == "1.16.0"
    assert {stage["verdict"] for stage in stages.values()} == {"ok"}, stages
    assert code == 0
    assert "EKF2_EV_CTRL is 0" in stages["fused"]["saw"]


def test_a_guarded_link_is_found_over_a_socket(tmp_path):
    """Rule 25."""
    faults = tmp_path / "faults.yaml"
    faults.write_text("parameters: {EKF2_EV_CTRL: 15, EKF2_GPS_CTRL: 7}")
    ours = tmp_path / "ours.yaml"
    ours.write_text("link: {imu_rate: 100}\ntimesync: {request: false}\n")
    port, record = free_port(), tmp_path / "flight.tlog"
    command = [sys.executable, "-m", "sim_autopilot", "fly", "--scenario", "hover"]
    command += ["--link", f"udpout:127.0.0.1:{port}", "--duration", "60", "--imu-rate", "100"]
    command += ["--config", str(faults), "--log", str(record)]
    flying = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        link = f"udpin:127.0.0.1:{port}"
        code, stages, _ = doctor("--link", link, "--config", ours, "--seconds", 5)
    finally:
        flying.send_signal(signal.SIGINT)  # the record is written to its end
        flying.wait()
    assert code == 5
    assert first_trouble(stages)["stage"] == "sent"
    assert "Set EKF2_GPS_CTRL to 0" in stages["sent"]["troubles"][0]["remedy"]
    # The autopilot's own record: asked it was, and got nothing that it could fuse
    heard = [(f.component_id, f.message_id) for f in Splitter().feed(record.read_bytes())]
    assert (194, IDS["PARAM_REQUEST_READ"]) in heard
    assert (194, IDS["ODOMETRY"]) not in heard


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
    begin = time.monotonic()
    code, stages, _ = doctor("--link", "serial:/dev/ttyNONE:57600", "--seconds", 60)
    assert code == 5
    assert "There is no /dev/ttyNONE" in stages["link"]["troubles"][0]["cause"]
    assert time.monotonic() - begin < 20.0


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
            code, stages, _ = doctor("--link", link, "--seconds", 1.5, "--listen")
        finally:
            is_over.set()
            talker.join()
        with pytest.raises(BlockingIOError):
            sender.recv(512)
    assert code == 5
    assert first_trouble(stages)["stage"] == "frames"


# Recordings


@pytest.mark.parametrize(
    ("name", "first_failed", "said"),
    [
        ("sitl-arducopter-square/flight.tlog", None, "a million times too large"),
        ("sitl-px4-square/flight.tlog", None, ""),
        ("tlog-transcoded-x500-mission/x500_mission_highres.tlog", None, "numbers stand still"),
        ("tlog-apm-2013-nebraska/2013-10-13_18-50-10.tlog", "rates", "MAVLink 1 is spoken"),
        ("tlog-copter-canberra/flight.tlog", "rates", "it rebooted"),
        ("tlog-copter-vancouver/mission2_2018-09-25.tlog", "rates", "a ground station sets them"),
    ],
)
def test_recorded_flights_are_judged_as_a_pilot_would(name, first_failed, said, tmp_path):
    if not (FLIGHTS / name).is_file():
        pytest.skip(f"the recorded flight {name} is not on this machine")
    # As much as tells it; the end of a cut recording is a damaged record
    data = (FLIGHTS / name).read_bytes()
    log = tmp_path / "cut.tlog"
    log.write_bytes(data if "canberra" in name else data[:ENOUGH])
    code, stages, _ = doctor("--log", log)
    failed = [stage for stage, finding in stages.items() if finding["verdict"] == "failed"]
    assert failed[:1] == ([first_failed] if first_failed else [])
    assert code == (5 if first_failed else 0)
    causes = [trouble["cause"] for finding in stages.values() for trouble in finding["troubles"]]
    assert any(said in cause for cause in causes) or not said
    if not said:
        assert causes == []


def test_a_simulated_recording_is_judged_and_printed_in_lines(tmp_path):
    log = tmp_path / "flight.tlog"
    options = ["--scenario", "hover", "--duration", "8", "--imu-rate", "100"]
    assert CliRunner().invoke(simulator, ["generate", "-o", str(log), *options]).exit_code == 0
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
