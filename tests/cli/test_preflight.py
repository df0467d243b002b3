"""``ekf-companion preflight``: against the real daemon, beside the fake autopilot and alone."""

import contextlib
import json
import re
import socket
import subprocess
import sys
import threading

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from sim_autopilot.autopilot import Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.faults.fault import parse
from sim_autopilot.flight import Flight
from sim_autopilot.fly import fly, over, run
from tests.cli.served import serving_once
from tests.cli.test_status import daemon as unflown  # noqa: F401  # a fixture
from tests.daemon.test_daemon import Daemon, Open, free_port, plan
from tests.daemon.waiting import LIMIT

SPEED = 3.0


def preflight(*arguments):
    return CliRunner().invoke(app, ["preflight", *map(str, arguments)])


def standing(folder, *faults):
    """Yield the address of a daemon beside an autopilot that stands."""
    return beside(folder, Flight.plan("static", SimConfig(), duration=300.0), *faults)


@contextlib.contextmanager
def beside(folder, planned, *faults):
    """Yield the address of a daemon beside an autopilot that does as planned."""
    port, http_port = free_port(), free_port(socket.SOCK_STREAM)
    config = f"http: {{port: {http_port}}}\n"
    flight = Open(planned)
    wrong = [parse(one) for one in faults]

    async def body(link):
        await fly(flight, link, personality=Kind.PX4, faults=wrong, speed=SPEED, wait=LIMIT)

    with Daemon(folder, "--link", f"udpin:127.0.0.1:{port}", config=config) as daemon:
        daemon.wait_for(f"Status on http://127.0.0.1:{http_port}/")
        thread = threading.Thread(target=lambda: run(over(f"udpout:127.0.0.1:{port}", body)))
        thread.start()
        try:
            yield f"http://127.0.0.1:{http_port}"
        finally:
            flight.land()
            thread.join()


def test_it_waits_until_the_vehicle_is_ready(tmp_path):
    with standing(tmp_path) as url:
        result = preflight("--url", url, "--wait", LIMIT)
        assert result.exit_code == 0, result.output
        first, second = result.stdout.splitlines()
        assert first == "ready"
        assert re.fullmatch(rf"system 1, px4 [\d.]+, on udpin:127.0.0.1:\d+; {url}", second)
        again = preflight("--url", url, "--json")
    found = json.loads(again.stdout)
    assert (again.exit_code, found["ready"], found["sentence"]) == (0, True, "ready")
    assert f"{found['vehicle']}; {found['daemon']}" == second


@pytest.mark.campaign
def test_a_heading_that_is_off_over_the_wire_is_exit_code_5(tmp_path):
    with standing(tmp_path, "own-estimate:heading=90") as url:
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", "preflight", "--url", url]
        for _ in range(20):
            told = subprocess.run(
                [*command, "--wait", "2"], check=False, capture_output=True, text=True
            )
            if "heading differs" in told.stdout:
                break
    assert told.returncode == 5
    assert told.stdout.startswith("not ready: heading differs from the autopilot's by ")
    # What was waited for went to the standard error, each sentence once
    waited = told.stderr.splitlines()
    assert waited == list(dict.fromkeys(waited))
    assert all(line.endswith(" (waiting)") for line in waited)


@pytest.mark.campaign
def test_in_the_air_it_says_so_and_waits_for_nothing(tmp_path):
    with beside(tmp_path, plan(600.0, boot=20.0, skip=10.0)) as url:
        command = [sys.executable, "-W", "error", "-m", "ekf_companion", "preflight", "--url", url]
        told = subprocess.run(
            [*command, "--wait", str(100.0 * LIMIT)],
            check=False,
            capture_output=True,
            text=True,
            timeout=LIMIT,
        )
        data = json.loads(preflight("--url", url, "--json").stdout)
    assert told.returncode == 6, told
    assert told.stdout.startswith("armed already: this is a check for before take-off")
    assert "not ready" not in told.stdout
    assert (data["ready"], data["causes"][0]) == (False, "armed")


def test_where_nothing_is_heard_it_is_not_ready_and_json_says_why(unflown):  # noqa: F811
    result = preflight("--url", unflown, "--json")
    assert result.exit_code == 5
    found = json.loads(result.stdout)
    assert found["causes"] == ["no input"]
    assert found["sentence"].startswith("not ready: not a byte has come over the link")


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_where_nothing_answers_the_exit_code_is_4(options):
    url = f"http://127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    result = preflight("--url", url, *options)
    assert result.exit_code == 4
    assert result.stdout == ""
    assert "nothing answers (Connection refused)" in result.stderr


def test_a_daemon_from_before_the_upgrade_is_named_as_one():
    with serving_once(json.dumps({"health": {"is_ok": True, "words": "ok"}}).encode()) as url:
        result = preflight("--url", url)
    assert result.exit_code == 5
    assert "not ready: the daemon is older than this command" in result.stdout
