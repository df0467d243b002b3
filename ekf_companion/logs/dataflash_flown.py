"""Which of its estimates an ArduPilot flew on, by the parameters in its log.

Source: ArduPilot libraries/AP_AHRS, AP_AHRS_NavEKF.cpp (``get_secondary_position`` for AHR2).
"""

from __future__ import annotations

import numpy as np

from ekf_companion.logs.dataflash_columns import names_of
from ekf_companion.logs.dataflash_tables import Columns

_EKFS = {3: ("XKF1", "EKF3"), 2: ("NKF1", "EKF2"), 1: ("EKF1", "EKF1")}
"""Message and name of each generation of the filter, by AHRS_EKF_TYPE; the newest first."""


def parameter(tables: Columns, name: bytes) -> float | None:
    """Return the first value that a log has of a parameter: what was flown with."""
    if "PARM" not in tables or "Name" not in names_of(tables["PARM"]):
        return None
    found = tables["PARM"]["Value"][tables["PARM"]["Name"] == name]
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None


def filters(tables: Columns) -> list[tuple[str, str]]:
    """Return message and name of each generation: the one in use first, then the newest."""
    used = parameter(tables, b"AHRS_EKF_TYPE")
    return [_EKFS[one] for one in sorted(_EKFS, key=lambda one: (one != used, -one))]


def setting_of_dcm(tables: Columns) -> str:
    """Return the parameter by which it flew on DCM; empty: it did not.

    A filter that runs then only looks on: ATT is DCM's attitude, and AHR2, the other estimate, is
    the filter's, with its position as latitude, longitude and height.
    """
    for name in (b"AHRS_EKF_USE", b"AHRS_EKF_TYPE"):
        if parameter(tables, name) == 0.0:
            return f"{name.decode()} is 0"
    return ""
