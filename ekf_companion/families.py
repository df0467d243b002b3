"""Prometheus' families of metrics under our prefix; what is not known has no row."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
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
