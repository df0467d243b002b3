"""Links over real sockets on the loopback and real pseudo-terminals."""

import asyncio
import contextlib
import os
import socket

import pytest

from ekf_companion.errors import LinkError
from ekf_companion.link import link as link_module
from ekf_companion.link.address import DEFAULT_BAUD, Address, Kind, parse_url
from ekf_companion.link.link import Link
from tests.daemon.waiting import LIMIT


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udpin:0.0.0.0:14540", Address(kind=Kind.UDP_IN, host="0.0.0.0", port=14540)),
        ("udpin://:14540", Address(kind=Kind.UDP_IN, host="0.0.0.0", port=14540)),
        ("udpout:10.0.0.2:14550", Address(kind=Kind.UDP_OUT, host="10.0.0.2", port=14550)),
        ("udpout://gcs:14550", Address(kind=Kind.UDP_OUT, host="gcs", port=14550)),
        (
            "udpbcast::14550",
            Address(kind=Kind.UDP_BROADCAST, host="255.255.255.255", port=14550),
        ),
        ("tcp:127.0.0.1:5760", Address(kind=Kind.TCP_OUT, host="127.0.0.1", port=5760)),
        ("tcpout://[::1]:5760", Address(kind=Kind.TCP_OUT, host="::1", port=5760)),
        ("tcpin://0.0.0.0:5760", Address(kind=Kind.TCP_IN, host="0.0.0.0", port=5760)),
        (
            "udp://:14540@10.0.0.2:14557",
            Address(kind=Kind.UDP_IN, host="0.0.0.0", port=14540, remote=("10.0.0.2", 14557)),
        ),
        ("udp://:14540@", Address(kind=Kind.UDP_IN, host="0.0.0.0", port=14540)),
        ("/dev/ttyACM0", Address(kind=Kind.SERIAL, device="/dev/ttyACM0")),
        ("/dev/ttyS1,57600", Address(kind=Kind.SERIAL, device="/dev/ttyS1", baud=57600)),
        ("/dev/ttyS1:57600", Address(kind=Kind.SERIAL, device="/dev/ttyS1", baud=57600)),
        ("serial:/dev/ttyS1:57600", Address(kind=Kind.SERIAL, device="/dev/ttyS1", baud=57600)),
        (
            "serial:///dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0:921600",
            Address(kind=Kind.SERIAL, device="/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0"),
        ),
    ],
)
def test_every_usual_spelling_names_its_link(url, address):
    assert parse_url(url) == address
    assert parse_url(str(address).removesuffix("@")).kind is address.kind


def test_a_bare_udp_is_read_as_listening_with_a_warning():
    address = parse_url("udp:0.0.0.0:14550")
    assert address.kind is Kind.UDP_IN
    assert "udpout" in address.warning


def test_the_usual_rate_of_a_serial_port_is_the_default():
    assert parse_url("/dev/ttyAMA0").baud == DEFAULT_BAUD == 921600


@pytest.mark.parametrize(
    ("url", "remedy"),
    [
        ("127.0.0.1:14550", "write for example udpin"),
        ("com3", "write for example udpin"),
        ("udpin:14550", "a host and a port"),
        ("udpin:0.0.0.0", "a host and a port"),
        ("udpin:0.0.0.0:99999", "14540 and 14550 are usual"),
        ("udpout::14550", "the host to reach"),
        ("serial:ttyACM0", "as in serial:/dev/ttyACM0:921600"),
        ("serial:/dev/ttyACM0:7", "no rate of a serial port"),
        ("udp://:14540@?ids=1,240", "leave out"),
        ("", "not a link"),
    ],
)
def test_what_names_no_link_is_refused_with_a_remedy(url, remedy):
    with pytest.raises(LinkError, match=remedy):
        parse_url(url)


@contextlib.asynccontextmanager
async def running(*links):
    """Run links until the block ends; TaskGroup is not in Python 3.10."""
    tasks = [asyncio.create_task(link.run()) for link in links]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        for task in tasks:
            with contextlib.suppress(asyncio.CancelledError):
                await task


async def until(condition):
    async def wait():
        while not condition():  # noqa: ASYNC110  # the condition is the kernel's, not ours
            await asyncio.sleep(0.002)

    await asyncio.wait_for(wait(), LIMIT)


async def next_data(link):
    return (await asyncio.wait_for(link.receive(), LIMIT)).data


async def read_exactly(link, count):
    data = b""
    while len(data) < count:
        data += await next_data(link)
    return data


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(autouse=True)
def _quick_to_reopen(monkeypatch):
    monkeypatch.setattr(link_module, "FIRST_DELAY", 0.02)
    monkeypatch.setattr(link_module, "LAST_DELAY", 0.1)


