"""What is read, and whom to go on listening to: the daemon and the doctor hear alike.

Datagrams are heard of whoever the session takes for the autopilot, see :mod:`~.link.peers`; a
session that refuses a frame, by its ids or its signature, so keeps its sender from being answered,
and a TCP client that sends nothing else from keeping its place.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ekf_companion.config.config import Config
from ekf_companion.link.link import Link, Received, open_link
from ekf_companion.link.peers import Peers
from ekf_companion.mavlink.session import Session


def open_reception(
    config: Config,
    *,
    is_signed: bool,
    on_read: Callable[[Received], None],
    on_state: Callable[[bool], None] | None = None,
    on_sent: Callable[[int], None] | None = None,
) -> Link:
    """Give the link of a configuration; what it reads must be given to :func:`hear`.

    Args:
        config: Whose ``link`` is opened.
        is_signed: Whether there is a secret by which frames are verified.
        on_read: Called with what is read, at once.
        on_state: Called with True when the link has opened and with False when it is closed.
        on_sent: Called when an ODOMETRY has been written, with how long it waited for room, ns.

    Raises:
        LinkError: The URL names no link, or the peer nobody.
    """
    return open_link(
        config.link.url,
        peer=config.link.peer,
        clock=unix_clock,
        peers=Peers(is_signed=is_signed and not config.signing.accept_unsigned),
        on_state=on_state,
        on_read=on_read,
        on_sent=on_sent,
    )


def hear(
    received: Received, take: Callable[[bytes, int, Any], object], session: Session, link: Link
) -> None:
    """Hand on what was read, and say by what the session makes of it whom to listen to.

    Args:
        received: Bytes, when they were read, and who sent them.
        take: Gives them to the session.
        session: Of the link.
        link: That it was read from.
    """
    data, now_ns, sender = received
    heard, believed = session.heard, session.believed
    take(data, now_ns, sender)
    if session.heard == heard and session.believed == believed:
        return
    link.believe()
    if sender is None:
        return
    if session.heard != heard:
        link.peers.pin(sender, now_ns)
    else:
        link.peers.answer(sender)


def unix_clock() -> int:
    """Give unix time, ns, that never steps: the monotonic clock, set once."""
    return time.monotonic_ns() + _BOOT_NS


_BOOT_NS = time.time_ns() - time.monotonic_ns()
