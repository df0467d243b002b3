"""The link of a configuration and the senders that it accepts, for the daemon and the doctor.

Datagrams are accepted from the address from which the session receives the autopilot, see
:mod:`~.link.peers`. If the session refuses a frame, by its ids or its signature, its sender is not
answered, and a TCP client that sends nothing else is disconnected.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.link.address import parse_aid, parse_url
from ekf_companion.link.link import Link, Received
from ekf_companion.link.peers import Peers
from ekf_companion.mavlink.session import Session

_log = logging.getLogger(__name__)


def open_reception(
    config: Config,
    *,
    is_signed: bool,
    on_read: Callable[[Received], None],
    on_state: Callable[[bool], None] | None = None,
    on_sent: Callable[[int], None] | None = None,
) -> Link:
    """Return the link of a configuration; pass what it reads to :func:`deliver`.

    ``is_signed`` is whether there is a secret by which frames are verified; the callbacks are those
    of :class:`Link`.

    Raises:
        LinkError: The URL names no link, or the peer is not an address.
    """
    return Link(
        parse_url(config.link.url),
        peer=config.link.peer,
        clock=unix_clock,
        peers=Peers(is_signed=is_signed and not config.signing.accept_unsigned),
        on_state=on_state,
        on_read=on_read,
        on_sent=on_sent,
    )


def open_aid_port(config: Config, on_read: Callable[[Received], None]) -> Link | None:
    """Return the second port, at which poses and velocities come; None: none is configured.

    Raises:
        LinkError: The URL is none.
    """
    link = config.link
    if not link.aid_url:
        return None
    if not (config.visual_odometry.use or config.visual_velocity.use):
        _log.warning(
            "link.aid_url: nothing that comes there is used; set visual_odometry.use or "
            "visual_velocity.use to true"
        )
    address = parse_aid(link.aid_url, link.aid_peers, parse_url(link.url))
    peers = Peers(is_pinning=False)
    peers.allow(link.aid_peers)
    return Link(address, clock=unix_clock, peers=peers, on_read=on_read)


def deliver(
    received: Received, receive: Callable[[bytes, int, Any], object], session: Session, link: Link
) -> None:
    """Pass on what was read, and pin or answer its sender depending on what the session accepts.

    ``receive`` is called with the bytes, the time of the read and the sender, to pass them to the
    session.
    """
    data, now_ns, sender = received
    heard, believed = session.heard, session.believed
    receive(data, now_ns, sender)
    if session.heard == heard and session.believed == believed:
        return
    link.confirm()
    if sender is None:
        return
    if session.heard != heard:
        link.peers.pin(sender, now_ns)
    else:
        link.peers.set_target(sender)
