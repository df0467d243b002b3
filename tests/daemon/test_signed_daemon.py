"""The daemon with a secret: whom it hears, what it sends, keeps and says. Rule 34 throughout."""

import contextlib
import socket
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from ekf_companion.logs import tlog
from ekf_companion.mavlink.signing import time_of
from tests.daemon.test_daemon import Daemon, free_port
from tests.daemon.waiting import LIMIT

KEY = bytes(range(200, 232))


class Autopilot:
    """pymavlink at the other end, which signs, and believes signed frames alone."""

    def __init__(self, port):
        self.mav = dialect.MAVLink(None, srcSystem=7, srcComponent=1)
        self.mav.signing.secret_key = KEY
        self.mav.signing.sign_outgoing = True
        self.mav.signing.timestamp = time_of(time.time_ns())
        self.sent = []
        self._port = port

    def __enter__(self):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", self._port))
        self._socket.settimeout(0.1)
        return self

    def __exit__(self, *_):
        self._socket.close()

    def heartbeat(self):
        self.sent.append(self.mav.heartbeat_encode(2, 12, 0, 0, 4).pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        self.send(self.sent[-1])

    def send(self, data):
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def answers(self, count):
        """Send heartbeats until so many frames came back that are believed."""
        end, found = time.monotonic() + LIMIT, []
        while len(found) < count:
            assert time.monotonic() < end
            self.heartbeat()
            with contextlib.suppress(OSError):
                found.append(self.mav.decode(bytearray(self._socket.recv(1000))))
        return found


@pytest.fixture
def setup(tmp_path):
    (tmp_path / "secret").write_text(KEY.hex() + "\n", encoding="ascii")
    (tmp_path / "secret").chmod(0o600)
    config = f"signing: {{key_file: {tmp_path}/secret}}\nhttp: {{port: 0}}\n"
    port = free_port()
    options = ["--link", f"udpin:127.0.0.1:{port}", "--record", f"{tmp_path}/flight.tlog"]
    options += ["--checkpoint", f"{tmp_path}/checkpoint", "--log-level", "DEBUG"]
    return tmp_path, config, port, options


def test_the_daemon_hears_who_knows_the_secret_and_nobody_twice(setup):
    folder, config, port, options = setup
    with Autopilot(port) as theirs:
        with Daemon(folder, *options, config=config) as daemon:
            daemon.wait_for(": open")
            theirs.mav.signing.sign_outgoing = False
            for _ in range(10):
                theirs.heartbeat()
            theirs.sent.clear()
            theirs.mav.signing.sign_outgoing = True
            assert all(message.get_signed() for message in theirs.answers(8))
            daemon.wait_for("Autopilot found: system 7")
            assert daemon.stop() == 0
            words = daemon.words.read_text()
        last = max(theirs.mav.signing.stream_timestamps.values())

        with Daemon(folder, *options, config=config) as daemon:
            daemon.wait_for(": open")
            for data in theirs.sent:
                theirs.send(data)
            # Answered, and so read, behind all that was replayed
            again = theirs.answers(1)
            assert again[0].get_signed()
            assert min(theirs.mav.signing.stream_timestamps.values()) > last
            assert daemon.stop() == 0
            words += daemon.words.read_text()

    # What was refused is not recorded: neither the unsigned ones nor the replayed
    for name, is_first in (("flight.tlog", True), ("flight-2.tlog", False)):
        recorded = [raw for _, raw in tlog.read(folder / name).frames()]
        heard = [raw for raw in recorded if raw[6] == 1]
        assert heard
        assert all(raw[2] == 1 for raw in heard)
        assert len(set(heard)) == len(heard)
        if is_first:
            first = set(heard)
        else:
            assert not first & set(heard)
    for path in (folder / "checkpoint.signing", folder / "flight.tlog"):
        assert KEY not in path.read_bytes()
    assert KEY.hex() not in words


@pytest.mark.campaign
def test_who_does_not_know_the_secret_is_not_answered_before_the_autopilot_speaks(setup):
    """A telemetry radio signs nothing, and its status is let in: it says not where to send."""
    folder, config, port, options = setup
    radio = dialect.MAVLink(None, srcSystem=51, srcComponent=68)
    status = radio.radio_status_encode(1, 1, 1, 1, 1, 0, 0).pack(radio)
    with (
        Autopilot(port) as stranger,
        Autopilot(port) as theirs,
        Daemon(folder, *options, config=config) as daemon,
    ):
        daemon.wait_for(": open")
        end = time.monotonic() + 2.0  # two of our heartbeats
        while time.monotonic() < end:
            stranger.send(status)
            with pytest.raises(OSError, match="timed out"):
                stranger._socket.recv(1000)
        assert theirs.answers(3)
        assert daemon.stop() == 0


def test_a_secret_that_others_can_read_ends_the_start_with_a_sentence(setup):
    folder, config, _, options = setup
    (folder / "secret").chmod(0o644)
    with Daemon(folder, *options, config=config) as daemon:
        assert daemon.wait() == 2
        words = daemon.words.read_text()
    assert words.splitlines()[-1] == (
        f"ekf-companion: signing.key_file: {folder}/secret: has mode 0644, so that others may use "
        f"it; chmod 600 {folder}/secret"
    )
