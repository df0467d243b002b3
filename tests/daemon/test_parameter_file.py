"""What is set over MAVLink outlives the daemon."""

import json
import signal
import socket
import time

import pytest

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from tests.daemon.test_daemon import Daemon, free_port
from tests.daemon.waiting import LIMIT

PATIENCE = LIMIT
"""For a loaded machine, s; nothing waits so long."""


class Station:
    """A ground station and an autopilot on one socket."""

    def __init__(self, port):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.settimeout(0.2)
        self._autopilot, self._sender = Sender(1, 1), Sender(255, 190)
        self._splitter = Splitter()

    def close(self):
        self._socket.close()

    def ask(self, name, expected, **fields):
        """Say it until the parameter is told to have this value."""
        end = time.monotonic() + PATIENCE
        target = {"target_system": 1, "target_component": 194}
        told = []
        while time.monotonic() < end:
            heartbeat = self._autopilot.message("HEARTBEAT", type=2, autopilot=12)
            try:
                self._socket.send(heartbeat)
                self._socket.send(self._sender.message(name, **target, **fields))
                for frame in self._splitter.feed(self._socket.recv(65535)):
                    if frame.message_id == IDS["PARAM_VALUE"]:
                        told.append(unpack(frame).param_value)
            except (TimeoutError, ConnectionRefusedError):
                time.sleep(0.05)
            if told and told[-1] == pytest.approx(expected):
                return
        raise AssertionError(f"{name}: told {told[-5:]}, expected {expected}")


def test_rule_30_a_parameter_that_was_set_counts_after_a_restart_and_the_file_stays(tmp_path):
    """Rule 30."""
    port = free_port()
    checkpoint = tmp_path / "checkpoint"
    options = ("--link", f"udpin:127.0.0.1:{port}", "--checkpoint", str(checkpoint))
    config = "baro:\n  std: 0.7\n"
    name = {"param_id": b"EC_BARO_NSE"}
    with Daemon(tmp_path, *options, config=config) as daemon:
        daemon.wait_for(": open")
        station = Station(port)
        station.ask("PARAM_REQUEST_READ", 0.7, param_index=-1, **name)
        station.ask("PARAM_SET", 2.5, param_value=2.5, param_type=9, **name)
        station.close()
        assert daemon.stop(signal.SIGTERM) == 0
    assert json.loads((tmp_path / "checkpoint.parameters").read_bytes()) == {"baro.std": 2.5}
    with Daemon(tmp_path, *options, config=config) as daemon:
        daemon.wait_for("baro.std is 2.5, as set over MAVLink")
        station = Station(port)
        station.ask("PARAM_REQUEST_READ", 2.5, param_index=-1, **name)
        station.close()
        assert daemon.stop(signal.SIGTERM) == 0