def test_udp_carries_both_ways_and_answers_the_last_who_spoke():
    async def scenario():
        port = free_port()
        ours = Link(parse_url(f"udpin:127.0.0.1:{port}"))
        first, second = (Link(parse_url(f"udpout:127.0.0.1:{port}")) for _ in range(2))
        async with running(ours, first, second):
            await until(lambda: ours.is_open and first.is_open and second.is_open)
            ours.send(b"nobody yet")
            assert ours.unsent == 1
            first.send(b"one")
            assert await next_data(ours) == b"one"
            ours.send(b"to one")
            assert await next_data(first) == b"to one"
            second.send(b"two")
            assert await next_data(ours) == b"two"
            ours.send(b"to two")
            assert await next_data(second) == b"to two"

    asyncio.run(scenario())


def test_udp_asks_the_kernel_for_a_large_buffer():
    async def scenario():
        ours = Link(parse_url(f"udpin:127.0.0.1:{free_port()}"))
        async with running(ours):
            await until(lambda: ours.is_open)
            with socket.socket(fileno=os.dup(ours._port.fileno())) as twin:
                # The kernel may cap it (net.core.rmem_max), and says twice what it gave
                return twin.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    size = asyncio.run(scenario())
    with open("/proc/sys/net/core/rmem_max", encoding="ascii") as limit:
        assert size >= 2 * min(1 << 20, int(limit.read()))


def test_a_udp_peer_that_has_not_started_is_no_error():
    async def scenario():
        port = free_port()
        ours = Link(parse_url(f"udpout:127.0.0.1:{port}"))
        async with running(ours):
            await until(lambda: ours.is_open)
            for _ in range(5):
                ours.send(b"anybody?")
                await asyncio.sleep(0.002)  # the refusal comes back over the real network stack
            theirs = Link(parse_url(f"udpin:127.0.0.1:{port}"))
            async with running(theirs):
                await until(lambda: theirs.is_open)
                ours.send(b"hello")
                assert await next_data(theirs) == b"hello"
                theirs.send(b"welcome")
                assert await next_data(ours) == b"welcome"
            assert ours.opened == 1

    asyncio.run(scenario())


def test_tcp_carries_both_ways_and_comes_back_when_either_end_restarts():
    async def scenario():
        port = free_port(socket.SOCK_STREAM)
        states = []
        client = Link(parse_url(f"tcp:127.0.0.1:{port}"), on_state=states.append)
        async with running(client):
            for turn in range(3):
                server = Link(parse_url(f"tcpin:127.0.0.1:{port}"))
                async with running(server):
                    await until(lambda server=server: client.is_open and server.is_open)
                    client.send(b"hello")
                    assert await read_exactly(server, 5) == b"hello"
                    server.send(b"welcome")
                    assert await read_exactly(client, 7) == b"welcome"
                await until(lambda: not client.is_open)
                assert client.opened == turn + 1
        assert states == [True, False] * 3

    asyncio.run(scenario())


def test_a_new_tcp_client_takes_the_place_of_a_silent_one(monkeypatch):
    monkeypatch.setattr(link_module, "SILENT", 0.2)

    async def scenario():
        port = free_port(socket.SOCK_STREAM)
        server = Link(parse_url(f"tcpin:127.0.0.1:{port}"))
        async with running(server):
            await until(lambda: server._server is not None)
            first = socket.create_connection(("127.0.0.1", port))
            await until(lambda: server.is_open)
            second = Link(parse_url(f"tcp:127.0.0.1:{port}"))
            async with running(second):
                await until(lambda: server.opened == 2)
                second.send(b"alive")
                assert await read_exactly(server, 5) == b"alive"
            first.close()

    asyncio.run(scenario())


def test_a_tcp_client_that_speaks_keeps_its_place_and_strangers_are_counted(caplog, monkeypatch):
    monkeypatch.setattr(link_module, "SILENT", 60.0)

    async def scenario():
        port = free_port(socket.SOCK_STREAM)
        server = Link(parse_url(f"tcpin:127.0.0.1:{port}"))
        async with running(server):
            await until(lambda: server._server is not None)
            with socket.create_connection(("127.0.0.1", port)) as autopilot:
                autopilot.settimeout(LIMIT)
                for k in range(1, 6):
                    autopilot.send(b"beat")
                    assert await read_exactly(server, 4) == b"beat"
                    with socket.create_connection(("127.0.0.1", port)) as stranger:
                        await until(lambda k=k: server.refused[link_module.NOT_FIRST] == k)
                        stranger.settimeout(LIMIT)
                        assert stranger.recv(100) == b""  # sent away
                server.send(b"odometry")
                assert autopilot.recv(100) == b"odometry"
            assert server.opened == 1
        assert caplog.text.count("another client is refused") == 1

    asyncio.run(scenario())


