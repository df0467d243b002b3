"""What an ODOMETRY says of itself, as its listener takes it: frame and kind of estimator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.encode import EstimatorType, Frame, estimator_type


@dataclass(frozen=True, slots=True)
class Label:
    """How every ODOMETRY on a link is labelled."""

    frame: Frame
    estimator: EstimatorType
    warnings: tuple[str, ...]
    """What of the configuration was not, or in vain, done; each a sentence without full stop."""


MONITOR = Label(Frame.LOCAL_NED, EstimatorType.GPS_INS, ())
"""Towards a listener that is no autopilot: as it is."""


def label(
    family: Family,
    frame: Literal["LOCAL_FRD", "LOCAL_NED"],
    chosen: Literal["auto", "GPS_INS", "VIO"],
) -> Label:
    """Give the label that was configured, but never a type that the autopilot refuses.

    PX4 answers GPS_INS with a critical text, message by message; ArduPilot drops every frame of
    the pose but LOCAL_FRD without a word. An autopilot of unknown family is an autopilot still.
    """
    warnings = []
    estimator = estimator_type(family) if chosen == "auto" else EstimatorType[chosen]
    if family is Family.PX4 and estimator is EstimatorType.GPS_INS:
        estimator = EstimatorType.VIO
        warnings.append(
            "output.odometry.estimator_type: PX4 refuses GPS_INS with a critical text for each "
            "message; VIO is sent instead: set auto or VIO"
        )
    if family is Family.ARDUPILOT and frame != "LOCAL_FRD":
        warnings.append(
            f"output.odometry.frame: ArduPilot ignores {frame} without a word; set LOCAL_FRD for "
            "it to take our estimate"
        )
    return Label(Frame[frame], estimator, tuple(warnings))
