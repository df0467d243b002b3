"""What the stores of the tests hold."""

import pytest
from typer.testing import CliRunner

from sim_autopilot.__main__ import app as sim


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """Return the bytes of a short flight's log."""
    path = tmp_path_factory.mktemp("flight") / "a.tlog"
    words = ("generate", "--duration", "12", "--imu-rate", "50")
    assert CliRunner().invoke(sim, [*words, "-o", str(path)]).exit_code == 0
    return path.read_bytes()