def test_a_slow_tcp_reader_costs_whole_messages_and_they_are_counted():
    async def scenario():
        port = free_port(socket.SOCK_STREAM)
        server = Link(parse_url(f"tcpin:127.0.0.1:{port}"))
        async with running(server):
            await until(lambda: server._server is not None)
            with socket.create_connection(("127.0.0.1", port)) as client:
                await until(lambda: server.is_open)
                messages = [bytes([n % 251]) * 1000 for n in range(20000)]
                for message in messages:
                    server.send(message)
                assert server.unsent > 0
                client.setblocking(False)
                received = bytearray()

                def drained():
                    with contextlib.suppress(BlockingIOError):
                        while chunk := client.recv(1 << 20):
                            received.extend(chunk)
                    return len(received) >= 1000 * (len(messages) - server.unsent)

                await until(drained)
                # Each message whole, and in order of sending
                chunks = [bytes(received[n : n + 1000]) for n in range(0, len(received), 1000)]
                assert all(len(set(chunk)) == 1 for chunk in chunks)
                assert chunks[-1] == messages[-1]

    asyncio.run(scenario())


def test_a_serial_port_carries_both_ways_and_survives_that_it_vanishes(tmp_path):
    async def scenario():
        device = tmp_path / "ttyFC"
        ours = Link(parse_url(f"serial:{device}:57600"))
        async with running(ours):
            for turn in range(3):
                master, slave = os.openpty()
                device.symlink_to(os.ttyname(slave))
                await until(lambda: ours.is_open)
                # A flush at opening takes what came before it
                os.write(master, b"\x00\xfd\r\n\x03\x11raw")
                assert await read_exactly(ours, 9) == b"\x00\xfd\r\n\x03\x11raw"
                ours.send(b"back\n")
                assert os.read(master, 100) == b"back\n"
                device.unlink()
                os.close(slave)
                os.close(master)
                await until(lambda: not ours.is_open)
                assert ours.opened == turn + 1

    asyncio.run(scenario())


def test_restarts_leak_no_descriptor(tmp_path):
    async def scenario():
        device = tmp_path / "ttyFC"
        ours = Link(parse_url(f"serial:{device}:57600"))
        counts = []
        async with running(ours):
            for _ in range(20):
                master, slave = os.openpty()
                device.symlink_to(os.ttyname(slave))
                await until(lambda: ours.is_open)
                device.unlink()
                os.close(slave)
                os.close(master)
                await until(lambda: not ours.is_open)
                counts.append(len(os.listdir("/proc/self/fd")))
        assert max(counts) == min(counts)

    asyncio.run(scenario())


def test_a_caller_who_is_too_slow_loses_the_oldest_and_it_is_counted(monkeypatch):
    monkeypatch.setattr(link_module, "QUEUE_LENGTH", 8)

    async def scenario():
        port = free_port()
        ours, theirs = (
            Link(parse_url(f"udpin:127.0.0.1:{port}")),
            Link(parse_url(f"udpout:127.0.0.1:{port}")),
        )
        async with running(ours, theirs):
            await until(lambda: ours.is_open and theirs.is_open)
            for n in range(20):
                theirs.send(bytes([n]))
            await until(lambda: ours.bytes_in == 20)
            assert ours.dropped == 12
            assert [await next_data(ours) for _ in range(8)] == [bytes([n]) for n in range(12, 20)]

    asyncio.run(scenario())


def test_what_is_read_carries_the_time_of_the_links_clock():
    async def scenario():
        port = free_port()
        ours = Link(parse_url(f"udpin:127.0.0.1:{port}"), clock=lambda: 42)
        theirs = Link(parse_url(f"udpout:127.0.0.1:{port}"))
        async with running(ours, theirs):
            await until(lambda: ours.is_open and theirs.is_open)
            theirs.send(b"now")
            assert (await asyncio.wait_for(ours.receive(), LIMIT)).now_ns == 42

    asyncio.run(scenario())


def test_a_taken_port_is_tried_again_until_it_is_free(caplog):
    async def scenario():
        port = free_port()
        taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        taken.bind(("127.0.0.1", port))
        ours = Link(parse_url(f"udpin:127.0.0.1:{port}"))
        async with running(ours):
            await until(lambda: "in use, by another program" in caplog.text)  # us
            assert not ours.is_open
            taken.close()
            await until(lambda: ours.is_open)
        assert caplog.text.count("in use") == 1

    asyncio.run(scenario())
