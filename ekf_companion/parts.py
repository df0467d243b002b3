"""What each part of the daemon has to tell, in the words of the Snapshot.

Each function is the one place where its part is asked; what no part keeps yet is told as unknown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ekf_companion.companion import Companion
from ekf_companion.link import Link
from ekf_companion.mavlink.clock import Timesync
from ekf_companion.mavlink.decode import Decoder
from ekf_companion.mavlink.session import Session
from ekf_companion.snapshot import FrameState, TimeState


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardState:
    """Whether the estimate is sent, and why."""

    reason: str = ""
    remedy: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)
    withheld: int = 0


def guard_state(companion: Companion) -> GuardState:
    """Give the guard's verdict on sending ODOMETRY."""
    session = companion.session
    state = session.stream_state
    return GuardState(
        reason=state.reason,
        remedy=state.remedy,
        parameters=session.guard.verdict.parameters,
        withheld=session.outbox.withheld["ODOMETRY"],
    )


def refused_datagrams(link: Link) -> Mapping[str, int]:
    """Give the datagrams that the link did not let in, by reason."""
    return link.refused


def firmware(session: Session) -> str:
    """Give the version of the autopilot's firmware; empty: it has not been told."""
    return session.requests.version


def sent_by_name(session: Session) -> Mapping[str, int]:
    """Give the counter of our messages, which goes on counting."""
    return session.sent


def heartbeat_ns(session: Session) -> int | None:
    """Give when the autopilot's last heartbeat came, our clock; None: none has."""
    return session.heard_ns or None


def asked_rates(session: Session) -> dict[str, float]:
    """Give the rates that were asked for, Hz, by message."""
    rates = dict(session.requests.rates)
    if "RAW_IMU" in session.results:  # asked in its place where it was refused
        rates["RAW_IMU"] = rates.get("HIGHRES_IMU", 0.0)
    return rates


def time_state(timesync: Timesync, decoder: Decoder, now_ns: int) -> TimeState:
    """Give what is known of the autopilot's clock."""
    peer_ns = timesync.peer_ns(now_ns)
    quality, base = timesync.quality, decoder.clock
    words = "unix" if base.is_unix else "boot"
    return TimeState(
        base="unknown" if base.latest_us is None else words,
        is_locked=timesync.is_locked,
        offset_s=math.nan if peer_ns is None else (peer_ns - now_ns) * 1e-9,
        skew_ppm=timesync.skew * 1e6,
        rtt_p50_ms=_ms(quality.rtt_p50_ns),
        rtt_p95_ms=_ms(quality.rtt_p95_ns),
        answers=quality.answers,
        refused=dict(timesync.refused),
    )


def _ms(ns: int | None) -> float:
    return math.nan if ns is None else ns * 1e-6


def frames(counters: Mapping[str, int]) -> FrameState:
    """Give what the bytes were, out of ``Session.counters``."""
    return FrameState(
        frames=counters["frames"],
        bad_crc=counters["bad_crc"],
        unknown_id=counters["unknown_id"],
        incompatible=counters["incompatible"],
        junk_bytes=counters["junk_bytes"],
        lost=counters["lost"],
        late=counters["late"],
        signed=counters["signed"],
        refused={**part(counters, "ignored: "), **part(counters, "not admitted: ")},
    )


def part(counters: Mapping[str, int], prefix: str) -> dict[str, int]:
    """Give the counters whose names begin so, without that beginning."""
    return {
        name.removeprefix(prefix): count
        for name, count in counters.items()
        if name.startswith(prefix)
    }


def age(since_ns: int | None, now_ns: int) -> float:
    """Give the seconds since a time of ours; NaN: it never was."""
    return math.nan if since_ns is None else max(now_ns - since_ns, 0) * 1e-9
