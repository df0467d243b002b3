"""The address of a link, read from its URL."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import Enum

from ekf_companion.errors import LinkError

DEFAULT_BAUD = 921600


class Kind(str, Enum):
    """The kind of a link."""

    UDP_IN = "udpin"
    UDP_OUT = "udpout"
    UDP_BROADCAST = "udpbcast"
    TCP_OUT = "tcp"
    TCP_IN = "tcpin"
    SERIAL = "serial"


@dataclass(frozen=True, slots=True, kw_only=True)
class Address:
    """The address of a link."""

    kind: Kind
    host: str = ""
    """Local address to bind (in), or remote one (out)."""
    port: int = 0
    remote: tuple[str, int] | None = None
    """Where to send before anything has come (``udp://bind@remote``)."""
    peer: tuple[str, int] | None = None
    """Where datagrams must come from, host and port; port 0: any."""
    is_send_only: bool = False
    """Whether nothing is read."""
    device: str = ""
    baud: int = DEFAULT_BAUD
    warning: str = ""
    """What was ambiguous in the URL, and how it was read."""

    def __str__(self) -> str:
        """Return the URL in its canonical spelling."""
        if self.kind is Kind.SERIAL:
            return f"serial:{self.device}:{self.baud}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind.value}:{host}:{self.port}"


LOOPBACK = ("127.0.0.1", "::1", "localhost")
DATAGRAMS = (Kind.UDP_IN, Kind.UDP_OUT, Kind.UDP_BROADCAST)

_SCHEMES = {
    **{kind.value: kind for kind in Kind},
    "udp": Kind.UDP_IN,
    "udp-b": Kind.UDP_BROADCAST,
    "tcpout": Kind.TCP_OUT,
    "tcp-l": Kind.TCP_IN,
}
_HOSTS = {
    Kind.UDP_IN: "0.0.0.0",
    Kind.TCP_IN: "0.0.0.0",
    Kind.UDP_BROADCAST: "255.255.255.255",
}
"""Host where a URL names none; others must."""
_EXAMPLES = (
    "udpin:0.0.0.0:14540, udpout:192.168.1.2:14550, tcp:127.0.0.1:5760, tcpin:0.0.0.0:5760 "
    "or serial:/dev/ttyACM0:921600"
)


def parse_url(url: str) -> Address:
    """Read a link's URL in the spellings of pymavlink, MAVSDK, MAVROS and mavlink-router.

    Raises:
        LinkError: The URL names no link; the message says what would.
    """
    if not url.isprintable():
        raise LinkError(f"{url!r}: has a character that no address has; take it out")
    if url.startswith("/"):
        return _parse_serial(url, url)
    scheme, separator, rest = url.partition(":")
    kind = _SCHEMES.get(scheme)
    if kind is None or not separator:
        raise LinkError(f"{url}: not a link; write for example {_EXAMPLES}")
    rest = rest.removeprefix("//")
    if "?" in rest:
        raise LinkError(f"{url}: a link takes no options; leave out what follows the question mark")
    if kind is Kind.SERIAL:
        return _parse_serial(url, rest)
    if scheme == "udp" and "@" in rest:
        bind, remote = rest.split("@", 1)
        host, port = _parse_host(url, bind or ":14550", "0.0.0.0")
        target = _parse_host(url, remote, "127.0.0.1") if remote else None
        return Address(kind=kind, host=host, port=port, remote=target)
    host, port = _parse_host(url, rest, _HOSTS.get(kind, ""))
    warning = ""
    if scheme == "udp":
        warning = f"{url}: read as udpin; write udpin: to listen, or udpout: to reach out"
    return Address(kind=kind, host=host, port=port, warning=warning)


def parse_peer(peer: str, address: Address) -> tuple[str, int] | None:
    """Read where the datagrams of a link must come from, HOST or HOST:PORT; None if it is empty.

    The port is 0 if any port will do.

    Raises:
        LinkError: It is not an address, or a link of this kind has only one other end.
    """
    if not peer:
        return None
    if not peer.isprintable():
        raise LinkError(f"{peer!r}: has a character that no address has; take it out")
    if address.kind not in (Kind.UDP_IN, Kind.UDP_BROADCAST):
        raise LinkError(
            f"{peer}: only udpin: and udpbcast: receive from several senders, and the link is "
            f"{address}; leave the peer out"
        )
    match = re.fullmatch(r"(?:\[([^\]]+)\]|([^:\[\]]+))(?::(\d+))?", peer)
    if match is None:
        # An IPv6 address without brackets has no port
        if peer.count(":") < 2 or re.fullmatch(r"[0-9A-Fa-f:.]+(?:%\w+)?", peer) is None:
            raise LinkError(f"{peer}: no HOST or HOST:PORT, as in 192.168.1.2 or 192.168.1.2:14550")
        return peer, 0
    port = int(match[3] or 0)
    if match[3] is not None and not 0 < port < 65536:
        raise LinkError(f"{peer}: {port} is no port; leave it out to accept any port of that host")
    return match[1] or match[2], port


def parse_aid(url: str, peers: Collection[str], link: Address) -> Address:
    """Read the address of a second port, at which poses and velocities come.

    Raises:
        LinkError: It is no address to listen at, or the autopilot's own, or it is open to others
            and nobody is named who may send.
    """
    address = parse_url(url)
    if address.kind is not Kind.UDP_IN:
        raise LinkError(f"{url}: others send datagrams there; write udpin:127.0.0.1:PORT")
    if link.kind is Kind.UDP_IN and address.port == link.port:
        raise LinkError(f"{url}: is the autopilot's own link ({link}); take another port")
    for peer in peers:
        if re.fullmatch(r"[0-9A-Fa-f:.]+(%\w+)?", peer) is None:
            raise LinkError(f"{peer!r:.60}: aid_peers takes numeric addresses, as in 192.168.1.7")
    if not peers and address.host not in LOOPBACK:
        raise LinkError(
            f"{url}: anybody on the network could send there; write "
            f"udpin:127.0.0.1:{address.port}, or name in link.aid_peers who may"
        )
    return address


def parse_monitor(url: str, link: Address) -> Address:
    """Read the address of a monitor, to which messages are only sent.

    Raises:
        LinkError: The URL is not such an address, or is the autopilot's own link.
    """
    address = parse_url(url)
    if address.kind not in (Kind.UDP_OUT, Kind.UDP_BROADCAST):
        raise LinkError(
            f"{url}: a monitor is sent datagrams; write udpout:HOST:PORT, or udpbcast:HOST:PORT "
            "for all of a network"
        )
    theirs = {link.remote, link.peer}
    if link.kind in (Kind.UDP_OUT, Kind.UDP_BROADCAST):
        theirs.add((link.host, link.port))
    if link.kind in (Kind.UDP_IN, Kind.UDP_BROADCAST) and address.port == link.port:
        # Our own address
        theirs |= {(link.host, link.port), ("127.0.0.1", link.port), ("localhost", link.port)}
        if address.kind is Kind.UDP_BROADCAST:
            theirs.add((address.host, link.port))
    if (address.host, address.port) in theirs:
        raise LinkError(
            f"{url}: is the autopilot's own link ({link}), where the guard decides on ODOMETRY; "
            "name another listener in output.monitors, or none"
        )
    return replace(address, is_send_only=True)


def _parse_serial(url: str, rest: str) -> Address:
    match = re.fullmatch(r"(/.+?)(?:[:,](-?\w*))?", rest, re.ASCII)
    if match is None:
        raise LinkError(f"{url}: a serial link needs a device, as in serial:/dev/ttyACM0:921600")
    words = match[2]
    is_number = words is None or (words.isdigit() and len(words) <= 8)
    baud = DEFAULT_BAUD if words is None else int(words) if is_number else 0
    if not 1200 <= baud <= 12_000_000:
        raise LinkError(
            f"{url}: {words or 'nothing'} is no rate of a serial port; 921600 and 57600 are usual"
        )
    return Address(kind=Kind.SERIAL, device=match[1], baud=baud)


def _parse_host(url: str, rest: str, default: str) -> tuple[str, int]:
    match = re.fullmatch(r"(?:\[([^\]]+)\]|([^:\[\]]*)):(\d+)", rest)
    if match is None:
        raise LinkError(f"{url}: needs a host and a port, as in {_EXAMPLES}")
    host, port = match[1] or match[2] or default, int(match[3])
    if not host:
        raise LinkError(f"{url}: needs the host to reach, as in {_EXAMPLES}")
    if not 0 < port < 65536:
        raise LinkError(f"{url}: {port} is no port; 14540 and 14550 are usual")
    return host, port
