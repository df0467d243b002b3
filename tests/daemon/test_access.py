"""Whom the HTTP server answers."""

from email import message_from_string
from email.message import Message
from http import HTTPStatus

import pytest

from ekf_companion.config.service import HttpConfig
from ekf_companion.daemon.access import WRONG_TOKEN_WAIT, Access, own_names, refuse_site

TOKEN = "tomato-soup"
HERE, THERE = "127.0.0.1", "192.168.1.7"


def refusal(address=HERE, query="", config=None, **headers):
    message = Message()
    for name, value in headers.items():
        message[name] = value
    access = Access(config or HttpConfig(token=TOKEN), own_name="Board7")
    found = access.refuse(message, query, address)
    return None if found is None else found.status


@pytest.mark.parametrize(
    "host",
    ["localhost:9331", "127.0.0.1:9331", "[::1]:9331", "192.168.1.5", "board7", "BOARD7.local:80"],
)
def test_addresses_and_own_names_are_answered(host):
    assert refusal(Host=host) is None


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "127.0.0.1.evil.example:9331",
        "",
        "x:y:z",
        "[::1].evil.example",
        "[::1]:evil",
        "[::1",
        "localhost:evil",
        "localhost:9331.evil.example",
        "127.0.0.1:\u0661",
    ],
)
def test_a_name_that_somebody_lets_point_here_is_refused(host):
    assert refusal(Host=host) is HTTPStatus.MISDIRECTED_REQUEST


def test_a_name_of_the_configuration_is_answered():
    config = HttpConfig(names=("Drone.lan",))
    assert refusal(config=config, Host="drone.lan:9331") is None


def test_a_request_without_a_name_is_of_no_browser():
    assert refusal() is None


def test_another_computer_needs_the_token():
    assert refusal(THERE) is HTTPStatus.UNAUTHORIZED
    assert refusal(THERE, query="token=tomato") is HTTPStatus.UNAUTHORIZED
    assert refusal(THERE, Cookie=f"ekf_companion_9332={TOKEN}") is HTTPStatus.UNAUTHORIZED
    assert refusal(THERE, Authorization=f"Basic {TOKEN}") is HTTPStatus.UNAUTHORIZED
    assert refusal(THERE, query=f"token={TOKEN}") is None
    assert refusal(THERE, Cookie=f"a=b; ekf_companion_9331={TOKEN}") is None
    assert refusal(THERE, Authorization=f"Bearer {TOKEN}") is None


def test_the_token_does_not_excuse_a_foreign_name():
    assert refusal(THERE, query=f"token={TOKEN}", Host="evil.example") is not None


@pytest.mark.parametrize("address", ["::1", "::ffff:127.0.0.1", "127.8.8.8"])
def test_this_computer_is_not_asked(address):
    assert refusal(address) is None


def test_a_token_is_drawn_anew_where_none_is_configured():
    one, other = Access(HttpConfig()), Access(HttpConfig())
    assert one.is_generated
    assert len(one.token) >= 16
    assert one.token != other.token
    assert not Access(HttpConfig(token=TOKEN)).is_generated


def test_a_wrong_token_is_counted_and_waits_and_the_right_one_does_not(caplog):
    access = Access(HttpConfig(token=TOKEN), own_name="board7")
    for number in range(1, 12):
        found = access.refuse(Message(), "token=tomato", THERE)
        assert found is not None
        assert (found.wait, access.wrong_tokens) == (WRONG_TOKEN_WAIT, number)
    lines = [record.getMessage() for record in caplog.records]
    assert lines == [f"http: wrong token, {n} so far, now from {THERE}" for n in (1, 10)]
    assert access.refuse(Message(), f"token={TOKEN}", THERE) is None


def test_who_offers_no_token_guesses_nothing():
    access = Access(HttpConfig(token=TOKEN), own_name="board7")
    found = access.refuse(Message(), "", THERE)
    assert found is not None
    assert (found.wait, access.wrong_tokens) == (0.0, 0)
    assert access.refuse(Message(), "token=tomato", HERE) is None
    assert access.wrong_tokens == 0


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        ("Host: 127.0.0.1:8765", None),
        ("Host: localhost:8765\nOrigin: http://localhost:8765", None),
        ("Host: 127.0.0.1:8765\nOrigin: https://app.example", None),
        ("Host: 127.0.0.1:8765\nOrigin: https://evil.example", HTTPStatus.FORBIDDEN),
        ("Host: 127.0.0.1:8765\nOrigin: http://127.0.0.1:80", HTTPStatus.FORBIDDEN),
        ("Host: 127.0.0.1:8765\nOrigin: null", HTTPStatus.FORBIDDEN),
        ("Host: 127.0.0.1:8765\nOrigin: ", HTTPStatus.FORBIDDEN),
        ("Host: 127.0.0.1:8765\nOrigin: https://app.example.evil", HTTPStatus.FORBIDDEN),
        ("Host: 127.0.0.1:8765\nOrigin: https://app.example:444", HTTPStatus.FORBIDDEN),
        (
            "Host: 127.0.0.1:8765\nOrigin: https://app.example\nOrigin: https://evil.example",
            HTTPStatus.FORBIDDEN,
        ),
        ("Origin: http://", HTTPStatus.FORBIDDEN),
        (
            "Host: evil.example\nOrigin: http://evil.example",
            HTTPStatus.MISDIRECTED_REQUEST,
        ),
        ("Host: 127.0.0.1\nHost: evil.example", HTTPStatus.MISDIRECTED_REQUEST),
    ],
)
def test_a_page_of_another_site_opens_no_socket(lines, status):
    headers = message_from_string(lines + "\n\n")
    names = own_names(HttpConfig(), "board7")
    found = refuse_site(headers, names, ("https://app.example/",), is_socket=True)
    assert (None if found is None else found.status) is status
