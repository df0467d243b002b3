"""Whether the sensors of a recording contradict each other: units, signs, order and axes."""

from __future__ import annotations

import numpy as np

from ekf_companion.errors import DataError
from ekf_companion.nav.arrays import known_rows
from ekf_companion.nav.measurements import GNSS_FLAGS, Events, GnssFlag, Kind, merge
from ekf_companion.replay.axis_agreement import axis_disagreement
from ekf_companion.replay.field_agreement import field_disagreement
from ekf_companion.replay.fix_agreement import disagreements, suspicion
from ekf_companion.replay.plausibility import OF_COLUMNS, check_inertial

MOST_SAMPLES = 200_000
"""Inertial samples that are kept to compare their axes: 24 MB, and a quarter of an hour."""
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

    def __init__(self) -> None:
        self._blocks: list[Events] = []
        self._samples = 0

    def add(self, events: Events) -> None:
        """Add the events of a block."""
        is_kept = np.isin(events.kind, (Kind.GNSS, Kind.BARO, Kind.MAG))
        # Positions of an autopilot's own are no measurements
        is_kept &= (events.kind != Kind.GNSS) | (events.values[:, GNSS_FLAGS] != GnssFlag.DERIVED)
        if self._samples < MOST_SAMPLES:
            is_kept |= events.kind == Kind.IMU
            self._samples += int(np.count_nonzero(events.kind == Kind.IMU))
        self._blocks.append(events.take(is_kept))

    def found(self) -> tuple[list[str], list[str]]:
        """Return a sentence for each thing that cannot be meant, and for each that is doubtful."""
        if not self._blocks:
            return [], []
        events = merge(*self._blocks)
        imu, fixes, baro, mag = (
            events.take(events.kind == kind) for kind in (Kind.IMU, Kind.GNSS, Kind.BARO, Kind.MAG)
        )
        if fault := inertial_fault(imu):
            return [fault], []
        found = contradictions(imu, fixes, baro if len(baro) else None, mag)
        return found, ([doubt] if (doubt := suspicion(fixes)) and not found else [])
