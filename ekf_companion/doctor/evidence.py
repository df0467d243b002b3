"""All that the doctor goes by, at one moment: frozen, and built in one place.

What status and metrics read too is in the words of :mod:`ekf_companion.status.snapshot`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from ekf_companion.config.config import Config
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
    """How it was examined."""

    LIVE = "live"
    """As the daemon: with heartbeats, requests and ODOMETRY."""
    LISTENING = "listening"
    """A link on which nothing was sent."""
    RECORDING = "recording"
    """A .tlog."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Holder:
    """A process that has the device or the port."""

    pid: int
    name: str
    unit: str = ""
    """The systemd unit that it belongs to; empty: none."""
    is_daemon: bool = False
    """Whether it is ours."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opening:
    """What came of opening the link."""

    url: str
    kind: str
    """``serial``, ``udpin``, ``udpout``, ``udpbcast``, ``tcp`` or ``tcpin``."""
    device: str = ""
    baud: int = 0
    failure: str = ""
    """The system's words; empty: it opened."""
    number: int | None = None
    """``errno``; None: none was given."""
    group: str = ""
    """Of users who may open the device; empty: not known."""
    present: tuple[str, ...] = ()
    """Serial devices that this board has."""
    holder: Holder | None = None
    """Who has it; None: nobody, or nobody that we may see."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """One who speaks on the link."""

    system_id: int
    component_id: int
    frames: int
    heartbeats: int = 0
    autopilot: int = 8
    """MAV_AUTOPILOT of its heartbeat; 8: none."""
    type: int = 0
    """MAV_TYPE; 6: a ground station."""
    signed: int = 0
    """Frames with a signature."""

    @property
    def is_autopilot(self) -> bool:
        """Whether its heartbeat says that it flies a vehicle."""
        return self.heartbeats > 0 and is_autopilot(self.autopilot, self.type)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamps:
    """The stamps of the inertial message in use."""

    message: str = ""
    """Empty: none has come."""
    count: int = 0
    repeated: int = 0
    backward: int = 0
    gaps: int = 0
    """Steps of more than ten usual ones."""
    zero: int = 0
    is_whole_ms: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """What the last GPS_RAW_INT said."""

    messages: int = 0
    fix_type: int = 0
    satellites: int = 255
    """255: not told."""
    has_accuracy: bool = False
    """Whether h_acc says anything."""
    without_time: int = 0
    """Messages with time_usec 0."""
    still_s: float = 0.0
    """For how long the last of them has come again and again, s."""
    longest_still_s: float = 0.0
    """Likewise the longest that any fix has, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """What the autopilot says of itself and of us."""

    texts: tuple[str, ...] = ()
    """STATUSTEXT of the severity critical or worse, or about ODOMETRY; the last ones."""
    flags: int | None = None
    """ESTIMATOR_STATUS or EKF_STATUS_REPORT; None: none has come."""
    worst_ratio: float = math.nan
    """Largest innovation test ratio in ESTIMATOR_STATUS, or variance in EKF_STATUS_REPORT."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sent:
    """ODOMETRY of ours on the link."""

    count: int = 0
    rate: float = 0.0
    """Hz, while it came."""
    frames: frozenset[tuple[int, int]] = frozenset()
    """``frame_id`` and ``child_frame_id`` that it had."""


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
    """Everything, at one moment; what a test does not say is as of a link without any trouble."""

    means: Means = Means.LIVE
    seconds: float = 0.0
    """Examined."""
    config: Config = field(default_factory=Config)
    opening: Opening | None = None
    """None: a recording."""
    link: LinkState | None = None
    bytes_in: int = 0
    sample: bytes = b""
    """The first bytes that were no frame."""
    frames: FrameState = _NO_FRAMES
    damaged: int = 0
    """Runs of bytes in a recording that were no record."""
    first_version: int = 0
    """Frames of MAVLink 1."""
    mismatched: Mapping[str, int] = field(default_factory=dict)
    """Frames that are whole but whose checksum is not that of our definition, by message."""
    sources: tuple[Source, ...] = ()
    peer: PeerState | None = None
    """The autopilot that is listened to."""
    is_clash: bool = False
    """Whether somebody else speaks under our ids."""
    messages: Mapping[str, MessageState] = field(default_factory=dict)
    """The autopilot's, by name; what was asked is what was asked first."""
    granted: Mapping[str, float] = field(default_factory=dict)
    """Rates that it granted us, which after a refusal are less than was asked, Hz."""
    overruled: float = 0.0
    """Hz at which streams came alike after they had been granted otherwise; 0: they never did."""
    bytes_rate: float = 0.0
    """Of all frames that came, bytes/s."""
    stream_requests: int = 0
    """REQUEST_DATA_STREAM of others that were seen: a ground station sets rates."""
    refused: Mapping[str, int] = field(default_factory=dict)
    """What the autopilot's messages said and nobody can mean, ``message: why``."""
    time: TimeState = _NO_TIME
    stamps: Stamps = Stamps()
    receiver: Receiver = Receiver()
    estimator: Health | None = None
    output: OutputState = _NO_OUTPUT
    parameters: Mapping[str, float] = field(default_factory=dict)
    """The autopilot's, as far as they were told."""
    asked_parameters: frozenset[str] = frozenset()
    taken: Decision = _NOT_ASKED
    """What the guard decides, or would if it were asked, from these parameters alone."""
    sent: Sent = Sent()
    feedback: Feedback = Feedback()
