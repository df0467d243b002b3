"""Whether the sensors of a recording contradict each other: units, signs, order and axes."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ekf_companion.errors import DataError
from ekf_companion.nav.arrays import known_rows
from ekf_companion.nav.measurements import Events, Kind, merge, of_receiver
from ekf_companion.review.axes import axis_disagreement
from ekf_companion.review.clocks import clock_disagreement
from ekf_companion.review.field import field_disagreement
from ekf_companion.review.fixes import disagreements, suspicion
from ekf_companion.review.plausibility import OF_COLUMNS, check_inertial

MOST_SAMPLES = 200_000
"""Inertial samples that are kept to compare their axes, with the magnetometer's beside them: 24 MB,
and a quarter of an hour."""
MOST_FIXES = 50_000
"""Fixes that are kept, with the barometer's heights beside them: 8 MB, an hour and more."""
BARO_NS = 500_000_000
"""Of barometric heights one is kept in each such time, ns: those of fixes are compared with them
over seconds."""
_COMPARED = (Kind.IMU, Kind.GNSS, Kind.BARO, Kind.MAG)
FEWEST_SAMPLES = 100
"""From which on their units and axes are looked at."""


def contradictions(
    imu: Events,
    fixes: Events | None = None,
    baro: Events | None = None,
    mag: Events | None = None,
) -> list[str]:
    """Return a sentence for each thing that cannot be meant.

    Args:
        imu: Of ``Kind.IMU``, in the order of their stamps, as the others.
        fixes: Of ``Kind.GNSS``; None: there are none, as of the others.
        baro: Of ``Kind.BARO``.
        mag: Of ``Kind.MAG``.
    """
    found = disagreements(fixes, baro) if fixes is not None else []
    # A velocity in another unit fits no axes
    axes = axis_disagreement(imu, fixes) if fixes is not None and not found else ""
    field = field_disagreement(imu, mag) if mag is not None else ""
    return [*found, *filter(None, (axes, field))]


def inertial_fault(imu: Events) -> str:
    """Return what is wrong with units, sign or axes of a table's samples; empty: nothing is seen.

    Args:
        imu: Of ``Kind.IMU``, in the order of their stamps.
    """
    imu = imu.take(known_rows(imu.values[:, :6]))
    if len(imu) < FEWEST_SAMPLES:
        return ""
    try:
        check_inertial(imu.values[:, :3], imu.values[:, 3:6], imu.t_ns, OF_COLUMNS)
    except DataError as error:
        return str(error)
    return ""


class AgreementCheck:
    """Compares the sensors of a recording that comes block by block."""

    def __init__(self, delay: float | Literal["auto"] = "auto") -> None:
        """Begin without events; the fixes are declared to be late by ``delay``, s."""
        self._delay = delay
        self._parts: dict[Kind, list[Events]] = {kind: [Events.from_rows([])] for kind in _COMPARED}
        self._samples = self._fixes = 0

    def add(self, events: Events) -> None:
        """Add the events of a block."""
        rows = {}
        if self._fixes < MOST_FIXES:
            # Positions of an autopilot's own are no measurements
            rows[Kind.GNSS] = np.flatnonzero(of_receiver(events))
            baro = np.flatnonzero(events.kind == Kind.BARO)
            rows[Kind.BARO] = baro[np.diff(events.t_ns[baro] // BARO_NS, prepend=-1) != 0]
            self._fixes += len(rows[Kind.GNSS])
        if self._samples < MOST_SAMPLES:
            for kind in (Kind.IMU, Kind.MAG):
                rows[kind] = np.flatnonzero(events.kind == kind)
            self._samples += len(rows[Kind.IMU])
        for kind, kept in rows.items():
            self._parts[kind].append(events.take(kept))

    def found(self) -> tuple[list[str], list[str]]:
        """Return a sentence for each thing that cannot be meant, and for each that is doubtful."""
        # What was kept is given up kind by kind: of an hour both together are large
        imu, fixes, baro, mag = (merge(*self._parts.pop(kind)) for kind in _COMPARED)
        if fault := inertial_fault(imu):
            return [fault], []
        found = contradictions(imu, fixes, baro if len(baro) else None, mag)
        doubts = [] if found else [suspicion(fixes), clock_disagreement(imu, fixes, self._delay)]
        return found, [doubt for doubt in doubts if doubt]
