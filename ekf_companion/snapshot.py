"""One account of everything: what the status, the metrics, the doctor and the tests read.

The stages are those that a measurement passes: bytes, frames, their checks, whose they are, what
they are and how often they come, what time they say, what the filter made of them, what was sent,
and what the autopilot does with that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ekf_companion.pipeline import Health


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
