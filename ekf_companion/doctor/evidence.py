"""The evidence: everything that the doctor judges by, at one moment.

What status and metrics read too has the types of :mod:`ekf_companion.status.snapshot`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from ekf_companion.config.config import Config
from ekf_companion.doctor.counters import Stamps
from ekf_companion.engine.health import Health
from ekf_companion.link.holder import Holder
from ekf_companion.mavlink.decision import Decision
from ekf_companion.mavlink.discovery import is_autopilot
from ekf_companion.mavlink.following import State
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
    poses: Counter[int] = field(default_factory=Counter)
    """Messages that an autopilot may fuse beside our ODOMETRY, by their ids."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Everything, at one moment."""

    means: Means
    seconds: float
    """Duration of the examination."""
    config: Config
    opening: Opening | None
    """None for a recording."""
    link: LinkState | None
    bytes_in: int
    sample: bytes
    """The first bytes that were not a frame."""
    frames: FrameState
    damaged: int
    """Runs of bytes in a recording that are not a record."""
    first_version: int
    """Frames of MAVLink 1."""
    mismatched: Mapping[str, int]
    """Whole frames whose checksum does not fit our definition of the message, by message."""
    sources: tuple[Source, ...]
    peer: PeerState | None
    """The autopilot in use."""
    is_clash: bool
    """Whether somebody else sends with our ids."""
    messages: Mapping[str, MessageState]
    """The autopilot's messages by name; the rate asked is the last that was."""
    granted: Mapping[str, float]
    """Rates that it granted us, Hz, which after a refusal are lower than was asked."""
    overridden: float
    """Common rate of streams that had been granted other rates, Hz; 0 if there is none."""
    bytes_rate: float
    """Of all frames that came, bytes/s."""
    stream_requests: int
    """REQUEST_DATA_STREAM from others, by which a ground station sets rates."""
    refused: Mapping[str, int]
    """Implausible values in the autopilot's messages, ``message: why``."""
    time: TimeState
    stamps: Stamps
    """Of the inertial message in use."""
    receiver: Receiver
    estimator: Health | None
    output: OutputState
    parameters: Mapping[str, float]
    """The autopilot's, as far as they are known."""
    asked_parameters: frozenset[str]
    following: State
    """How far the autopilot's own estimate is from the ODOMETRY that it is sent."""
    decision: Decision
    """The guard's decision, or what it would be from these parameters alone."""
    sent: Sent
    feedback: Feedback

    @property
    def family(self) -> str:
        """``px4``, ``ardupilot`` or ``unknown``."""
        return self.peer.family if self.peer else "unknown"

    @property
    def is_serial(self) -> bool:
        """Whether the link is a serial port."""
        return self.opening is not None and self.opening.kind == "serial"
