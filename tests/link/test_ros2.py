"""ROS 2 through zenoh: two peers on this computer, of which one is the library alone."""

from __future__ import annotations

import contextlib
import itertools
import socket
import struct
import threading

import numpy as np
import pytest

from ekf_companion.errors import LinkError
from ekf_companion.link.ros2 import ODOMETRY, Network, Ros2, stamp_ns
from tests.daemon.test_daemon import free_port
from tests.daemon.waiting import LIMIT, wait_until
from tests.link.ros2 import HASH, STORE, TYPE, Partner, odometry, router

NONE = np.zeros((6, 6))
DAMAGED = [b"", b"\0\1", b"\0\1\0\0" + b"\xff" * 40, b"no message" * 80]
T_NS = 1_700_000_000_123_456_789


def message(t_ns=T_NS):
    return odometry(t_ns, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), NONE, NONE)


@contextlib.contextmanager
def both(domain=0):
    port = free_port(socket.SOCK_STREAM)
    with router(port) as partner:
        ours = Ros2(Network((f"tcp/127.0.0.1:{port}",), domain=domain))
        with contextlib.closing(ours):
            yield partner, ours


@pytest.mark.parametrize(
    ("key", "domain"),
    [
        (f"0/vio/odom/{TYPE}/{HASH}", 0),
        (f"7/vio/odom/{TYPE}/{HASH}", 7),
        (f"0/vio/odom/{TYPE}/TypeHashNotSupported", 0),
        ("vio/odom", 0),
    ],
    ids=["rmw_zenoh", "another domain", "Humble", "bridge"],
)
def test_a_topic_is_heard_by_either_way(key, domain):
    heard = []
    with both(domain) as (session, ours):
        ours.subscribe("/vio/odom", ODOMETRY, lambda m, _, now_ns: heard.append((m, now_ns)))
        partner = Partner(session, key)

        def comes():
            partner.put(message())
            return heard

        wait_until(comes)
        for data in DAMAGED:
            partner.put_bytes(data)
        wait_until(lambda: sum(ours.refused.values()) == len(DAMAGED))
        partner.put(message(T_NS + 5))
        wait_until(lambda: stamp_ns(heard[-1][0]) == T_NS + 5)
    assert stamp_ns(heard[0][0]) == T_NS
    assert heard[0][0].pose.pose.position.y == 2.0
    assert heard[0][1] <= heard[-1][1]


def test_other_domains_and_topics_are_not_heard():
    heard = []
    with both(3) as (session, ours):
        ours.subscribe("/odom", ODOMETRY, lambda m, *_: heard.append(m.pose.pose.position.x))
        others = [f"0/odom/{TYPE}/{HASH}", f"3/other/odom/{TYPE}/{HASH}", "other/odom"]
        mine = Partner(session, f"3/odom/{TYPE}/{HASH}")

        def comes():
            for key in others:
                Partner(session, key).put(message())
            one = message()
            one.pose.pose.position.x = 9.0
            mine.put(one)
            return len(heard) > 3

        wait_until(comes)
    assert {*heard} == {9.0}


def test_what_is_published_reaches_both_with_what_rmw_zenoh_needs():
    """Its receivers end their process where the attachment is none that they can read."""
    found, lock = {}, threading.Lock()

    def hear(sample):
        with lock:
            attachment = None if sample.attachment is None else bytes(sample.attachment)
            found.setdefault(str(sample.key_expr), []).append((bytes(sample.payload), attachment))

    with both() as (session, ours):
        publish = ours.advertise("/ekf/odom", ODOMETRY)
        keys = [f"0/ekf/odom/{TYPE}/{HASH}", f"0/ekf/odom/{TYPE}/TypeHashNotSupported", "ekf/odom"]
        hearers = [session.declare_subscriber(key, hear) for key in keys]

        def comes():
            publish(message())
            return all(len(found.get(key, [])) > 2 for key in keys)

        wait_until(comes)
        tokens = [str(one.ok.key_expr) for one in session.liveliness().get("@ros2_lv/0/**")]
        for one in hearers:
            one.undeclare()
    data, attachment = zip(*found[keys[0]][:3], strict=True)
    assert all(len(one) == 33 for one in attachment)
    numbers, stamps, lengths = zip(
        *[struct.unpack("<qqB", one[:17]) for one in attachment], strict=True
    )
    assert [b - a for a, b in itertools.pairwise(numbers)] == [1, 1]
    assert list(stamps) == sorted(stamps)
    assert {*lengths} == {16}
    assert len({one[17:] for one in attachment}) == 1
    read = STORE.deserialize_cdr(data[0], ODOMETRY)
    assert (read.pose.pose.position.x, read.child_frame_id) == (1.0, "base_link")
    (token,) = tokens
    parts = token.split("/")
    assert (parts[1], parts[5], parts[8:]) == (
        "0",
        "MP",
        ["ekf_companion", "%ekf%odom", TYPE, HASH, "::,:,:,:,,"],
    )


def test_who_comes_later_is_connected_to():
    port = free_port(socket.SOCK_STREAM)
    heard = []
    ours = Ros2(Network((f"tcp/127.0.0.1:{port}",)))
    with contextlib.closing(ours):
        ours.subscribe("/odom", ODOMETRY, lambda *_: heard.append(1))
        for _ in range(2):  # and again after it was gone
            heard.clear()
            with router(port) as session:
                partner = Partner(session, "odom")

                def comes(partner=partner):
                    partner.put(message())
                    return heard

                wait_until(comes, LIMIT)


@pytest.mark.parametrize(
    ("network", "topic", "words"),
    [
        (Network(("foo/127.0.0.1:1",)), "/odom", "foo protocol; endpoints are as tcp/"),
        (Network((), ("tcp/192.0.2.1:1",)), "/odom", "zenoh: "),
        (Network((), ()), "/a//b", "'/a//b': is no topic of ROS 2"),
        (Network((), ()), "/**", "is no topic of ROS 2"),
        (Network((), ()), "/1", "is no topic of ROS 2"),
        (Network((), ()), "", "is no topic of ROS 2"),
    ],
)
def test_what_is_none_is_refused_with_a_sentence(network, topic, words):
    with (
        pytest.raises(LinkError, match=words.replace("*", r"\*")),
        contextlib.closing(Ros2(network)) as ours,
    ):
        ours.subscribe(topic, ODOMETRY, print)
