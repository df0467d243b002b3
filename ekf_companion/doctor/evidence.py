"""The evidence: everything that the doctor judges by, at one moment.

What status and metrics read too has the types of :mod:`ekf_companion.status.snapshot`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from ekf_companion.config.config import Config
from ekf_companion.doctor.counters import Stamps
from ekf_companion.engine.health import Health
from ekf_companion.mavlink.decision import Decision
from ekf_companion.mavlink.discovery import is_autopilot
from ekf_companion.status.snapshot import (
    FrameState,
    LinkState,
    MessageState,
    OutputState,
    PeerState,
    TimeState,
)


class Means(str, Enum):
    """How the evidence was collected."""

    LIVE = "live"
    """On a link, sending what the daemon sends: heartbeats, requests and ODOMETRY."""
    LISTENING = "listening"
    """On a link, sending nothing."""
    RECORDING = "recording"
    """From a .tlog."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """A process that holds the device or the port."""

    pid: int
    name: str
    unit: str = ""
    """The systemd unit that it belongs to; empty if there is none."""
    is_daemon: bool = False
    """Whether it is the daemon of this project."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """The result of opening the link."""

    url: str
    kind: str
    """``serial``, ``udpin``, ``udpout``, ``udpbcast``, ``tcp`` or ``tcpin``."""
    device: str = ""
    baud: int = 0
    failure: str = ""
    """The system's error message; empty if it opened."""
    number: int | None = None
    """``errno``; None if there is none."""
    group: str = ""
    """The group that may open the device; empty if not known."""
    present: tuple[str, ...] = ()
    """Serial devices of this board."""
    holder: Holder | None = None
    """The process that holds it; None if there is none that we may see."""


@dataclass(slots=True, kw_only=True)
class Source:
    """One sender on the link."""

    system_id: int
    component_id: int
    frames: int = 0
    heartbeats: int = 0
    autopilot: int = 8
    """MAV_AUTOPILOT of its heartbeat; 8: not an autopilot."""
    type: int = 0
    """MAV_TYPE; 6: a ground station."""
    signed: int = 0
    """Frames with a signature."""

    @property
    def is_autopilot(self) -> bool:
        """Whether its heartbeat is that of an autopilot."""
        return self.heartbeats > 0 and is_autopilot(self.autopilot, self.type)


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """The receiver, by the last GPS_RAW_INT."""

    messages: int = 0
    fix_type: int = 0
    satellites: int = 255
    """255: not known."""
    has_accuracy: bool = False
    """Whether h_acc is not 0."""
    without_time: int = 0
    """Messages with time_usec 0."""
    still_s: float = 0.0
    """For how long the last fix has been repeated, s."""
    longest_still_s: float = 0.0
    """Longest time for which any fix was repeated, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """What the autopilot reports of its filter and of our messages."""

    texts: tuple[str, ...] = ()
    """STATUSTEXT of the severity critical or worse, or about ODOMETRY; the last ones."""
    flags: int = 0
    """Of ESTIMATOR_STATUS or EKF_STATUS_REPORT; 0 if none has come."""
    worst_ratio: float = math.nan
    """Largest innovation test ratio in ESTIMATOR_STATUS, or variance in EKF_STATUS_REPORT."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """Our ODOMETRY on the link."""

    count: int = 0
    rate: float = 0.0
    """Hz, while it was sent."""
    frames: frozenset[tuple[int, int]] = frozenset()
    """Its pairs of ``frame_id`` and ``child_frame_id``."""


_NO_FRAMES = FrameState(
    frames=0,
    bad_crc=0,
    unknown_id=0,
    incompatible=0,
    junk_bytes=0,
    lost=0,
    late=0,
    signed=0,
    refused={},
)
_NO_TIME = TimeState(
    base="unknown",
    is_locked=False,
    offset_s=math.nan,
    skew_ppm=0.0,
    rtt_p50_ms=math.nan,
    rtt_p95_ms=math.nan,
    answers=0,
    refused={},
)
_NO_OUTPUT = OutputState(
    mode="auto", is_streaming=False, reason="", remedy="", parameters={}, sent={}, withheld=0
)
_NOT_ASKED = Decision(is_streaming=False, reason="", parameters={}, is_settled=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Everything, at one moment; the defaults are those of a link without problems."""

    means: Means = Means.LIVE
    seconds: float = 0.0
    """Duration of the examination."""
    config: Config = field(default_factory=Config)
    opening: Opening | None = None
    """None for a recording."""
    link: LinkState | None = None
    bytes_in: int = 0
    sample: bytes = b""
    """The first bytes that were not a frame."""
    frames: FrameState = _NO_FRAMES
    damaged: int = 0
    """Runs of bytes in a recording that are not a record."""
    first_version: int = 0
    """Frames of MAVLink 1."""
    mismatched: Mapping[str, int] = field(default_factory=dict)
    """Whole frames whose checksum does not fit our definition of the message, by message."""
    sources: tuple[Source, ...] = ()
    peer: PeerState | None = None
    """The autopilot in use."""
    is_clash: bool = False
    """Whether somebody else sends with our ids."""
    messages: Mapping[str, MessageState] = field(default_factory=dict)
    """The autopilot's messages by name; the rate asked is the highest that was."""
    granted: Mapping[str, float] = field(default_factory=dict)
    """Rates that it granted us, Hz, which after a refusal are lower than was asked."""
    overridden: float = 0.0
    """Common rate of streams that had been granted other rates, Hz; 0 if there is none."""
    bytes_rate: float = 0.0
    """Of all frames that came, bytes/s."""
    stream_requests: int = 0
    """REQUEST_DATA_STREAM from others, by which a ground station sets rates."""
    refused: Mapping[str, int] = field(default_factory=dict)
    """Implausible values in the autopilot's messages, ``message: why``."""
    time: TimeState = _NO_TIME
    stamps: Stamps = field(default_factory=Stamps)
    """Of the inertial message in use."""
    receiver: Receiver = Receiver()
    estimator: Health | None = None
    output: OutputState = _NO_OUTPUT
    parameters: Mapping[str, float] = field(default_factory=dict)
    """The autopilot's, as far as they are known."""
    asked_parameters: frozenset[str] = frozenset()
    decision: Decision = _NOT_ASKED
    """The guard's decision, or what it would be from these parameters alone."""
    sent: Sent = Sent()
    feedback: Feedback = Feedback()

    @property
    def family(self) -> str:
        """``px4``, ``ardupilot`` or ``unknown``."""
        return self.peer.family if self.peer else "unknown"

    @property
    def is_serial(self) -> bool:
        """Whether the link is a serial port."""
        return self.opening is not None and self.opening.kind == "serial"
