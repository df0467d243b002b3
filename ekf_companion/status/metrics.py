"""The Snapshot as Prometheus metrics, as the fields declare them.

A value that is not known has no row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from enum import Enum
from typing import Any, get_args, get_type_hints

from prometheus_client import CollectorRegistry
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
)
from prometheus_client.core import Metric as Family
from prometheus_client.registry import Collector

from ekf_companion.engine.health import Health
from ekf_companion.status.metric import Metric, counter, gauge
from ekf_companion.status.snapshot import Snapshot

PREFIX = "ekf_companion_"
_PROTECTION = (
    "protection_level_meters",
    "Exceeded by the error with the probability integrity.risk; weigh_faults: act.",
)

HEALTH = {
    "samples": counter("inertial_samples", "Taken by the filter."),
    "gaps": counter("inertial_gaps", "Longer than imu.gap."),
    "imu_rate": gauge("inertial_rate_hertz", "By the samples' own stamps."),
    "arrivals": counter(
        "measurements",
        "What became of each measurement on its arrival.",
        ("sensor", "arrival"),
        rows=lambda arrivals: {
            kind: {arrival: count for arrival, count in counts.items() if count}
            for kind, counts in arrivals.items()
        },
    ),
    "verdicts": counter(
        "corrections",
        "What became of each aid when the filter came to it.",
        ("aid", "verdict"),
    ),
    "ratios": gauge(
        "test_ratio",
        "Last normalised innovation squared over its gate: above 1 it was refused.",
        ("aid",),
    ),
    "denied": gauge(
        "denied",
        "1 where the last was refused on other evidence than its test ratio.",
        ("aid",),
    ),
    "headings": counter(
        "headings",
        "What became of the headings, by kind of sensor.",
        ("sensor", "verdict"),
    ),
    "nis": gauge(
        "nis",
        "Mean normalised innovation squared over its degrees of freedom, of the last 20 s: 1 if "
        "all is well.",
        ("aid",),
    ),
    "reruns": counter("reruns", "Late measurements that made the filter redo."),
    "reasons": gauge(
        "status_reason",
        "1 for each reason why the estimate is not ok.",
        ("reason",),
        rows=lambda reasons: dict.fromkeys(reasons, 1.0),
    ),
    "std_horizontal": gauge("position_std_meters", "One sigma.", ("axis=horizontal",)),
    "std_vertical": gauge("position_std_meters", "One sigma.", ("axis=vertical",)),
    "protection_horizontal": gauge(*_PROTECTION, ("axis=horizontal",)),
    "protection_vertical": gauge(*_PROTECTION, ("axis=vertical",)),
    "faults": gauge(
        "fault_probability_ratio",
        "How probable it is that the source is wrong, from a thousandth on.",
        ("source",),
    ),
    "found_counts": counter(
        "faults_found", "Faults that were beyond doubt, by whose they are.", ("source",)
    ),
    "is_position_autopilots": gauge(
        "position_is_autopilots", "1: the autopilot's own estimate is used in place of GNSS."
    ),
    "gnss_delay": gauge("gnss_extra_delay_seconds", "What the filter adds to gnss.delay."),
    "velocity_lag": gauge(
        "gnss_velocity_lag_seconds", "How much later a fix's velocity is true than its position."
    ),
    "white_shares": gauge(
        "gnss_white_share_ratio",
        "Learnt share of the receiver's variance that is white noise.",
        ("aid",),
    ),
    "hard_iron": gauge(
        "hard_iron_gauss",
        "The vehicle's own field.",
        ("axis",),
        rows=lambda field: dict(zip("xyz", field, strict=True)),
    ),
    "gyro_noise": gauge("gyro_noise", "Learnt, rad/s per square root of Hz."),
    "accel_noise": gauge("accel_noise", "Learnt, m/s^2 per square root of Hz."),
}
"""Metrics of the filter's health, whose fields belong to the engine and declare none."""


Path = tuple[str, ...]
"""Names of fields, from the Snapshot down."""


