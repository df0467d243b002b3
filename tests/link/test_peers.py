"""Whose datagrams are heard: by the rules, and over real sockets."""

import asyncio
import contextlib
import socket
import time

import pytest

from ekf_companion.config.config import parse_config
from ekf_companion.errors import ConfigError, LinkError
from ekf_companion.link.address import parse_url
from ekf_companion.link.link import Link
from ekf_companion.link.peers import NOT_NAMED, NOT_PINNED, RELEASE_NS, SAME_HOST_NS, Peers
from ekf_companion.status.collect import link_state
from tests.daemon.waiting import LIMIT

A, A2, B = ("10.0.0.2", 14550), ("10.0.0.2", 14551), ("10.0.0.9", 14550)


def pinned_to(sender, **options):
    peers = Peers(**options)
    assert peers.accepts(sender, 0)
    peers.pin(sender, 0)
    return peers


def test_before_the_autopilot_speaks_everybody_is_heard_and_whoever_is_believed_is_answered():
    peers = Peers()
    assert peers.accepts(A, 0)
    assert peers.target is None  # nothing right has come from there yet
    assert peers.accepts(B, 0)
    peers.set_target(B)
    assert peers.target == B
    peers.pin(A, 0)
    assert peers.target == A
    peers.set_target(B)
    assert peers.target == A


def test_while_the_autopilot_speaks_nobody_else_is_heard():
    peers = pinned_to(A)
    for now_ns in range(0, 100 * RELEASE_NS, SAME_HOST_NS):
        assert not peers.accepts(B, now_ns)
        assert not peers.accepts(A2, now_ns)
        assert peers.accepts(A, now_ns)
        peers.pin(A, now_ns)
    assert peers.target == A
    assert peers.refused == {NOT_PINNED: 1000}


def test_datagrams_that_hold_nothing_of_the_autopilots_do_not_keep_the_pin():
    peers = pinned_to(A)
    for now_ns in range(0, RELEASE_NS + 1, 10**8):
        assert peers.accepts(A, now_ns)
    assert peers.accepts(B, RELEASE_NS + 1)


def test_a_program_that_was_restarted_is_heard_from_another_port_after_a_second_rule_35():
    peers = pinned_to(A)
    assert not peers.accepts(A2, SAME_HOST_NS)
    assert peers.accepts(A2, SAME_HOST_NS + 1)
    assert not peers.accepts(B, SAME_HOST_NS + 1)
    assert peers.target == A  # until it has said something right
    peers.pin(A2, SAME_HOST_NS + 1)
    assert peers.target == A2
    assert not peers.accepts(A, SAME_HOST_NS + 2)


def test_another_host_is_heard_after_five_seconds():
    peers = pinned_to(A)
    assert not peers.accepts(B, RELEASE_NS)
    assert peers.accepts(B, RELEASE_NS + 1)
    assert peers.target == A  # nobody better is known
    peers.pin(B, RELEASE_NS + 2)
    assert peers.target == B


def test_a_broadcast_goes_to_all_again_when_the_autopilot_is_silent():
    everybody = ("255.255.255.255", 14550)
    peers = Peers()
    peers.set_default_target(everybody)
    assert peers.target == everybody
    peers.pin(A, 0)
    peers.set_default_target(everybody)  # the socket was opened again
    assert peers.target == A
    assert peers.accepts(B, RELEASE_NS + 1)
    assert peers.target == everybody


def test_where_all_is_signed_the_autopilot_may_come_from_elsewhere_at_once():
    peers = pinned_to(A, is_signed=True)
    assert peers.accepts(B, 1)
    assert peers.target == A
    peers.pin(B, 1)
    assert peers.target == B


def test_only_the_named_are_heard():
    peers = Peers(is_signed=True)
    peers.allow({"10.0.0.2", "::1"})
    assert [peers.accepts(sender, 0) for sender in (A, A2, B, ("::1", 1, 0, 0))] == [
        True,
        True,
        False,
        True,
    ]
    peers.allow({"10.0.0.2"}, 14551)
    assert [peers.accepts(sender, 0) for sender in (A, A2, B)] == [False, True, False]
    assert peers.refused == {NOT_NAMED: 3}


def test_that_somebody_is_not_heard_is_said_once(caplog):
    peers = pinned_to(A)
    for port in range(1000):
        peers.accepts(("10.0.0.9", port), 0)
    assert caplog.text.count("are refused") == 1
    assert "10.0.0.9 port 0 are refused: not from the autopilot's address" in caplog.text


