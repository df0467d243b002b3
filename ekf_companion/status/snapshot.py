"""One record of everything: what the status, the metrics, the doctor and the tests read.

The stages are those that a measurement passes: bytes, frames, their checks, their senders, messages
and their rates, the autopilot's clock, the filter, what is sent, and what the autopilot does with
it. A field that Prometheus scrapes carries its metric; the metric's help describes the field, and a
string below adds what the help leaves open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from ekf_companion.engine.health import Health
from ekf_companion.nav.state import Status
from ekf_companion.status.metric import Metric, counter, gauge, info
from ekf_companion.status.vehicle import Preflight, VehicleEstimate

_LINK = ("link", "What we listen to.")
_FRAME_ERRORS = ("frame_errors", "Frames that were none.")
_AUTOPILOT = ("autopilot", "Whom we listen to.")
_INERTIAL_SOURCE = ("inertial_source", "Where the samples come from.")
_ROUND_TRIP = ("timesync_round_trip_seconds", "Of TIMESYNC.")
_OUTPUT = ("output", "What is streamed, and why.")
_MEBI = 1 << 20


def _unless_zero(rate: float) -> float:
    return rate or math.nan


def _is_said(words: str) -> float:
    return 1.0 if words else math.nan


def _by_message_and_reason(counts: Mapping[str, int]) -> dict[tuple[str, ...], int]:
    return {key.partition(": ")[::2]: count for key, count in counts.items()}


def _latency(process: ProcessState) -> tuple[dict[str, float], float]:
    """Return the buckets of a histogram by their upper bound, s, and the sum, s."""
    buckets = {f"{ms / 1000:g}": float(count) for ms, count in process.latency.items()}
    return buckets | {"+Inf": float(process.latency_count)}, process.latency_sum_ms * 1e-3


def _statuses(health: Health | None) -> dict[Status, bool]:
    """Return the status that holds; before anything is estimated, INIT."""
    now = Status.INIT if health is None else health.status
    return {status: status is now for status in Status}


def _by_status_and_reason(
    seconds: Mapping[str, Mapping[str, float]],
) -> dict[tuple[str, ...], float]:
    """Return the seconds by two labels."""
    return {(each, why): s for each, by_reason in seconds.items() for why, s in by_reason.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkState:
    """The descriptor, and the bytes."""

    url: Annotated[str, info(*_LINK, ("url",))]
    is_open: Annotated[bool, gauge("link_open", "1 while the descriptor is open.")]
    opened: Annotated[int, counter("link_opens", "How often the link was opened.")]
    failure: str = ""
    """Why the last attempt to open it failed; empty: it did not, or there was none yet."""
    bytes_in: Annotated[int, counter("link_received_bytes", "Read from the link.")]
    bytes_out: Annotated[int, counter("link_sent_bytes", "Written to the link.")]
    dropped: Annotated[
        int, counter("link_dropped_reads", "Reads that the filter was too slow for.")
    ]
    unsent: Annotated[
        int, counter("link_unsent_messages", "Messages that found no link, or too slow a one.")
    ]
    silent_s: Annotated[float, gauge("link_silent_seconds", "Since the last byte.")]
    """NaN: none has come."""
    refused: Annotated[
        Mapping[str, int], counter("link_refused_datagrams", "Not let in.", ("reason",))
    ]
    peer: Annotated[str, info(*_LINK, ("peer",))] = ""
    """Host and port that the autopilot's datagrams come from, and no others; empty: not pinned."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameState:
    """Frames found in the bytes."""

    frames: Annotated[int, counter("frames", "MAVLink frames with a right checksum.")]
    bad_crc: Annotated[int, counter(*_FRAME_ERRORS, ("reason=bad_crc",))]
    """Their checksum is wrong."""
    unknown_id: Annotated[int, counter(*_FRAME_ERRORS, ("reason=unknown_id",))]
    """Messages with an id that we do not know."""
    incompatible: Annotated[int, counter(*_FRAME_ERRORS, ("reason=incompatible",))]
    """Frames with flags that we do not know."""
    junk_bytes: Annotated[int, counter("junk_bytes", "Bytes of no known frame.")]
    lost: Annotated[int, counter("frames_lost", "The autopilot's that never came.")]
    """By gaps in the sequence numbers, as the two that follow."""
    late: Annotated[int, counter("frames_late", "Came after their successors.")]
    duplicates: Annotated[int, counter("frames_duplicate", "Came twice in a row.")] = 0
    again: Annotated[
        int, counter("frames_again", "Stamped, old, and heard before: not counted.")
    ] = 0
    again_late: Annotated[
        float, gauge("frames_again_late_seconds", "By how much the last was.")
    ] = 0.0
    signed: Annotated[int, counter("frames_signed", "With a signature that was right.")]
    refused: Annotated[Mapping[str, int], counter("frames_refused", "Not admitted.", ("reason",))]
    """By reason: ids that are not allowed, signatures."""
    ignored: Annotated[
        Mapping[str, int], counter("frames_ignored", "Not the autopilot's.", ("reason",))
    ] = field(default_factory=dict)
    """By sender: other systems, or ourselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerState:
    """The autopilot."""

    system_id: Annotated[int, info(*_AUTOPILOT, ("system",))]
    component_id: Annotated[int, info(*_AUTOPILOT, ("component",))]
    family: Annotated[str, info(*_AUTOPILOT, ("family",))]
    """``px4``, ``ardupilot`` or ``unknown``."""
    version: Annotated[str, info(*_AUTOPILOT, ("version",))]
    """Version of its firmware, as in ``1.16.0``; empty: not reported."""
    is_heard: bool
    """Whether its heartbeat came in the last five seconds."""
    silent_s: Annotated[float, gauge("autopilot_silent_seconds", "Since its last heartbeat.")]
    is_armed: Annotated[bool, gauge("autopilot_armed", "1 while it says that it is armed.")]
    reboots: Annotated[int, counter("autopilot_reboots", "How often its clock began anew.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageState:
    """One message of the autopilot."""

    count: Annotated[int, counter("messages_received", "The autopilot's.", ("message",))]
    """How many have come."""
    rate: Annotated[float, gauge("message_rate_hertz", "Over the last five seconds.", ("message",))]
    """0: it has stopped."""
    asked: Annotated[
        float,
        gauge(
            "message_asked_hertz",
            "What was asked for.",
            ("message",),
            rows=_unless_zero,
        ),
    ]
    """0: not requested."""
    answer: str
    """Answer to the request; empty: none was made."""
    cause: Annotated[
        str,
        gauge(
            "message_in_vain",
            "1 if it comes too rarely.",
            ("message",),
            rows=_is_said,
        ),
    ] = ""
    """Why it probably comes so rarely although it is requested, and what to change; empty: it
    comes, or still may."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuState:
    """Where the inertial samples come from."""

    message: Annotated[str, info(*_INERTIAL_SOURCE, ("message",))]
    """``HIGHRES_IMU``, or the message used instead."""
    instance: Annotated[int, info(*_INERTIAL_SOURCE, ("instance",))]
    """The sensor in use, as HIGHRES_IMU numbers them."""
    rate: float
    """Of the message over the last seconds, Hz."""
    is_dejittered: Annotated[
        bool, gauge("inertial_dejittered", "1 while stamps are brought back to the samples.")
    ]
    units: Mapping[str, str] = field(default_factory=dict)
    """Each inertial unit that is heard, by its number, and what becomes of it: used, spare, or why
    it is not; empty: there is one."""
    faults: Annotated[
        Mapping[str, int], counter("inertial_unit_faults", "Of each unit.", ("unit",))
    ] = field(default_factory=dict)
    """How often each was found at fault."""
    changes: Annotated[
        int, counter("inertial_unit_changes", "How often another unit was used.")
    ] = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeState:
    """The autopilot's clock."""

    base: str
    """``boot``, ``unix`` or ``unknown``: the origin of the inertial messages' stamps."""
    is_locked: Annotated[bool, gauge("timesync_locked", "1 while the clocks' offset is known.")]
    trouble: str = ""
    """Why the clocks are not locked; empty: they are, or still may."""
    offset_s: Annotated[float, gauge("clock_offset_seconds", "The autopilot's clock less ours.")]
    """NaN until locked."""
    skew_ppm: Annotated[
        float,
        gauge("clock_skew_ratio", "How much faster the autopilot's clock runs.", scale=1e-6),
    ]
    rtt_p50_ms: Annotated[float, gauge(*_ROUND_TRIP, ("quantile=0.5",), scale=1e-3)]
    """The median."""
    rtt_p95_ms: Annotated[float, gauge(*_ROUND_TRIP, ("quantile=0.95",), scale=1e-3)]
    """95 % are shorter."""
    residual_us: Annotated[
        float,
        gauge(
            "timesync_residual_seconds",
            "RMS distance of the answers from the line through them.",
            scale=1e-6,
        ),
    ] = math.nan
    """Of the answers used; NaN: too few."""
    answers: Annotated[int, counter("timesync_answers", "Good ones.")]
    """Answers to our questions."""
    refused: Annotated[
        Mapping[str, int], counter("timesync_refused", "Answers refused.", ("reason",))
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputState:
    """What is sent, and what becomes of it."""

    mode: Annotated[str, info(*_OUTPUT, ("mode",))]
    """``auto``, ``always`` or ``never``."""
    is_streaming: Annotated[bool, gauge("odometry_streaming", "1 while ODOMETRY is being sent.")]
    """Whether the link took one in the last seconds."""
    rate: Annotated[float, gauge("odometry_rate_hertz", "Over the last five seconds.")] = 0.0
    is_allowed: Annotated[
        bool, gauge("odometry_allowed", "1 while the guard lets ODOMETRY be sent.")
    ] = True
    is_settled: bool = True
    """Whether the guard's verdict is final: all that it depends on was answered, or asked for in
    vain."""
    is_clash: Annotated[bool, gauge("id_clash", "1 while somebody else speaks under our ids.")] = (
        False
    )
    reason: Annotated[str, info(*_OUTPUT, ("reason",))]
    """Reason of the guard's verdict."""
    silence: str = ""
    """Why nothing is sent although there is an estimate, as after long dead reckoning; empty: it is
    sent, or the guard withholds it."""
    remedy: Annotated[str, info(*_OUTPUT, ("remedy",))]
    """The parameter to change; empty: none."""
    parameters: Annotated[
        Mapping[str, float],
        gauge("guard_parameter", "The autopilot's that decide, as read.", ("parameter",)),
    ]
    sent: Annotated[
        Mapping[str, int],
        counter("messages_sent", "Ours; ODOMETRY as the link took it.", ("message",)),
    ]
    unsent: Annotated[
        int, counter("odometry_unsent", "Found no link, too slow a one, or was too old.")
    ] = 0
    unsent_rate: float = 0.0
    """Rate of ODOMETRY not sent over the last seconds, Hz: the link had no room."""
    held_rate: float = 0.0
    """Of these, Hz dropped because the loop of this board stalled."""
    late_rate: float = 0.0
    """Of these, Hz whose samples had come too late, while the loop ran."""
    withheld: Annotated[
        int, counter("odometry_withheld", "Not sent by the guard, or as the line carries fewer.")
    ]
    late_s: Annotated[
        float, gauge("odometry_late_seconds", "From a state to its ODOMETRY at the autopilot.")
    ] = math.nan
    """By the answers to TIMESYNC over ten seconds, the median; NaN: too few."""
    every: Annotated[int, gauge("odometry_every", "Of so many ODOMETRY the line carries one.")] = 1
    second_source: str = ""
    """Who else sends poses to the autopilot, in which message and how often; empty: nobody."""
    advice: str = ""
    """What to set for the measured delay, or why nothing helps; empty: nothing to do."""
    texts_dropped: Annotated[
        int, counter("texts_dropped", "STATUSTEXT that waited behind too many others.")
    ] = 0
    unheard: Annotated[
        Mapping[str, int],
        counter("monitor_unheard", "Datagrams that found nobody.", ("address",)),
    ] = field(default_factory=dict)
    """By the monitor's address."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessState:
    """The daemon."""

    version: Annotated[str, info("build", "What is running.", ("version",))]
    pid: int = 0
    """Process id."""
    uptime_s: Annotated[float, gauge("uptime_seconds", "Since the start.")]
    cpu_share: Annotated[
        float, gauge("cpu_share_ratio", "Of one processor, over the last five seconds.")
    ]
    rss_mb: Annotated[float, gauge("resident_memory_bytes", "Of the process.", scale=_MEBI)]
    """MiB."""
    loop_lag_ms: Annotated[
        float,
        gauge("loop_lag_seconds", "Longest wait of the loop in the last five seconds.", scale=1e-3),
    ]
    latency: Mapping[float, int]
    """From a read to the estimate taken by the link: how many took no longer than so many ms;
    cumulative."""
    latency_sum_ms: float
    """Of all of them."""
    latency_count: int
    """How many there were."""
    temperatures: Annotated[
        Mapping[str, float], gauge("temperature_celsius", "Of the board.", ("sensor",))
    ]
    recorded_bytes: Annotated[int, counter("recorded_bytes", "Written to the recording.")]
    unrecorded_bytes: Annotated[int, counter("unrecorded_bytes", "Lost to the recording.")]
    recording_trouble: str = ""
    """Why not everything is recorded at present; empty: everything is, or nothing is wanted."""
    tick_age_s: Annotated[
        float, gauge("tick_age_seconds", "Since the filter's task went round.")
    ] = 0.0
    """Age of the last run of the loop, s: tenths of a second unless it is stuck."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReloadState:
    """Reloads of the configuration."""

    count: Annotated[int, counter("reloads", "Of the configuration, while running.")] = 0
    words: str = ""
    """Result of the last reload: keys applied, and keys that wait for a restart; empty: none
    yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """State of the whole daemon at one moment."""

    unix_ns: int
    """When, unix time, ns."""
    link: LinkState
    frames: FrameState
    peer: Annotated[
        PeerState | None,
        gauge(
            "autopilot_heard",
            "1 while its heartbeat came in the last five seconds.",
            rows=lambda peer: peer is not None and peer.is_heard,
        ),
    ]
    """None: none has been heard."""
    messages: Mapping[str, MessageState]
    """By name."""
    refused: Annotated[
        Mapping[str, int],
        counter(
            "messages_refused",
            "Messages that nobody can mean, that were corrected, or that are not for us.",
            ("message", "reason"),
            rows=_by_message_and_reason,
        ),
    ]
    """``message: why``."""
    imu: ImuState
    time: TimeState
    estimator: Annotated[
        Health | None,
        gauge(
            "status",
            "How far the estimate can be trusted: 1 for the one that holds.",
            ("status",),
            rows=_statuses,
        ),
    ]
    """None: nothing is estimated yet. Its ``nis`` is the mean over the last twenty seconds."""
    output: OutputState
    process: Annotated[
        ProcessState,
        Metric(
            "histogram",
            "odometry_latency_seconds",
            "From a read to the ODOMETRY of it taken by the link.",
            ("le",),
            rows=_latency,
        ),
    ]
    sample_age_s: Annotated[
        float, gauge("sample_age_seconds", "Since the newest inertial sample.")
    ] = math.nan
    """Age of the estimate; NaN: none has come."""
    vehicle: VehicleEstimate
    preflight: Preflight
    barren_s: Annotated[
        float, gauge("barren_seconds", "Samples came, and no estimate was made.")
    ] = 0.0
    resets: Annotated[
        Mapping[str, int],
        counter("resets", "The estimate's jumps on purpose in this run.", ("reason",)),
    ] = field(default_factory=dict)
    seconds: Annotated[
        Mapping[str, Mapping[str, float]],
        counter(
            "status_seconds",
            "Time of this run by status and by its foremost reason.",
            ("status", "reason"),
            rows=_by_status_and_reason,
        ),
    ] = field(default_factory=dict)
    """By name of the status, then of its foremost reason (empty: none): the seconds of a status add
    up."""
    tuned: Annotated[
        Mapping[str, object],
        gauge(
            "tuned",
            "1 for what was set over MAVLink and differs from the user's file.",
            ("key", "value"),
            rows=lambda tuned: {(key, str(value)): 1.0 for key, value in tuned.items()},
        ),
    ] = field(default_factory=dict)
    reload: ReloadState = field(default_factory=ReloadState)
