"""The Snapshot as Prometheus metrics.

Names and units follow https://prometheus.io/docs/practices/naming/: base units, ``_total`` for what
only grows, one label for what tells the rows of a family apart. What is not known has no row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from ekf_companion.engine.health import Health
from ekf_companion.nav.state import Status
from ekf_companion.status.snapshot import (
    FrameState,
    ImuState,
    LinkState,
    MessageState,
    OutputState,
    PeerState,
    ProcessState,
    Snapshot,
    TimeState,
)

PREFIX = "ekf_companion_"


def info(name: str, words: str, **labels: str) -> Metric:
    """Give words, as the labels of a row that is 1."""
    return InfoMetricFamily(PREFIX + name, words, value=labels)


def rows(values: Mapping[str, float]) -> Iterable[tuple[tuple[str], float]]:
    """Give values by one label as rows."""
    return (((name,), value) for name, value in values.items())


def counter(name: str, words: str, value: float) -> Metric:
    """Give what only grows, as one number."""
    return CounterMetricFamily(PREFIX + name, words, value=value)


def gauge(name: str, words: str, value: float) -> Metric:
    """Give what goes up and down, as one number; NaN: no row."""
    return gauges(name, words, (), [((), value)])


def counters(
    name: str, words: str, labels: tuple[str, ...], rows: Iterable[tuple[tuple[str, ...], float]]
) -> Metric:
    """Give what only grows, a row for each value of the labels."""
    family = CounterMetricFamily(PREFIX + name, words, labels=labels)
    for values, value in rows:
        family.add_metric(values, value)
    return family


def gauges(
    name: str, words: str, labels: tuple[str, ...], rows: Iterable[tuple[tuple[str, ...], float]]
) -> Metric:
    """Give what goes up and down, a row for each value of the labels that is not NaN."""
    family = GaugeMetricFamily(PREFIX + name, words, labels=labels)
    for values, value in rows:
        if not math.isnan(value):
            family.add_metric(values, float(value))
    return family


_MEBI = 1 << 20


def registry_of(
    snapshot: Snapshot, breathe: Callable[[], None] = lambda: None
) -> CollectorRegistry:
    """Give a registry of its own that holds one snapshot.

    Args:
        snapshot: What is told.
        breathe: Called between two families: lets others run while the text is made.
    """
    registry = CollectorRegistry()
    registry.register(_Collector(snapshot, breathe))
    return registry


class _Collector(Collector):
    def __init__(self, snapshot: Snapshot, breathe: Callable[[], None]) -> None:
        self._snapshot, self._breathe = snapshot, breathe

    def collect(self) -> Iterator[Metric]:
        for family in families(self._snapshot):
            if family.samples:
                yield family
            self._breathe()

    def describe(self) -> list[Metric]:
        """Name nothing in advance: the names are checked by a test, not at every scrape."""
        return []


def families(snapshot: Snapshot) -> Iterator[Metric]:
    """Give one snapshot's metrics, family by family, in the order of the stages."""
    yield from _link(snapshot.link)
    yield from _frames(snapshot.frames)
    yield from _peer(snapshot.peer)
    yield from _messages(snapshot.messages)
    refused = [tuple(key.partition(": ")[::2]) for key in snapshot.refused]
    yield counters(
        "messages_refused",
        "Messages that nobody can mean, that were corrected, or that are not for us.",
        ("message", "reason"),
        zip(refused, snapshot.refused.values(), strict=True),
    )
    yield from _inertial(snapshot.imu)
    yield from _time(snapshot.time)
    yield gauge("sample_age_seconds", "Since the newest inertial sample.", snapshot.sample_age_s)
    yield gauge("barren_seconds", "Samples came, and no estimate was made.", snapshot.barren_s)
    yield counters(
        "resets", "The estimate's jumps on purpose in this run.", ("reason",), rows(snapshot.resets)
    )
    yield from _health(snapshot.estimator)
    yield from _output(snapshot.output)
    yield from _process(snapshot.process)
    yield gauges(
        "tuned",
        "1 for what was set over MAVLink and differs from the user's file.",
        ("key", "value"),
        (((key, str(value)), 1.0) for key, value in snapshot.tuned.items()),
    )
    yield counter("reloads", "Of the configuration, while running.", snapshot.reload.count)


def _link(link: LinkState) -> Iterator[Metric]:
    yield info("link", "What we listen to.", url=link.url, peer=link.peer)
    yield gauge("link_open", "1 while the descriptor is open.", link.is_open)
    yield counter("link_opens", "How often the link was opened.", link.opened)
    yield counter("link_received_bytes", "Read from the link.", link.bytes_in)
    yield counter("link_sent_bytes", "Written to the link.", link.bytes_out)
    yield counter("link_dropped_reads", "Reads that the filter was too slow for.", link.dropped)
    yield counter(
        "link_unsent_messages", "Messages that found no link, or too slow a one.", link.unsent
    )
    yield gauge("link_silent_seconds", "Since the last byte.", link.silent_s)
    yield counters("link_refused_datagrams", "Not let in.", ("reason",), rows(link.refused))


