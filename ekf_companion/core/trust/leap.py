"""Leaps of a magnetic azimuth that the gyro did not see: the compass is wrong, and not our yaw."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.rotation import wrap
from cython.cimports.ekf_companion.core.memory.constants import NEVER
from cython.cimports.ekf_companion.core.memory.enums import E_ATT
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.state import State

LEAPT = cython.declare(cython.double, 0.2617993877991494)
"""Least leap of an azimuth that no gyro saw, rad: 15 degrees, as of a yaw that is corrected."""
LEAPT_SIGMAS = cython.declare(cython.double, 5.0)
"""The same in sigmas of our yaw."""
LEAP_TIME = cython.declare(cython.double, 1e9)
"""Longest time that a leap takes, ns: in more a gyro may have drifted unnoticed."""


def forget(x: State) -> None:
    """Forget the magnetic azimuths that were fused."""
    x.azimuth_t = NEVER
    x.azimuth_t0 = NEVER
    x.has_leapt = 0.0


def keep(x: State, z: float) -> None:
    """Keep the innovation of a magnetic azimuth that was fused, to tell a leap from."""
    if x.at_rest != 0.0 or x.azimuth_t0 <= NEVER:
        x.azimuth_t0 = x.t
    x.azimuth_z = z
    x.azimuth_t = x.t
    x.has_leapt = 0.0


def note_disturbed(x: State) -> None:
    """Note a disturbed field: the azimuth after it follows on the last before."""
    if x.azimuth_t > NEVER:
        x.azimuth_t = x.t


def look(x: State, k: Parameters, z: float) -> None:
    """Look whether a refused magnetic azimuth leapt away from those that were fused in motion.

    The gyro carried yaw on from one to the next. A compass that has stood still with the vehicle
    may have been wrong before the leap.
    """
    way = wrap(z - x.azimuth_z)
    sigma = LEAPT_SIGMAS * LEAPT_SIGMAS * x.P[E_ATT + 2][E_ATT + 2]
    if (
        x.azimuth_t > NEVER
        and x.t - x.azimuth_t < LEAP_TIME
        and x.azimuth_t - x.azimuth_t0 > k.timeout_heading * 1e9
        and x.gap_t < x.azimuth_t
        and way * way > LEAPT * LEAPT + sigma
    ):
        x.has_leapt = 1.0
