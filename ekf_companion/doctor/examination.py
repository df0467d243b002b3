"""The shells: a link listened to for some seconds, and a recording read through."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ekf_companion.config.config import Config
from ekf_companion.daemon.key_file import borrow_signing
from ekf_companion.daemon.reception import hear, open_reception, unix_clock
from ekf_companion.doctor import holder
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Evidence, Holder, Means, Opening
from ekf_companion.doctor.finding import Mark
from ekf_companion.doctor.witness import Witness
from ekf_companion.link.address import Address, Kind
from ekf_companion.link.link import Link, Received
from ekf_companion.logs import tlog
from ekf_companion.status.collect import link_state

Progress = Callable[[int, int], None]

_TICK = 0.1
_LEAST = 6.0
"""Seconds at least before all being well is believed: requests, parameters, TIMESYNC, alignment."""
_STEADY = 2.0
"""Seconds for which it must have been well."""
_HOPELESS = 0.6
"""Seconds after which a link that does not open is given up: it has been tried twice."""
_RECORDS = 4096


def examine_link(
    config: Config, seconds: float, *, listen: bool = False, progress: Progress | None = None
) -> Evidence:
    """Listen to the link of a configuration, as the daemon would or without a word.

    Args:
        config: Whose ``link`` is examined.
        seconds: At most so long; it ends sooner where all is well, or nothing opens.
        listen: Whether nothing is sent at all.
        progress: Told how many milliseconds of how many are over.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The file of the key is none that may be used.
    """
    return asyncio.run(_examine(config, seconds, listen=listen, progress=progress))


async def _examine(
    config: Config, seconds: float, *, listen: bool, progress: Progress | None
) -> Evidence:
    means = Means.LISTENING if listen else Means.LIVE
    signing = borrow_signing(config)
    witness = Witness(config, means, signing)

    def receive(received: Received) -> None:
        hear(received, witness.receive, witness.companion.session, link)
        _answer(link, witness, received.now_ns)

    link = open_reception(config, is_signed=signing is not None, on_read=receive)
    pump = asyncio.create_task(link.run())
    work = asyncio.create_task(_converse(link, witness))
    begin = time.monotonic()
    well_since: float | None = None
    try:
        while (over := time.monotonic() - begin) < seconds:
            if progress is not None:
                progress(int(over * 1e3), int(seconds * 1e3))
            await asyncio.sleep(min(_TICK, seconds - over))
            if work.done():
                work.result()  # a bug: raise it
            if over > _HOPELESS and link.failure is not None and not link.opened:
                break
            if over < _LEAST - _STEADY:
                continue
            evidence = witness.evidence(unix_clock(), _opening(link), link_state(link))
            is_well = all(finding.mark is Mark.OK for finding in diagnose(evidence))
            well_since = (well_since or over) if is_well and witness.reader.is_done else None
            if well_since is not None and over - well_since >= _STEADY:
                break
        evidence = witness.evidence(unix_clock(), _opening(link), link_state(link))
        span = time.monotonic() - begin
        return replace(evidence, seconds=span, bytes_rate=link.bytes_in / span)
    finally:
        work.cancel()
        pump.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await pump


async def _converse(link: Link, witness: Witness) -> None:
    """Send what is due, ten times a second at least."""
    while True:
        _answer(link, witness, unix_clock())
        await asyncio.sleep(_TICK)


def _answer(link: Link, witness: Witness, now_ns: int) -> None:
    witness.tick(now_ns)
    for frame in witness.data_to_send(now_ns):
        link.send(frame)


def _opening(link: Link) -> Opening:
    address, failure = link.address, link.failure
    opening = Opening(
        url=str(address), kind=address.kind.value, device=address.device, baud=address.baud
    )
    if link.opened or (failure is None and address.kind is not Kind.TCP_IN):
        return opening
    if failure is None:
        # A server that waits for its client
        return replace(opening, failure="nobody has connected", number=None)
    return replace(
        opening,
        failure=os.strerror(failure.errno) if failure.errno else str(failure),
        number=failure.errno,
        group=holder.group_of(address.device) if address.device else "",
        present=holder.present_devices(),
        holder=_holder(address),
    )


def _holder(address: Address) -> Holder | None:
    if address.kind is Kind.SERIAL:
        return holder.of_device(address.device)
    if address.kind in (Kind.UDP_IN, Kind.TCP_IN):
        return holder.of_port(address.kind.value[:3], address.port)
    return None


def examine_log(path: Path, config: Config, progress: Progress | None = None) -> Evidence:
    """Take a .tlog through the same session and estimator as live bytes.

    Raises:
        LogError: The file cannot be read, or holds no frame at all.
    """
    log, witness = tlog.read(path), Witness(config, Means.RECORDING)
    now_ns = 0
    for done, (stamp_us, raw) in enumerate(log.frames(), 1):
        now_ns = stamp_us * 1000
        witness.receive(raw, now_ns)
        witness.data_to_send(now_ns)
        if progress is not None and done % _RECORDS == 0:
            progress(done, len(log))
    return witness.evidence(now_ns, damaged=log.damaged)
