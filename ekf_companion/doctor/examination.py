"""The examination of a link, for some seconds, and of a recording."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ekf_companion.config.config import Config
from ekf_companion.daemon.clock import unix_clock
from ekf_companion.daemon.key_file import borrow_signing
from ekf_companion.daemon.reception import deliver, open_reception
from ekf_companion.doctor.collector import EvidenceCollector
from ekf_companion.doctor.diagnosis import diagnose
from ekf_companion.doctor.evidence import Evidence, Means, Opening
from ekf_companion.doctor.stage import Outcome
from ekf_companion.link import holder
from ekf_companion.link.address import Kind
from ekf_companion.link.link import Link, Received
from ekf_companion.logs import tlog
from ekf_companion.status.collect import link_state

Progress = Callable[[int, int], None]

_TICK = 0.1
_LEAST = 6.0
"""Shortest examination, s: requests, parameters, TIMESYNC and alignment take their time."""
_STEADY = 2.0
"""Seconds for which all stages must have been ok, to end sooner."""
_HOPELESS = 0.6
"""Seconds after which a link that does not open is given up: it has been tried twice."""
_RECORDS = 4096


def examine_link(
    config: Config, seconds: float, *, listen: bool = False, progress: Progress | None = None
) -> Evidence:
    """Examine the link of a configuration, sending what the daemon would send, or nothing.

    It ends before the time, s, is over if all stages are ok, or nothing opens. The progress is
    called with the milliseconds that are over, and with all of them.

    Raises:
        LinkError: The URL names no link.
        ConfigError: The key file may not be used.
    """
    return asyncio.run(_examine(config, seconds, listen=listen, progress=progress))


async def _examine(
    config: Config, seconds: float, *, listen: bool, progress: Progress | None
) -> Evidence:
    means = Means.LISTENING if listen else Means.LIVE
    signing = borrow_signing(config)
    collector = EvidenceCollector(config, means, signing)

    def answer(now_ns: int) -> None:
        collector.tick(now_ns)
        for frame in collector.data_to_send(now_ns):
            link.send(frame)

    def receive(received: Received) -> None:
        deliver(received, collector.receive, collector.companion.session, link)
        answer(received.now_ns)

    async def answer_periodically() -> None:
        while True:
            answer(unix_clock())
            await asyncio.sleep(_TICK)

    link = open_reception(config, is_signed=signing is not None, on_read=receive)
    pump = asyncio.create_task(link.run())
    work = asyncio.create_task(answer_periodically())
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
            evidence = collector.evidence(unix_clock(), _opening(link), link_state(link))
            is_well = all(result.outcome is Outcome.OK for result in diagnose(evidence))
            well_since = (well_since or over) if is_well and collector.parameters.is_done else None
            if well_since is not None and over - well_since >= _STEADY:
                break
        evidence = collector.evidence(unix_clock(), _opening(link), link_state(link))
        span = time.monotonic() - begin
        return replace(evidence, seconds=span, bytes_rate=link.bytes_in / span)
    finally:
        work.cancel()
        pump.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await pump


def _opening(link: Link) -> Opening:
    address, failure = link.address, link.failure
    opening = Opening(
        url=str(address), kind=address.kind.value, device=address.device, baud=address.baud
    )
    if link.opened or (failure is None and address.kind is not Kind.TCP_IN):
        return opening
    if failure is None:
        # A server that waits for its client
        return replace(opening, failure="nobody has connected")
    return replace(
        opening,
        failure=os.strerror(failure.errno) if failure.errno else str(failure),
        number=failure.errno,
        group=holder.group_of(address.device) if address.device else "",
        present=holder.present_devices(),
        holder=holder.holder_of(address),
    )


def examine_log(path: Path, config: Config, progress: Progress | None = None) -> Evidence:
    """Examine a .tlog, with the same session and estimator as live bytes.

    Raises:
        LogError: The file cannot be read, or contains no frame at all.
    """
    log, collector = tlog.read(path), EvidenceCollector(config, Means.RECORDING)
    now_ns = 0
    for done, (stamp_us, raw) in enumerate(log.frames(), 1):
        now_ns = stamp_us * 1000
        collector.receive(raw, now_ns)
        collector.data_to_send(now_ns)
        if progress is not None and done % _RECORDS == 0:
            progress(done, len(log))
    return collector.evidence(now_ns, damaged=log.damaged)
