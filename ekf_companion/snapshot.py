"""One account of everything: what the status, the metrics, the doctor and the tests read.

The stages are those that a measurement passes: bytes, frames, their checks, whose they are, what
they are and how often they come, what time they say, what the filter made of them, what was sent,
and what the autopilot does with that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from typing import Any, NamedTuple

import msgspec

from ekf_companion.nav.state import Status
from ekf_companion.pipeline import Health

STALL_S = 2.0
"""The filter's task goes round ten times a second at least."""
SILENCE_S = 2.0
"""A link without a byte for so long is said to be silent: heartbeats come once a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkState:
    """The descriptor, and the bytes."""

    url: str
    is_open: bool
    opened: int
    """How often it has been opened."""
    bytes_in: int
    bytes_out: int
    dropped: int
    """Reads that the filter was too slow for."""
    unsent: int
    """Messages that found no link, or too slow a one."""
    silent_s: float
    """Since the last byte, s; NaN: none has come."""
    refused: Mapping[str, int]
    """Datagrams refused, by reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameState:
    """What the bytes were."""

    frames: int
    bad_crc: int
    unknown_id: int
    incompatible: int
    junk_bytes: int
    lost: int
    """Frames of the autopilot that never came, by its sequence numbers."""
    late: int
    """Frames that came twice or after their successors."""
    signed: int
    """Frames with a signature that was right."""
    refused: Mapping[str, int]
    """Frames not listened to, by reason: ids, signatures, our own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerState:
    """The autopilot."""

    system_id: int
    component_id: int
    family: str
    """``px4``, ``ardupilot`` or ``unknown``."""
    version: str
    """Of its firmware, as in ``1.16.0``; empty: not told."""
    is_heard: bool
    """Whether its heartbeat came in the last five seconds."""
    silent_s: float
    """Since its last heartbeat, s."""
    is_armed: bool
    reboots: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageState:
    """One message of the autopilot's."""

    count: int
    rate: float
    """Over the last seconds, Hz; 0: it comes no more."""
    asked: float
    """Hz; 0: nobody asked."""
    answer: str
    """To the request; empty: none was made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeState:
    """What time it is there."""

    base: str
    """``boot``, ``unix`` or ``unknown``: what the inertial messages count from."""
    is_locked: bool
    offset_s: float
    """The autopilot's clock less ours, s; NaN until locked."""
    skew_ppm: float
    """How much faster it runs."""
    rtt_p50_ms: float
    rtt_p95_ms: float
    answers: int
    """Good ones."""
    refused: Mapping[str, int]
    """Answers refused, by reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputState:
    """What was sent, and what becomes of it."""

    mode: str
    """``auto``, ``always`` or ``never``."""
    is_streaming: bool
    """Whether ODOMETRY is being sent."""
    reason: str
    """Why it is, or is not."""
    remedy: str
    """The parameter to change; empty: nothing need be."""
    parameters: Mapping[str, float]
    """The autopilot's that decide, as read."""
    sent: Mapping[str, int]
    """Messages by name."""
    withheld: int
    """ODOMETRY messages not sent by the guard."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessState:
    """The daemon."""

    version: str
    uptime_s: float
    cpu_share: float
    """Of one processor, over the last seconds."""
    rss_mb: float
    loop_lag_ms: float
    """The largest wait of the loop in the last seconds."""
    latency: Mapping[float, int]
    """From a read to the estimate sent: how many took no longer than so many ms; cumulative."""
    latency_sum_ms: float
    latency_count: int
    temperatures: Mapping[str, float]
    """Of the board, degC, by name."""
    recorded_bytes: int
    unrecorded_bytes: int
    tick_age_s: float = 0.0
    """Since the filter's task last went round, s: tenths, unless it is stuck."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """All of it, at one moment."""

    unix_ns: int
    link: LinkState
    frames: FrameState
    peer: PeerState | None
    """None: none has been heard."""
    messages: Mapping[str, MessageState]
    """By name."""
    refused: Mapping[str, int]
    """What the autopilot's messages said and nobody can mean, ``message: why``."""
    time: TimeState
    estimator: Health | None
    """None: nothing is estimated yet."""
    output: OutputState
    process: ProcessState
    sample_age_s: float = math.nan
    """Since the newest inertial sample, s: what the estimate is old; NaN: none has come."""
    resets: Mapping[str, int] = field(default_factory=dict)
    """The estimate's, by reason."""


class Finding(NamedTuple):
    """Whether the daemon does its work."""

    is_healthy: bool
    words: str
    """What is so, and where it is not as it should be, the remedy."""


def judge(snapshot: Snapshot) -> Finding:
    """Say whether the filter ticks and can be used; a silent link is told, and is no fault here."""
    stuck_s, health = snapshot.process.tick_age_s, snapshot.estimator
    if stuck_s > STALL_S:
        return Finding(False, f"stalled: the filter's task has not gone round for {stuck_s:.1f} s")
    if health is not None and health.status is Status.INVALID:
        return Finding(
            False,
            "invalid: the error has passed its limit; /status says which aids it lacks",
        )
    words = "ok: nothing is estimated yet"
    if health is not None:
        words = f"ok: the estimate is {health.status.name}"
    return Finding(True, "; ".join([words, *_silences(snapshot)]))


def _silences(snapshot: Snapshot) -> list[str]:
    """Say what has not come for too long, beginning at the wire; the rest follows from that."""
    link, peer = snapshot.link, snapshot.peer
    if not link.is_open:
        return [f"the link {link.url} is closed: check the device or the host that it names"]
    if math.isnan(link.silent_s):
        return ["not a byte has come over the link: check the wire, the port and the rate"]
    if link.silent_s > SILENCE_S:
        return [f"the link has been silent for {link.silent_s:.1f} s: check the wire"]
    if peer is None:
        return ["no autopilot has been heard: check the baud rate and link.autopilot"]
    if not peer.is_heard:
        return [f"the autopilot has been silent for {peer.silent_s:.1f} s"]
    if math.isnan(snapshot.sample_age_s):
        return ["no inertial sample has come: see the answers to our requests in /status"]
    if snapshot.sample_age_s > SILENCE_S:
        return [f"no inertial sample has come for {snapshot.sample_age_s:.1f} s"]
    return []


def to_plain(value: Any) -> Any:
    """Give data as plain tables and lists: enums by their names in small letters."""
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, (float, int, str)):
        return value
    if is_dataclass(value):
        return {entry.name: to_plain(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(to_plain(key)): to_plain(content) for key, content in value.items()}
    return [to_plain(item) for item in value] if isinstance(value, (tuple, list)) else value


def to_json(snapshot: Snapshot, breathe: Callable[[], None] = lambda: None) -> bytes:
    """Give a snapshot, and ``health``: what is found of it, as JSON; null: not known.

    Args:
        snapshot: What is told.
        breathe: Called between two stages: lets others run while the text is made.
    """
    plain: dict[str, Any] = {"health": judge(snapshot)._asdict()}
    for entry in fields(snapshot):
        plain[entry.name] = to_plain(getattr(snapshot, entry.name))
        breathe()
    return msgspec.json.encode(plain)
