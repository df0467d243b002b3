"""One account of everything: what the status, the metrics, the doctor and the tests read.

The stages are those that a measurement passes: bytes, frames, their checks, whose they are, what
they are and how often they come, what time they say, what the filter made of them, what was sent,
and what the autopilot does with that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ekf_companion.engine.health import Health


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkState:
    """The descriptor, and the bytes."""

    url: str
    is_open: bool
    opened: int
    """How often it has been opened."""
    failure: str = ""
    """Why the last attempt to open it failed; empty: it did not, or there was none yet."""
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
    peer: str = ""
    """Host and port that the autopilot's datagrams come from, and no others; empty: not pinned."""


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
    """Frames that came after their successors."""
    duplicates: int = 0
    """Frames that came twice in a row."""
    signed: int
    """Frames with a signature that was right."""
    refused: Mapping[str, int]
    """Frames not admitted, by reason: ids that may not speak, signatures."""
    ignored: Mapping[str, int] = field(default_factory=dict)
    """Frames not listened to further, by whose they are: not the autopilot's, our own."""


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
    cause: str = ""
    """Why it probably comes so rarely, however often it is asked for, and what to change; empty:
    it comes, or there is hope."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuState:
    """Where the inertial samples come from."""

    message: str
    """``HIGHRES_IMU``, or what is taken in its place."""
    instance: int
    """The sensor in use, as HIGHRES_IMU numbers them."""
    rate: float
    """Of the message over the last seconds, Hz."""
    is_dejittered: bool
    """Whether stamps are being brought back to when the samples were taken."""


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
    residual_us: float = math.nan
    """RMS distance of the believed answers from the line through them, us; NaN: too few."""
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
    """Whether ODOMETRY was sent in the last seconds, and taken by the link."""
    rate: float = 0.0
    """Of ODOMETRY over the last seconds, Hz."""
    is_allowed: bool = True
    """The guard's verdict: whether it may be sent now."""
    is_settled: bool = True
    """Whether the verdict rests on all that decides, answered or asked for in vain."""
    is_clash: bool = False
    """Whether somebody else speaks under our system and component id."""
    reason: str
    """Of the verdict."""
    remedy: str
    """The parameter to change; empty: nothing need be."""
    parameters: Mapping[str, float]
    """The autopilot's that decide, as read."""
    sent: Mapping[str, int]
    """Messages by name; of ODOMETRY those that the link took."""
    unsent: int = 0
    """ODOMETRY messages that the link threw away: there was none, or it is too slow."""
    unsent_rate: float = 0.0
    """Of these over the last seconds, Hz."""
    withheld: int
    """ODOMETRY messages not sent by the guard."""
    texts_dropped: int = 0
    """STATUSTEXT messages that waited behind too many others."""
    unheard: Mapping[str, int] = field(default_factory=dict)
    """Datagrams that found no monitor, by its address."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessState:
    """The daemon."""

    version: str
    pid: int = 0
    uptime_s: float
    cpu_share: float
    """Of one processor, over the last seconds."""
    rss_mb: float
    loop_lag_ms: float
    """The largest wait of the loop in the last seconds."""
    latency: Mapping[float, int]
    """From a read to the estimate taken by the link: how many took no longer than so many ms;
    cumulative."""
    latency_sum_ms: float
    latency_count: int
    temperatures: Mapping[str, float]
    """Of the board, degC, by name."""
    recorded_bytes: int
    unrecorded_bytes: int
    recording_trouble: str = ""
    """Why not all is recorded at present; empty: all is, or nothing is to be."""
    tick_age_s: float = 0.0
    """Since the filter's task last went round, s: tenths, unless it is stuck."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReloadState:
    """The configuration, read anew while running."""

    count: int = 0
    """How often it was."""
    words: str = ""
    """What became of the last: keys taken and keys that wait for a restart; empty: none was."""


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
    """What messages said and nobody can mean, or was not for us, ``message: why``."""
    imu: ImuState
    time: TimeState
    estimator: Health | None
    """None: nothing is estimated yet. Its ``nis`` is the mean over the last twenty seconds."""
    output: OutputState
    process: ProcessState
    sample_age_s: float = math.nan
    """Since the newest inertial sample, s: what the estimate is old; NaN: none has come."""
    barren_s: float = 0.0
    """For how long inertial samples have come of which the filter made no estimate, s."""
    resets: Mapping[str, int] = field(default_factory=dict)
    """The estimate's in this run, by reason."""
    tuned: Mapping[str, object] = field(default_factory=dict)
    """Keys and values that were set over MAVLink and differ from the user's file."""
    reload: ReloadState = field(default_factory=ReloadState)
