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

from ekf_companion.nav.state import Status
from ekf_companion.pipeline import Health
from ekf_companion.snapshot import (
    FrameState,
    LinkState,
    MessageState,
    OutputState,
    PeerState,
    ProcessState,
    Snapshot,
    TimeState,
)

PREFIX = "ekf_companion_"
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
    yield _counters(
        "messages_refused",
        "Messages that said what nobody can mean, or that were corrected.",
        ("message", "reason"),
        zip(refused, snapshot.refused.values(), strict=True),
    )
    yield from _time(snapshot.time)
    yield _gauge("sample_age_seconds", "Since the newest inertial sample.", snapshot.sample_age_s)
    yield _counters(
        "resets", "The estimate's jumps on purpose.", ("reason",), _rows(snapshot.resets)
    )
    yield from _status(snapshot.estimator)
    if snapshot.estimator is not None:
        yield from _estimator(snapshot.estimator)
        yield from _learnt(snapshot.estimator)
    yield from _output(snapshot.output)
    yield from _process(snapshot.process)


def _link(link: LinkState) -> Iterator[Metric]:
    yield _gauge("link_open", "1 while the descriptor is open.", link.is_open)
    yield _counter("link_opens", "How often the link was opened.", link.opened)
    yield _counter("link_received_bytes", "Read from the link.", link.bytes_in)
    yield _counter("link_sent_bytes", "Written to the link.", link.bytes_out)
    yield _counter("link_dropped_reads", "Reads that the filter was too slow for.", link.dropped)
    yield _counter(
        "link_unsent_messages", "Messages that found no link, or too slow a one.", link.unsent
    )
    yield _gauge("link_silent_seconds", "Since the last byte.", link.silent_s)
    yield _counters("link_refused_datagrams", "Not let in.", ("reason",), _rows(link.refused))


def _frames(frames: FrameState) -> Iterator[Metric]:
    yield _counter("frames", "MAVLink frames with a right checksum.", frames.frames)
    errors = {
        "bad_crc": frames.bad_crc,
        "unknown_id": frames.unknown_id,
        "incompatible": frames.incompatible,
    }
    yield _counters("frame_errors", "Frames that were none.", ("reason",), _rows(errors))
    yield _counter("junk_bytes", "Bytes of no known frame.", frames.junk_bytes)
    yield _counter("frames_lost", "The autopilot's that never came.", frames.lost)
    yield _counter("frames_late", "Came twice or after their successors.", frames.late)
    yield _counter("frames_signed", "With a signature that was right.", frames.signed)
    yield _counters("frames_refused", "Not listened to.", ("reason",), _rows(frames.refused))


def _peer(peer: PeerState | None) -> Iterator[Metric]:
    yield _gauge(
        "autopilot_heard",
        "1 while its heartbeat came in the last five seconds.",
        peer is not None and peer.is_heard,
    )
    if peer is None:
        return
    labels = {"system": str(peer.system_id), "component": str(peer.component_id)}
    yield InfoMetricFamily(
        f"{PREFIX}autopilot",
        "Whom we listen to.",
        value={**labels, "family": peer.family, "version": peer.version},
    )
    yield _gauge("autopilot_silent_seconds", "Since its last heartbeat.", peer.silent_s)
    yield _gauge("autopilot_armed", "1 while it says that it is armed.", peer.is_armed)
    yield _counter("autopilot_reboots", "How often its clock began anew.", peer.reboots)


def _messages(messages: Mapping[str, MessageState]) -> Iterator[Metric]:
    label = ("message",)
    counts = {name: state.count for name, state in messages.items()}
    yield _counters("messages_received", "The autopilot's.", label, _rows(counts))
    rates = {name: state.rate for name, state in messages.items()}
    yield _gauges("message_rate_hertz", "Over the last five seconds.", label, _rows(rates))
    asked = {name: state.asked for name, state in messages.items() if state.asked}
    yield _gauges("message_asked_hertz", "What was asked for.", label, _rows(asked))


def _time(state: TimeState) -> Iterator[Metric]:
    yield _gauge("timesync_locked", "1 while the clocks' offset is known.", state.is_locked)
    yield _gauge("clock_offset_seconds", "The autopilot's clock less ours.", state.offset_s)
    yield _gauge(
        "clock_skew_ratio", "How much faster the autopilot's clock runs.", state.skew_ppm * 1e-6
    )
    trips = {"0.5": state.rtt_p50_ms * 1e-3, "0.95": state.rtt_p95_ms * 1e-3}
    yield _gauges("timesync_round_trip_seconds", "Of TIMESYNC.", ("quantile",), _rows(trips))
    yield _counter("timesync_answers", "Good ones.", state.answers)
    yield _counters("timesync_refused", "Answers refused.", ("reason",), _rows(state.refused))


def _status(health: Health | None) -> Iterator[Metric]:
    now = Status.INIT if health is None else health.status
    yield _gauges(
        "status",
        "How far the estimate can be trusted: 1 for the one that holds.",
        ("status",),
        _rows({status.name.lower(): status is now for status in Status}),
    )


