"""Which of its estimates an ArduPilot flew on, by the parameters in its log.

Source: ArduPilot libraries/AP_AHRS, AP_AHRS_NavEKF.cpp (``get_secondary_position`` for AHR2).
"""

from __future__ import annotations

from ekf_companion.logs.dataflash_columns import parameter
from ekf_companion.logs.dataflash_tables import Columns

_EKFS = {3: ("XKF1", "EKF3"), 2: ("NKF1", "EKF2"), 1: ("EKF1", "EKF1")}
"""Message and name of each generation of the filter, by AHRS_EKF_TYPE; the newest first."""


def filters(tables: Columns) -> list[tuple[str, str]]:
    """Return message and name of each generation: the one in use first, then the newest."""
    used = parameter(tables, "AHRS_EKF_TYPE")
    return [_EKFS[one] for one in sorted(_EKFS, key=lambda one: (one != used, -one))]


def setting_of_dcm(tables: Columns) -> str:
    """Return the parameter by which it flew on DCM; empty: it did not.

    A filter that runs then is not flown on: ATT is DCM's attitude, and AHR2, the other estimate, is
    the filter's, with its position as latitude, longitude and height.
    """
    for name in ("AHRS_EKF_USE", "AHRS_EKF_TYPE"):
        if parameter(tables, name) == 0.0:
            return f"{name} is 0"
    return ""
