"""The live estimate for PlotJuggler and Foxglove, over real sockets."""

import asyncio
import contextlib
import json
import socket
import threading
import time

import pytest
from websockets.sync.client import connect

from ekf_companion.config.config import parse_config
from ekf_companion.config.service import LiveConfig
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.daemon.exporters import open_exporters
from ekf_companion.errors import ConfigError
from tests.daemon.test_daemon import free_port
from tests.daemon.waiting import LIMIT, close, wait_until
from tests.engine.conversation import cycles
from tests.status.test_observer import Watched


@contextlib.contextmanager
def exporting(**config):
    """Export what a companion that was fed has estimated; yield it."""
    watched = Watched().feed(cycles(2.0))
    watched.observer._clock = unix_clock
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    exporters = open_exporters(LiveConfig(**config), watched.observer, loop)
    try:
        yield watched
    finally:
        close(*exporters)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def test_plotjuggler_gets_json_with_the_time_in_each_datagram():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        ours.settimeout(LIMIT)
        with exporting(udp_json=f"127.0.0.1:{ours.getsockname()[1]}") as watched:
            first, second = (json.loads(ours.recv(65536)) for _ in range(2))
    assert first["timestamp"] < second["timestamp"] <= time.time()
    data = first["ekf_companion"]
    assert data["t_s"] == pytest.approx(watched.companion.pipeline.stamp_ns * 1e-9)
    assert {"roll_deg", "pitch_deg", "heading_deg", "vel_ned_m_s", "ratios"} <= set(data)


def test_where_nobody_listens_the_next_datagram_is_sent_all_the_same():
    port = free_port()
    with exporting(udp_json=f"127.0.0.1:{port}"):
        # Refusals of the first datagrams have come back by then
        time.sleep(0.3)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
            ours.bind(("127.0.0.1", port))
            ours.settimeout(LIMIT)
            assert json.loads(ours.recv(65536))


def test_foxglove_is_offered_the_numbers():
    pytest.importorskip("foxglove")
    port = free_port(socket.SOCK_STREAM)
    with exporting(foxglove_port=port):

        def open_socket():
            with contextlib.suppress(OSError):
                return connect(
                    f"ws://127.0.0.1:{port}",
                    subprotocols=["foxglove.sdk.v1", "foxglove.websocket.v1"],
                    proxy=None,
                )

        with wait_until(open_socket) as client:
            topics = set()
            while "/ekf_companion" not in topics:
                message = client.recv(timeout=LIMIT)
                if isinstance(message, str) and (found := json.loads(message)):
                    topics |= {one["topic"] for one in found.get("channels", [])}


@pytest.mark.parametrize(
    ("origin", "host"),
    [("https://evil.example", None), ("null", None), ("http://evil.example", "evil.example")],
)
def test_foxglove_is_no_page_of_another_site(origin, host, caplog):
    """A browser lets any page open a WebSocket to this computer: it would read where we are."""
    pytest.importorskip("foxglove")
    port = free_port(socket.SOCK_STREAM)
    with exporting(foxglove_port=port):
        wait_until(lambda: "Foxglove on" in caplog.text or is_open(port))
        with socket.create_connection(("127.0.0.1", port), LIMIT) as client:
            client.sendall(
                f"GET / HTTP/1.1\r\nHost: {host or f'127.0.0.1:{port}'}\r\nOrigin: {origin}\r\n"
                "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n"
                "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
            )
            answer = b"".join(iter(lambda: client.recv(4096), b""))
    assert answer.startswith(b"HTTP/1.1 421" if host else b"HTTP/1.1 403")
    assert f"refused a page of '{origin}'" in caplog.text


def is_open(port):
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), LIMIT):
        return True


def test_a_port_of_foxglove_that_is_taken_is_told_and_ends_nothing(caplog):
    pytest.importorskip("foxglove")
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        exporting(foxglove_port=other.getsockname()[1]),
    ):
        wait_until(lambda: "flying without it" in caplog.text)


def test_an_address_that_is_none_is_refused():
    with pytest.raises(ConfigError, match=r"live\.udp_json: 'laptop': write it as HOST:PORT"):
        parse_config({"live": {"udp_json": "laptop"}}, "quad.yaml")