@pytest.mark.parametrize(
    ("url", "peer", "words"),
    [
        (
            "udpout:10.0.0.2:14550",
            "10.0.0.2",
            "only udpin: and udpbcast: receive from several senders",
        ),
        ("tcpin:0.0.0.0:5760", "10.0.0.2", "the link is tcpin:0.0.0.0:5760; leave the peer out"),
        ("serial:/dev/ttyS1:57600", "10.0.0.2", "leave the peer out"),
        ("udpin:0.0.0.0:14540", "10.0.0.2:x", "no HOST or HOST:PORT, as in 192.168.1.2"),
        ("udpin:0.0.0.0:14540", ":14550", "no HOST or HOST:PORT"),
        ("udpin:0.0.0.0:14540", "10.0.0.2:70000", "70000 is no port; leave it out"),
    ],
)
def test_a_peer_that_cannot_be_meant_is_a_sentence(url, peer, words):
    with pytest.raises(LinkError, match=words):
        Link(parse_url(url), peer=peer)
    with pytest.raises(ConfigError, match=rf"^x\.yaml: link\.peer: .*{words}"):
        parse_config({"link": {"url": url, "peer": peer}}, "x.yaml")


@pytest.mark.parametrize(
    ("peer", "meant"),
    [
        ("10.0.0.2", ("10.0.0.2", 0)),
        ("gcs:14550", ("gcs", 14550)),
        ("[::1]:14550", ("::1", 14550)),
        ("fe80::1", ("fe80::1", 0)),
        ("", None),
    ],
)
def test_a_peer_is_a_host_and_perhaps_a_port(peer, meant):
    assert Link(parse_url("udpin:0.0.0.0:14540"), peer=peer).address.peer == meant


def test_what_is_told_of_the_refused_is_a_copy_and_no_counter_that_goes_on():
    link = Link(parse_url("udpin:127.0.0.1:14540"), peers=pinned_to(A))
    link.peers.accepts(B, 1)
    told = link_state(link).refused
    link.peers.refused["another reason"] += 1
    assert told == {NOT_PINNED: 1}


# Over sockets


@contextlib.asynccontextmanager
async def heard_by(peer="", **options):
    """Return a running link, and what makes a socket that sends to it."""
    with contextlib.ExitStack() as stack:

        def sender(host="127.0.0.1"):
            theirs = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            theirs.bind((host, 0))
            theirs.connect(("127.0.0.1", port))
            theirs.settimeout(LIMIT)
            return theirs

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        link = Link(parse_url(f"udpin:127.0.0.1:{port}"), peer=peer, peers=Peers(**options))
        task = asyncio.create_task(link.run())
        end = time.monotonic() + LIMIT
        while not link.is_open:
            assert time.monotonic() < end
            await asyncio.sleep(0.002)
        yield link, sender
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def receive(link):
    return await asyncio.wait_for(link.receive(), LIMIT)


def test_a_stranger_gets_no_answer_and_no_hearing():
    async def scenario():
        async with heard_by() as (link, sender):
            theirs, stranger = sender(), sender("127.0.0.2")
            theirs.send(b"autopilot")
            received = await receive(link)
            assert received.sender == theirs.getsockname()
            link.send(b"nobody is believed yet")
            assert link.unsent == 1
            link.peers.pin(received.sender, received.now_ns)
            for _ in range(50):
                stranger.send(b"stranger")
            theirs.send(b"again")
            assert (await receive(link)).data == b"again"
            link.send(b"answer")
            assert theirs.recv(100) == b"answer"
            assert link.refused == {NOT_PINNED: 50}
            assert link.bytes_in == len(b"autopilot" + b"again")

    asyncio.run(scenario())


def test_what_a_stranger_sent_before_the_pin_is_not_heard_after_it():
    async def scenario():
        async with heard_by() as (link, sender):
            theirs, stranger = sender(), sender()
            theirs.send(b"autopilot")
            stranger.send(b"stranger")
            theirs.send(b"again")
            first = await receive(link)
            size = len(b"autopilot" + b"stranger" + b"again")
            while link.bytes_in < size:  # noqa: ASYNC110  # the condition is the kernel's
                await asyncio.sleep(0.002)
            link.peers.pin(first.sender, first.now_ns)
            assert (await receive(link)).data == b"again"
            assert link.refused == {NOT_PINNED: 1}

    asyncio.run(scenario())


def test_the_named_host_alone_is_heard():
    async def scenario():
        async with heard_by(peer="127.0.0.2") as (link, sender):
            stranger, theirs = sender(), sender("127.0.0.2")
            stranger.send(b"stranger")
            theirs.send(b"named")
            assert (await receive(link)).data == b"named"
            assert link.refused == {NOT_NAMED: 1}

    asyncio.run(scenario())


def test_a_peer_with_a_port_is_spoken_to_before_it_speaks():
    async def scenario():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as theirs:
            theirs.bind(("127.0.0.1", 0))
            theirs.settimeout(LIMIT)
            peer = f"localhost:{theirs.getsockname()[1]}"
            async with heard_by(peer=peer) as (link, _):
                link.send(b"hello")
                assert theirs.recv(100) == b"hello"

    asyncio.run(scenario())