def _frames(frames: FrameState) -> Iterator[Metric]:
    yield counter("frames", "MAVLink frames with a right checksum.", frames.frames)
    errors = {
        "bad_crc": frames.bad_crc,
        "unknown_id": frames.unknown_id,
        "incompatible": frames.incompatible,
    }
    yield counters("frame_errors", "Frames that were none.", ("reason",), rows(errors))
    yield counter("junk_bytes", "Bytes of no known frame.", frames.junk_bytes)
    yield counter("frames_lost", "The autopilot's that never came.", frames.lost)
    yield counter("frames_late", "Came after their successors.", frames.late)
    yield counter("frames_duplicate", "Came twice in a row.", frames.duplicates)
    yield counter("frames_signed", "With a signature that was right.", frames.signed)
    yield counters("frames_refused", "Not admitted.", ("reason",), rows(frames.refused))
    yield counters("frames_ignored", "Not the autopilot's.", ("reason",), rows(frames.ignored))


def _peer(peer: PeerState | None) -> Iterator[Metric]:
    yield gauge(
        "autopilot_heard",
        "1 while its heartbeat came in the last five seconds.",
        peer is not None and peer.is_heard,
    )
    if peer is None:
        return
    yield info(
        "autopilot",
        "Whom we listen to.",
        system=str(peer.system_id),
        component=str(peer.component_id),
        family=peer.family,
        version=peer.version,
    )
    yield gauge("autopilot_silent_seconds", "Since its last heartbeat.", peer.silent_s)
    yield gauge("autopilot_armed", "1 while it says that it is armed.", peer.is_armed)
    yield counter("autopilot_reboots", "How often its clock began anew.", peer.reboots)


def _messages(messages: Mapping[str, MessageState]) -> Iterator[Metric]:
    label = ("message",)
    counts = {name: state.count for name, state in messages.items()}
    yield counters("messages_received", "The autopilot's.", label, rows(counts))
    rates = {name: state.rate for name, state in messages.items()}
    yield gauges("message_rate_hertz", "Over the last five seconds.", label, rows(rates))
    asked = {name: state.asked for name, state in messages.items() if state.asked}
    yield gauges("message_asked_hertz", "What was asked for.", label, rows(asked))
    vain = {name: 1.0 for name, state in messages.items() if state.cause}
    yield gauges("message_in_vain", "1 if it comes too rarely.", label, rows(vain))


def _inertial(imu: ImuState) -> Iterator[Metric]:
    yield info(
        "inertial_source",
        "Where the samples come from.",
        message=imu.message,
        instance=str(imu.instance),
    )
    yield gauge(
        "inertial_dejittered", "1 while stamps are brought back to the samples.", imu.is_dejittered
    )


def _time(state: TimeState) -> Iterator[Metric]:
    yield gauge("timesync_locked", "1 while the clocks' offset is known.", state.is_locked)
    yield gauge("clock_offset_seconds", "The autopilot's clock less ours.", state.offset_s)
    yield gauge(
        "clock_skew_ratio", "How much faster the autopilot's clock runs.", state.skew_ppm * 1e-6
    )
    trips = {"0.5": state.rtt_p50_ms * 1e-3, "0.95": state.rtt_p95_ms * 1e-3}
    yield gauges("timesync_round_trip_seconds", "Of TIMESYNC.", ("quantile",), rows(trips))
    yield gauge(
        "timesync_residual_seconds",
        "RMS distance of the answers from the line through them.",
        state.residual_us * 1e-6,
    )
    yield counter("timesync_answers", "Good ones.", state.answers)
    yield counters("timesync_refused", "Answers refused.", ("reason",), rows(state.refused))


def _output(output: OutputState) -> Iterator[Metric]:
    yield info(
        "output",
        "What is streamed, and why.",
        mode=output.mode,
        reason=output.reason,
        remedy=output.remedy,
    )
    yield gauge("odometry_allowed", "1 while the guard lets ODOMETRY be sent.", output.is_allowed)
    yield gauge("odometry_streaming", "1 while ODOMETRY is being sent.", output.is_streaming)
    yield gauge("odometry_rate_hertz", "Over the last five seconds.", output.rate)
    yield counter("odometry_withheld", "Not sent by the guard.", output.withheld)
    yield counter("odometry_unsent", "Found no link, or too slow a one.", output.unsent)
    yield gauges(
        "guard_parameter",
        "The autopilot's that decide, as read.",
        ("parameter",),
        rows(output.parameters),
    )
    yield gauge("id_clash", "1 while somebody else speaks under our ids.", output.is_clash)
    yield counter(
        "texts_dropped", "STATUSTEXT that waited behind too many others.", output.texts_dropped
    )
    yield counters(
        "monitor_unheard", "Datagrams that found nobody.", ("address",), rows(output.unheard)
    )
    yield counters(
        "messages_sent", "Ours; ODOMETRY as the link took it.", ("message",), rows(output.sent)
    )