def _estimator(health: Health) -> Iterator[Metric]:
    yield _counter("inertial_samples", "Taken by the filter.", health.samples)
    yield _counter("inertial_gaps", "Longer than imu.gap.", health.gaps)
    yield _gauge("inertial_rate_hertz", "By the samples' own stamps.", health.imu_rate)
    arrivals = {
        (kind.name.lower(), arrival.name.lower()): count
        for kind, counts in health.arrivals.items()
        for arrival, count in counts.items()
        if count
    }
    yield _counters(
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
    yield _counters(
        "corrections",
        "What became of each aid when the filter came to it.",
        ("aid", "verdict"),
        verdicts.items(),
    )
    yield _gauges(
        "test_ratio",
        "Last normalised innovation squared over its gate: above 1 it was refused.",
        ("aid",),
        _rows({aid.name.lower(): ratio for aid, ratio in health.ratios.items()}),
    )
    yield _gauges(
        "nis",
        "Mean normalised innovation squared over its degrees of freedom: 1 if all is well.",
        ("aid",),
        _rows({aid.name.lower(): nis for aid, nis in health.nis.items()}),
    )
    yield _counter("reruns", "Late measurements that made the filter redo.", health.reruns)
    stds = {"horizontal": health.std_horizontal, "vertical": health.std_vertical}
    yield _gauges("position_std_meters", "One sigma.", ("axis",), _rows(stds))


def _learnt(health: Health) -> Iterator[Metric]:
    yield _gauge(
        "gnss_extra_delay_seconds", "What the filter adds to gnss.delay.", health.gnss_delay
    )
    shares = {aid.name.lower(): share for aid, share in health.white_shares.items()}
    yield _gauges(
        "gnss_white_share_ratio",
        "Learnt share of the receiver's variance that is white noise.",
        ("aid",),
        _rows(shares),
    )
    iron = dict(zip("xyz", health.hard_iron, strict=True))
    yield _gauges("hard_iron_gauss", "The vehicle's own field.", ("axis",), _rows(iron))
    yield _gauge("gyro_noise", "Learnt, rad/s per square root of Hz.", health.gyro_noise)
    yield _gauge("accel_noise", "Learnt, m/s^2 per square root of Hz.", health.accel_noise)


def _output(output: OutputState) -> Iterator[Metric]:
    yield InfoMetricFamily(
        f"{PREFIX}output",
        "What is streamed, and why.",
        value={"mode": output.mode, "reason": output.reason, "remedy": output.remedy},
    )
    yield _gauge("odometry_streaming", "1 while ODOMETRY is being sent.", output.is_streaming)
    yield _counter("odometry_withheld", "Not sent by the guard.", output.withheld)
    yield _counters("messages_sent", "Ours.", ("message",), _rows(output.sent))


def _process(process: ProcessState) -> Iterator[Metric]:
    yield InfoMetricFamily(f"{PREFIX}build", "What is running.", value={"version": process.version})
    yield _gauge("uptime_seconds", "Since the start.", process.uptime_s)
    yield _gauge(
        "cpu_share_ratio", "Of one processor, over the last five seconds.", process.cpu_share
    )
    yield _gauge("resident_memory_bytes", "Of the process.", process.rss_mb * _MEBI)
    yield _gauge(
        "loop_lag_seconds",
        "Longest wait of the loop in the last five seconds.",
        process.loop_lag_ms * 1e-3,
    )
    yield _gauge("tick_age_seconds", "Since the filter's task went round.", process.tick_age_s)
    yield HistogramMetricFamily(
        f"{PREFIX}odometry_latency_seconds",
        "From a read to the ODOMETRY sent of it.",
        buckets=[
            *((f"{ms / 1000:g}", float(count)) for ms, count in process.latency.items()),
            ("+Inf", float(process.latency_count)),
        ],
        sum_value=process.latency_sum_ms * 1e-3,
    )
    yield _gauges("temperature_celsius", "Of the board.", ("sensor",), _rows(process.temperatures))
    yield _counter("recorded_bytes", "Written to the recording.", process.recorded_bytes)
    yield _counter("unrecorded_bytes", "Lost to the recording.", process.unrecorded_bytes)


def _rows(values: Mapping[str, float]) -> Iterable[tuple[tuple[str], float]]:
    return (((name,), value) for name, value in values.items())


def _counter(name: str, words: str, value: float) -> Metric:
    return CounterMetricFamily(PREFIX + name, words, value=value)


def _gauge(name: str, words: str, value: float) -> Metric:
    return _gauges(name, words, (), [((), value)])


def _counters(
    name: str, words: str, labels: tuple[str, ...], rows: Iterable[tuple[tuple[str, ...], float]]
) -> Metric:
    family = CounterMetricFamily(PREFIX + name, words, labels=labels)
    for values, value in rows:
        family.add_metric(values, value)
    return family


def _gauges(
    name: str, words: str, labels: tuple[str, ...], rows: Iterable[tuple[tuple[str, ...], float]]
) -> Metric:
    family = GaugeMetricFamily(PREFIX + name, words, labels=labels)
    for values, value in rows:
        if not math.isnan(value):
            family.add_metric(values, float(value))
    return family
