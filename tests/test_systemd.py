"""The unit files, as systemd itself reads them, and the process under what they forbid."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from sim_autopilot.autopilot import Kind
from sim_autopilot.lidar.device import Device
from tests.daemon.test_daemon import Daemon, Record, fly_over, free_port, plan
from tests.daemon.test_run_lidar import MOUNTED, LidarProcess, Listener
from tests.daemon.waiting import LIMIT, wait_until
from tests.lidar.recordings import small
from tests.paths import ROOT
from tests.sandbox import confine, numbers

FOLDER = ROOT / "systemd"
PLAIN, INSTANCE = FOLDER / "ekf-companion.service", FOLDER / "ekf-companion@.service"
LIDAR = FOLDER / "ekf-companion-lidar.service"
UNITS = [PLAIN, INSTANCE]
ALL = [*UNITS, LIDAR]
DROP_INS = sorted((FOLDER / "drop-ins").iterdir())
EXPOSURE = 2.0
"""Of 10, as `systemd-analyze security` counts."""


def setting(unit, key):
    return re.search(rf"^{key}=(.*)$", unit.read_text(), flags=re.MULTILINE)[1]


def settings(unit, key):
    """Return the words of a key that may stand several times."""
    return re.findall(rf"^{key}=(.*)$", unit.read_text(), flags=re.MULTILINE)


def analyze(*arguments):
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("systemd-analyze is not installed (Debian and Ubuntu: package systemd)")
    result = subprocess.run(
        [tool, *arguments], capture_output=True, text=True, check=False, timeout=LIMIT
    )
    return result.returncode, result.stdout + result.stderr


def verify(folder, unit, text, drop_in=None):
    """Return what systemd has to say of a unit whose program exists."""
    path = folder / unit.name.replace("@.", "@quad.")
    path.write_text(text.replace("/opt/ekf-companion/bin/ekf-companion", sys.executable))
    if drop_in is not None:
        place = path.with_name(path.name + ".d")
        place.mkdir()
        (place / "it.conf").write_text(drop_in)
    return analyze("verify", path)


@pytest.mark.parametrize("unit", ALL, ids=lambda path: path.name)
def test_systemd_reads_every_line(tmp_path, unit):
    assert verify(tmp_path, unit, unit.read_text()) == (0, "")


@pytest.mark.parametrize("path", DROP_INS, ids=lambda path: path.name)
def test_systemd_reads_every_line_of_the_drop_ins(tmp_path, path):
    assert verify(tmp_path, PLAIN, PLAIN.read_text(), path.read_text()) == (0, "")


def test_systemd_would_complain_of_a_key_that_it_does_not_know(tmp_path):
    _, words = verify(tmp_path, PLAIN, PLAIN.read_text().replace("WatchdogSec=", "WatchDogSec="))
    assert "WatchDogSec" in words
    _, words = verify(tmp_path, PLAIN, PLAIN.read_text(), "[Service]\nLoadCredentials=x\n")
    assert "LoadCredentials" in words


@pytest.mark.parametrize("unit", ALL, ids=lambda path: path.name)
def test_little_is_left_to_whoever_breaks_in(tmp_path, unit):
    path = tmp_path / unit.name
    path.write_text(unit.read_text())
    _, words = analyze("security", "--offline=true", path)
    assert float(re.search(r"Overall exposure level for \S+: ([\d.]+)", words)[1]) <= EXPOSURE


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_ports_on_usb_may_be_opened_whenever_they_are_plugged_in(unit):
    """systemd.resource-control(5): groups are looked up in /proc/devices once, at the start."""
    assert "char-tty* rw" in settings(unit, "DeviceAllow")
    for module in ("cdc_acm", "usbserial"):  # ttyACM, and ttyUSB of every make
        for key in ("Wants", "After"):
            assert f"modprobe@{module}.service" in " ".join(settings(unit, key)).split()


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_the_program_takes_the_arguments_that_systemd_gives_it(unit):
    program, *arguments = setting(unit, "ExecStart").replace("%i", "quad").split()
    assert program == "/opt/ekf-companion/bin/ekf-companion"
    nowhere = [argument.replace("/etc/", "/nowhere/") for argument in arguments]
    result = CliRunner().invoke(app, nowhere)
    assert result.exit_code == 2
    name = "config" if unit == PLAIN else "quad"
    assert f"/nowhere/ekf-companion/{name}.yaml: cannot be read" in result.stderr


def test_the_lidars_program_takes_the_options_of_its_file():
    program, command, options = setting(LIDAR, "ExecStart").split()
    assert (program, options) == ("/opt/ekf-companion/bin/ekf-companion", "$LIDAR")
    result = CliRunner().invoke(app, [command, "192.168.1.150", "--on-vehicle", "0,20"])
    assert result.exit_code == 2
    assert "--on-vehicle: '0,20': is ROLL,PITCH,YAW in deg" in result.stderr
    assert setting(LIDAR, "EnvironmentFile") == setting(LIDAR, "ConditionPathExists")


@pytest.mark.parametrize("unit", UNITS, ids=lambda path: path.name)
def test_the_state_that_a_restart_goes_on_from_lies_where_systemd_lets_it(unit):
    folder = setting(unit, "StateDirectory")
    assert setting(unit, "ExecStart").endswith(f" --checkpoint /var/lib/{folder}/checkpoint")
    assert setting(unit, "LogsDirectory") == folder


def test_the_two_units_differ_only_in_names():
    """So that what is mended in one is mended in both."""

    def settings(unit):
        lines = [line for line in unit.read_text().splitlines() if not line.startswith("#")]
        return [
            line.replace("ekf-companion-%i", "ekf-companion")
            .replace("%i.yaml", "config.yaml")
            .replace(" for %i ", " ")
            for line in lines
            if line and not line.startswith("Condition")
        ]

    assert settings(INSTANCE) == settings(PLAIN)


def test_it_is_started_again_however_often_it_fails():
    for unit in ALL:
        for key, value in (
            ("Restart", "always"),
            ("RestartSec", "0.3"),
            ("StartLimitIntervalSec", "0"),
            ("Type", "notify"),
        ):
            assert setting(unit, key) == value
        assert float(setting(unit, "TimeoutStopSec")) > 2.0


# Under what the unit forbids: only these system calls, and no memory both writable and executable


@pytest.fixture(scope="module")
def allowed():
    """Return the numbers of the system calls that SystemCallFilter lets through."""
    lists = re.findall(r"^SystemCallFilter=(~?)(.*)$", PLAIN.read_text(), flags=re.MULTILINE)
    names = set()
    for is_denied, groups in lists:
        found = set().union(*(members(group) for group in groups.split()))
        names = names - found if is_denied else names | found
    table = numbers()
    if table is None:
        pytest.skip("no table of system calls (Debian and Ubuntu: package linux-libc-dev)")
    return sorted(table[name] for name in names if name in table)


def members(group):
    """Return the system calls of a group of systemd's, by its own table."""
    lines = analyze("syscall-filter", group)[1].splitlines()
    words = {line.strip() for line in lines if line.startswith("    ") and "#" not in line}
    deeper = [members(word) for word in words if word.startswith("@")]
    return {word for word in words if not word.startswith("@")}.union(*deeper)


