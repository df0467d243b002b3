"""The unit file, as systemd itself reads it."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app

UNIT = Path(__file__).resolve().parent.parent / "systemd" / "ekf-companion.service"
COMMAND = re.search(r"^ExecStart=(\S+) (.*)$", UNIT.read_text(), flags=re.MULTILINE)


def verify(tmp_path, text):
    """Give what systemd has to say of a unit whose program exists."""
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed (Debian and Ubuntu: package systemd)")
    path = tmp_path / UNIT.name
    path.write_text(text.replace(COMMAND[1], sys.executable))
    result = subprocess.run(
        [analyze, "verify", path], capture_output=True, text=True, check=False, timeout=60
    )
    return result.returncode, result.stdout + result.stderr


def test_systemd_reads_every_line(tmp_path):
    assert verify(tmp_path, UNIT.read_text()) == (0, "")


def test_systemd_would_complain_of_a_key_that_it_does_not_know(tmp_path):
    _, words = verify(tmp_path, UNIT.read_text().replace("WatchdogSec=", "WatchDogSec="))
    assert "WatchDogSec" in words


def test_the_program_takes_the_arguments_that_systemd_gives_it():
    assert COMMAND[1] == "/opt/ekf-companion/bin/ekf-companion"
    result = CliRunner().invoke(app, COMMAND[2].replace("/etc/", "/nowhere/").split())
    assert result.exit_code == 2
    assert "/nowhere/ekf-companion/config.yaml: cannot be read" in result.stderr


def test_the_state_that_a_restart_goes_on_from_lies_where_systemd_lets_it():
    folder = re.search(r"^StateDirectory=(.*)$", UNIT.read_text(), flags=re.MULTILINE)[1]
    assert COMMAND[2].endswith(f" --checkpoint /var/lib/{folder}/checkpoint")
