"""Who may ask over HTTP: checks of the host name, of the origin and of a token.

A page of another site must not read the state through the browser of somebody who can reach this
computer: by a name that it points here (DNS rebinding), or by a WebSocket, which browsers let any
site open. Requests by address are not affected. From another machine a token is required.

Sources: RFC 9110, 7.2 (Host); RFC 6455, 10.2 (Origin).
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import re
import secrets
import socket
import threading
from collections.abc import Collection
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, NamedTuple
from urllib.parse import parse_qs

from ekf_companion.config.service import HttpConfig

if TYPE_CHECKING:
    from email.message import Message

_log = logging.getLogger(__name__)

WRONG_TOKEN_WAIT = 1.0
"""Seconds before a wrong token is refused: with its places one address tries eight in that time."""
_WRONG_NAME = (
    "this is not the name of this computer: ask by its address, or name it in http.names of the "
    "configuration\n"
)
_WRONG_ORIGIN = "a page of another site may not open this\n"
_NO_TOKEN = (
    "from another computer a token is needed: open the address in the daemon's log (journalctl -u "
    "ekf-companion), which ends in ?token=, or send the header Authorization: Bearer TOKEN\n"
)
_NAMES = ("localhost", "localhost.localdomain")


class Refusal(NamedTuple):
    """Why a request is not answered."""

    status: HTTPStatus
    words: str
    wait: float = 0.0
    """Seconds to wait before the refusal is sent."""


class Access:
    """Decides on the requests to one server."""

    def __init__(self, config: HttpConfig, own_name: str | None = None) -> None:
        """Draw a token where one is needed and none is configured.

        ``own_name`` is this computer's, by default as the system says.
        """
        self._names = own_names(config, own_name)
        self.is_generated = not config.token
        """Whether the token was drawn here."""
        self.token = config.token or secrets.token_urlsafe(16)
        """That others than this computer must know."""
        self.cookie = f"ekf_companion_{config.port}"
        """Its cookie's name: cookies do not tell ports apart."""
        self.wrong_tokens = 0
        """How many have been offered."""
        self._lock = threading.Lock()

    def refuse(
        self, headers: Message, query: str, address: str, *, is_socket: bool = False
    ) -> Refusal | None:
        """Return why a request from an address is refused, or None if it is answered.

        ``is_socket`` is whether it opens a WebSocket.
        """
        if (refusal := refuse_site(headers, self._names, is_socket=is_socket)) is not None:
            return refusal
        if is_loopback(address):
            return None
        offered = self._offered(headers, query)
        if any(map(self.is_token, offered)):
            return None
        # Who offers none guesses nothing: a browser whose user opened the address without it
        if offered:
            self._count_wrong_token(address)
        wait = WRONG_TOKEN_WAIT if offered else 0.0
        return Refusal(HTTPStatus.UNAUTHORIZED, _NO_TOKEN, wait)

    def is_token(self, word: str) -> bool:
        """Return whether a word is the token."""
        return hmac.compare_digest(word.encode(), self.token.encode())

    def _count_wrong_token(self, address: str) -> None:
        """Count a wrong token; log the first, tenth, hundredth and so on."""
        with self._lock:
            self.wrong_tokens += 1
            count = self.wrong_tokens
        if str(count).strip("0") == "1":
            _log.warning("http: wrong token, %d so far, now from %s", count, address)

    def _offered(self, headers: Message, query: str) -> list[str]:
        words = parse_qs(query).get("token", [])
        scheme, _, word = headers.get("Authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            words.append(word.strip())
        try:
            cookies = SimpleCookie(headers.get("Cookie", ""))
        except CookieError:
            return words
        if self.cookie in cookies:
            words.append(cookies[self.cookie].value)
        return words


def own_names(config: HttpConfig, own_name: str | None = None) -> frozenset[str]:
    """Return the names of this computer; ``own_name`` is by default the system's."""
    name = (socket.gethostname() if own_name is None else own_name).lower()
    ours = (*_NAMES, config.host, name, f"{name}.local", *config.names)
    return frozenset(one.lower().rstrip(".") for one in ours if one)


def refuse_site(
    headers: Message,
    names: frozenset[str],
    origins: Collection[str] = (),
    *,
    is_socket: bool,
) -> Refusal | None:
    """Return why a request could come from another site's page, or None if it does not.

    Args:
        headers: Of the request.
        names: Names of this computer, beside its addresses.
        origins: Other sites whose pages may open a WebSocket.
        is_socket: Whether it opens a WebSocket, which a browser lets any site do.
    """
    hosts, sites = headers.get_all("Host", []), headers.get_all("Origin", [])
    if len(hosts) > 1 or not all(_is_ours(host, names) for host in hosts):
        return Refusal(HTTPStatus.MISDIRECTED_REQUEST, _WRONG_NAME)
    if not is_socket or not sites:
        return None
    known = {f"{scheme}://{host}".lower() for scheme in ("http", "https") for host in hosts}
    known.update(one.lower().rstrip("/") for one in origins)
    if len(sites) == 1 and sites[0].strip().lower() in known:
        return None
    return Refusal(HTTPStatus.FORBIDDEN, _WRONG_ORIGIN)


def is_loopback(address: str) -> bool:
    """Return whether an address belongs to this computer alone."""
    found = ipaddress.ip_address(address.partition("%")[0])
    mapped = getattr(found, "ipv4_mapped", None)
    return bool((mapped or found).is_loopback)


def _is_ours(host: str, names: frozenset[str]) -> bool:
    name = _without_port(host)
    return _is_address(name) or name.lower().rstrip(".") in names


def _without_port(host: str) -> str:
    if host.startswith("["):
        name, bracket, port = host[1:].partition("]")
        return name if bracket and _is_port(port) else host
    name, colon, port = host.partition(":")
    return name if _is_port(colon + port) else host


def _is_port(text: str) -> bool:
    """Return whether a text is a port behind a colon, either of which may be missing."""
    return re.fullmatch("(:[0-9]*)?", text) is not None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.partition("%")[0])
    except ValueError:
        return False
    return True
