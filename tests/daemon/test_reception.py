"""Who keeps the place of the one client of a server, by what the session makes of what it says."""

import asyncio
import contextlib
import socket

import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import LinkConfig
from ekf_companion.daemon.reception import deliver, open_reception
from ekf_companion.link import link as link_module
from ekf_companion.mavlink.codec import Sender, pack
from ekf_companion.mavlink.session import Session, SessionOptions
from ekf_companion.mavlink.signing import Signing
from tests.link.test_link import free_port, running, until

KEY = bytes(range(32))
SILENT = 0.4
"""Seconds that a client may say nothing of use, here."""


class Server:
    """A session on a link that waits for its client, as the daemon has it."""

    def __init__(self, *, is_signed):
        self.port = free_port(socket.SOCK_STREAM)
        signing = Signing(KEY) if is_signed else None
        self.session = Session(SessionOptions(), signing)
        self.link = open_reception(
            Config(link=LinkConfig(url=f"tcpin:127.0.0.1:{self.port}")),
            is_signed=is_signed,
            on_read=lambda got: deliver(got, self.session.receive, self.session, self.link),
        )

    def connect(self):
        return socket.create_connection(("127.0.0.1", self.port))


async def says(client, word, seconds):
    """Have a client say the same ten times a second, for a while or until it is sent away."""
    with contextlib.suppress(OSError):
        for _ in range(round(10 * seconds)):
            client.send(word())
            await asyncio.sleep(0.1)


def junk():
    return b"x"


def radio():
    return Sender(51, 68).message("RADIO_STATUS", rssi=1)


def unsigned():
    return Sender(1, 1).message("HEARTBEAT", type=2, autopilot=12)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch):
    monkeypatch.setattr(link_module, "SILENT", SILENT)
    monkeypatch.setattr(link_module, "FIRST_DELAY", 0.02)


@pytest.mark.parametrize(
    ("word", "is_signed"), [(junk, False), (junk, True), (radio, True), (unsigned, True)]
)
def test_a_tcp_client_that_says_nothing_to_believe_makes_room_for_the_autopilot(word, is_signed):
    """Rule 35: what is taken of a link by a stranger comes back."""

    async def scenario():
        server = Server(is_signed=is_signed)
        async with running(server.link):
            await until(lambda: server.link._server is not None)
            stranger = server.connect()
            await until(lambda: server.link.is_open)
            squatting = asyncio.create_task(says(stranger, word, 60.0))
            await asyncio.sleep(2.0 * SILENT)
            with server.connect() as autopilot:
                await until(lambda: server.link.opened == 2)
                signing = Signing(KEY) if is_signed else None
                heartbeat = pack("HEARTBEAT", type=2, autopilot=12)
                now_ns = server.link._clock()
                autopilot.send(Sender(1, 1, signing).frame("HEARTBEAT", heartbeat, now_ns))
                await until(lambda: server.session.heard == 1)
            squatting.cancel()
            stranger.close()

    asyncio.run(scenario())


def test_a_tcp_client_that_is_accepted_keeps_its_place(monkeypatch):
    monkeypatch.setattr(link_module, "SILENT", 5 * SILENT)  # a busy machine may be late

    async def scenario():
        server = Server(is_signed=False)
        async with running(server.link):
            await until(lambda: server.link._server is not None)
            with server.connect() as autopilot:
                await until(lambda: server.link.is_open)
                speaking = asyncio.create_task(says(autopilot, unsigned, 60.0))
                await asyncio.sleep(6.0 * SILENT)
                with server.connect():
                    await until(lambda: server.link.refused[link_module.NOT_FIRST] == 1)
                assert server.link.opened == 1
                speaking.cancel()

    asyncio.run(scenario())
