"""How a field of the Snapshot becomes a metric of Prometheus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal


@dataclass(frozen=True, slots=True)
class Metric:
    """How Prometheus sees a field of the Snapshot."""

    kind: Literal["counter", "gauge", "info", "histogram"]
    name: str
    """Without prefix and ``_total``, in base units: prometheus.io/docs/practices/naming."""
    help: str
    labels: tuple[str, ...] = ()
    """Labels of the rows; for a field that is one row of several with its value: ``axis=north``."""
    scale: float = 1.0
    """Base units in one unit of the field."""
    rows: Callable[[Any], Any] = lambda value: value
    """Turns the field into a number, or into a number for each label; NaN: no row."""


counter = partial(Metric, "counter")
gauge = partial(Metric, "gauge")
info = partial(Metric, "info")