def _process(process: ProcessState) -> Iterator[Metric]:
    yield info("build", "What is running.", version=process.version)
    yield gauge("uptime_seconds", "Since the start.", process.uptime_s)
    yield gauge(
        "cpu_share_ratio", "Of one processor, over the last five seconds.", process.cpu_share
    )
    yield gauge("resident_memory_bytes", "Of the process.", process.rss_mb * _MEBI)
    yield gauge(
        "loop_lag_seconds",
        "Longest wait of the loop in the last five seconds.",
        process.loop_lag_ms * 1e-3,
    )
    yield gauge("tick_age_seconds", "Since the filter's task went round.", process.tick_age_s)
    yield HistogramMetricFamily(
        f"{PREFIX}odometry_latency_seconds",
        "From a read to the ODOMETRY of it taken by the link.",
        buckets=[
            *((f"{ms / 1000:g}", float(count)) for ms, count in process.latency.items()),
            ("+Inf", float(process.latency_count)),
        ],
        sum_value=process.latency_sum_ms * 1e-3,
    )
    yield gauges("temperature_celsius", "Of the board.", ("sensor",), rows(process.temperatures))
    yield counter("recorded_bytes", "Written to the recording.", process.recorded_bytes)
    yield counter("unrecorded_bytes", "Lost to the recording.", process.unrecorded_bytes)


def _health(health: Health | None) -> Iterator[Metric]:
    """Give the metrics of an estimate; None: nothing is estimated yet, which is a status too."""
    yield from _status(health)
    if health is not None:
        yield from _estimator(health)
        yield from _learnt(health)


def _status(health: Health | None) -> Iterator[Metric]:
    now = Status.INIT if health is None else health.status
    yield gauges(
        "status",
        "How far the estimate can be trusted: 1 for the one that holds.",
        ("status",),
        rows({status.name.lower(): status is now for status in Status}),
    )


def _estimator(health: Health) -> Iterator[Metric]:
    yield counter("inertial_samples", "Taken by the filter.", health.samples)
    yield counter("inertial_gaps", "Longer than imu.gap.", health.gaps)
    yield gauge("inertial_rate_hertz", "By the samples' own stamps.", health.imu_rate)
    arrivals = {
        (kind.name.lower(), arrival.name.lower()): count
        for kind, counts in health.arrivals.items()
        for arrival, count in counts.items()
        if count
    }
    yield counters(
        "measurements",
        "What became of each measurement on its arrival.",
        ("sensor", "arrival"),
        arrivals.items(),
    )
    verdicts = {
        (aid.name.lower(), verdict.name.lower()): count
        for aid, counts in health.verdicts.items()
        for verdict, count in counts.items()
    }
    yield counters(
        "corrections",
        "What became of each aid when the filter came to it.",
        ("aid", "verdict"),
        verdicts.items(),
    )
    yield gauges(
        "test_ratio",
        "Last normalised innovation squared over its gate: above 1 it was refused.",
        ("aid",),
        rows({aid.name.lower(): ratio for aid, ratio in health.ratios.items()}),
    )
    yield gauges(
        "nis",
        "Mean normalised innovation squared over its degrees of freedom, of the last 20 s: 1 if "
        "all is well.",
        ("aid",),
        rows({aid.name.lower(): nis for aid, nis in health.nis.items()}),
    )
    yield counter("reruns", "Late measurements that made the filter redo.", health.reruns)
    stds = {"horizontal": health.std_horizontal, "vertical": health.std_vertical}
    yield gauges("position_std_meters", "One sigma.", ("axis",), rows(stds))


def _learnt(health: Health) -> Iterator[Metric]:
    yield gauge(
        "gnss_extra_delay_seconds", "What the filter adds to gnss.delay.", health.gnss_delay
    )
    shares = {aid.name.lower(): share for aid, share in health.white_shares.items()}
    yield gauges(
        "gnss_white_share_ratio",
        "Learnt share of the receiver's variance that is white noise.",
        ("aid",),
        rows(shares),
    )
    iron = dict(zip("xyz", health.hard_iron, strict=True))
    yield gauges("hard_iron_gauss", "The vehicle's own field.", ("axis",), rows(iron))
    yield gauge("gyro_noise", "Learnt, rad/s per square root of Hz.", health.gyro_noise)
    yield gauge("accel_noise", "Learnt, m/s^2 per square root of Hz.", health.accel_noise)