def test_the_daemon_lives_under_the_units_filter(tmp_path, allowed):
    """It opens its link, records, keeps its state and ends, and maps no page W+X."""
    port = free_port()
    record = tmp_path / "flight.tlog"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--record", str(record))
    keeping = ("--checkpoint", str(tmp_path / "checkpoint"))
    with Daemon(tmp_path, *options, *keeping, preexec_fn=lambda: confine(allowed)) as daemon:
        daemon.wait_for(": open")
        fly_over(f"udpout:127.0.0.1:{port}", plan(4.0, boot=20.0), Kind.PX4)
        daemon.wait_for("Estimate is OK")
        maps = Path(f"/proc/{daemon._process.pid}/maps").read_text().splitlines()
        status = Path(f"/proc/{daemon._process.pid}/status").read_text()
        assert daemon.stop(signal.SIGTERM) == 0
    assert re.search(r"^Seccomp:\s*2$", status, flags=re.MULTILINE)
    assert [line for line in maps if "wx" in line.split()[1]] == []
    assert len(Record(record, daemon.config).of("ODOMETRY")) > 20
    assert (tmp_path / "checkpoint").stat().st_size > 1000
    assert "not permitted" not in daemon.words.read_text()


def test_the_lidars_process_lives_under_the_same(tmp_path, allowed):
    def filters(unit):
        return settings(unit, "SystemCallFilter")

    assert filters(LIDAR) == filters(PLAIN)
    with Listener() as daemon, Device(small(), "127.0.0.2") as device:
        options = (device.command_port, daemon.port, MOUNTED)
        with LidarProcess(tmp_path, *options, preexec_fn=lambda: confine(allowed)) as lidar:
            wait_until(lambda: len(daemon.read()) >= 3)
            maps = Path(f"/proc/{lidar.number}/maps").read_text().splitlines()
            assert lidar.stop(signal.SIGTERM) == 0
    assert [line for line in maps if "wx" in line.split()[1]] == []
    assert "not permitted" not in lidar.words.read_text()


def test_the_filter_forbids_what_it_says(allowed):
    code = "import os\ntry: os.setuid(0)\nexcept PermissionError: print('refused')"
    result = subprocess.run(
        [sys.executable, "-c", code],
        preexec_fn=lambda: confine(allowed),
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == "refused\n"
