"""Columns of the aids that declare themselves, in each kind of log."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ekf_companion.nav.arrays import Array, Mask
from ekf_companion.nav.measurements import Kind

Table = Mapping[str, Any]
"""Columns by name."""


class Columns(NamedTuple):
    """Where an aid stands in one format."""

    name: str
    """Of the message or topic."""
    needed: tuple[str, ...]
    """Columns without which it is not used."""
    read: Callable[[Table], tuple[Mask, tuple[Array, ...]]]
    """Returns which rows are measurements, and the columns of the events."""


class Logged(NamedTuple):
    """Where an aid stands in the logs."""

    csv: dict[str, str]
    """The unit of each quantity, in the order of the row; the first is the measurement."""
    dataflash: Columns
    ulog: Columns


LOGGED: dict[Kind, Logged] = {}
"""By kind."""
DATAFLASH = {one.dataflash.name: (kind, one.dataflash) for kind, one in LOGGED.items()}
"""By message."""
ULOG = {one.ulog.name: (kind, one.ulog) for kind, one in LOGGED.items()}
"""By topic."""
CSV = {kind: one.csv for kind, one in LOGGED.items()}
