"""How many connections one address gets, and how long."""

import pytest

from ekf_companion.daemon.places import (
    BY_ADDRESS,
    DEADLINE,
    KEPT,
    LINE_WAIT,
    PLACES,
    Places,
    host_of,
)

HERE, THERE = "127.0.0.1", "192.168.1.7"


def taken(places, addresses):
    """Return how many of connections from these addresses get a place."""
    begin = len(places)
    return sum(places.take(begin + n, address, 0.0) for n, address in enumerate(addresses))


def test_one_address_takes_its_own_places_and_no_others():
    places = Places()
    assert taken(places, [THERE] * 40) == BY_ADDRESS
    assert places.take("other", "192.168.1.8", 0.0)
    assert places.take("here", HERE, 0.0)


@pytest.mark.parametrize(
    "addresses",
    [
        [f"10.0.0.{n}" for n in range(200)],
        [f"2001:db8:0:{n:x}::1" for n in range(200)],
        [f"fe80::{n + 1:x}%eth0" for n in range(200)],
    ],
)
def test_many_addresses_leave_the_places_of_this_computer(addresses):
    places = Places()
    assert taken(places, addresses) == PLACES - KEPT
    assert sum(places.take(("here", n), "::1", 0.0) for n in range(40)) == KEPT


def test_this_computer_may_take_all_places_and_no_more():
    assert taken(Places(), [HERE, "::1", "::ffff:127.0.0.1", "127.8.8.8"] * 20) == PLACES


def test_a_network_of_ipv6_is_one_address():
    assert taken(Places(), [f"2001:db8::{n:x}" for n in range(200)]) == BY_ADDRESS
    assert host_of("::ffff:192.168.1.7") == host_of(THERE)
    assert host_of("fe80::1%eth0") != host_of("fe80::2%eth0")


def test_a_place_ends_a_second_after_no_request_line_came():
    places = Places()
    places.take("slow", THERE, 10.0)
    places.take("asks", THERE, 10.0)
    places.extend("asks")
    assert places.late(10.0 + LINE_WAIT) == []
    assert places.late(10.1 + LINE_WAIT) == ["slow"]
    assert set(places.late(10.1 + DEADLINE)) == {"slow", "asks"}


def test_a_place_that_is_left_is_free():
    places = Places()
    assert taken(places, [THERE] * 40) == BY_ADDRESS
    places.leave(0)
    places.leave(0)
    places.extend(0)
    assert places.late(99.0).count(0) == 0
    assert places.take("next", THERE, 0.0)
    assert not places.take("more", THERE, 0.0)