def declared(kind: type = Snapshot, path: Path = ()) -> Iterator[tuple[Metric, Path]]:
    """Yield each metric that the fields of a dataclass declare, and the path to its field."""
    for name, hint in get_type_hints(kind, include_extras=True).items():
        metrics = [HEALTH.get(name)] if kind is Health else getattr(hint, "__metadata__", ())
        here = (*path, name)
        yield from ((one, here) for one in metrics if isinstance(one, Metric))
        for inner in types_in(hint):
            if is_dataclass(inner):
                yield from declared(inner, here)


def types_in(hint: Any) -> Iterator[type]:
    """Yield the types in an annotation, however deep."""
    if isinstance(hint, type):
        yield hint
    for argument in get_args(hint):
        yield from types_in(argument)


_FAMILIES: dict[str, list[tuple[Metric, Path]]] = {}
for _metric, _path in declared():
    _FAMILIES.setdefault(_metric.name, []).append((_metric, _path))


def registry_of(snapshot: Snapshot, pause: Callable[[], None] = lambda: None) -> CollectorRegistry:
    """Return a registry of its own that holds one snapshot.

    ``pause`` is called between two families: it lets other threads run while the text is made.
    """
    registry = CollectorRegistry()
    registry.register(_Collector(snapshot, pause))
    return registry


class _Collector(Collector):
    def __init__(self, snapshot: Snapshot, pause: Callable[[], None]) -> None:
        self._snapshot, self._pause = snapshot, pause

    def collect(self) -> Iterator[Family]:
        for family in families(self._snapshot):
            if family.samples:
                yield family
            self._pause()

    def describe(self) -> list[Family]:
        """Return no names in advance: tests check them, not each scrape."""
        return []


def families(snapshot: Snapshot) -> Iterator[Family]:
    """Yield one snapshot's metrics, family by family, in the order of the stages."""
    for members in _FAMILIES.values():
        yield _family(members, snapshot)


def _family(members: list[tuple[Metric, Path]], snapshot: Snapshot) -> Family:
    """Return the family to which one field, or several, contribute rows."""
    metric, path = members[0]
    name = PREFIX + metric.name
    if metric.kind == "histogram":
        ((_, value),) = _reach(snapshot, path)
        buckets, total = metric.rows(value)
        return HistogramMetricFamily(name, metric.help, list(buckets.items()), total)
    if metric.kind == "info":
        words = {one.labels[0]: str(v) for one, path in members for _, v in _reach(snapshot, path)}
        return InfoMetricFamily(name, metric.help, words or None)
    labels = [label.partition("=")[0] for label in metric.labels]
    make = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
    family = make(name, metric.help, labels=labels)
    for one, path in members:
        fixed = tuple(value for label in one.labels if (value := label.partition("=")[2]))
        for keys, value in _reach(snapshot, path):
            for more, number in _rows(one.rows(value)):
                if not math.isnan(number):
                    family.add_metric([*fixed, *map(_word, (*keys, *more))], number * one.scale)
    return family


def _reach(value: Any, path: Path, keys: tuple[Any, ...] = ()) -> Iterator[tuple[Any, Any]]:
    """Yield the values at the end of a path, with the keys of the mappings on the way."""
    if not path:
        yield keys, value
    elif isinstance(value, Mapping):
        for key, one in value.items():
            yield from _reach(one, path, (*keys, key))
    elif value is not None:
        yield from _reach(getattr(value, path[0]), path[1:], keys)


def _rows(value: Any, keys: tuple[Any, ...] = ()) -> Iterable[tuple[tuple[Any, ...], float]]:
    """Yield the numbers of a mapping, however deep, with their keys; or one number without."""
    if not isinstance(value, Mapping):
        yield keys, value
        return
    for key, one in value.items():
        yield from _rows(one, (*keys, *(key if isinstance(key, tuple) else (key,))))


def _word(key: Any) -> str:
    return key.name.lower() if isinstance(key, Enum) else str(key)
