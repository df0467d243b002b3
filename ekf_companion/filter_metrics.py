"""The filter's own account of itself as Prometheus metrics."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client.core import Metric

from ekf_companion.families import counter, counters, gauge, gauges, rows
from ekf_companion.nav.state import Status
from ekf_companion.pipeline import Health


def families(health: Health | None) -> Iterator[Metric]:
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
