"""Headers of other programs' CSV files, with the map that each needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ekf_companion.nav.earth import SIMULATED


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Known:
    """A header that needs no map beside the file."""

    name: str
    """The program, for the notes."""
    header: frozenset[str]
    """Columns that together identify it; others may follow."""
    columns: Mapping[str, Any]
    """As in a ``.columns.yaml``."""
    zero_height: float = 0.0
    """Altitude that the map gives to the file's height of zero, m, where its position is
    invented."""


def _axes(quantity: str, column: str, unit: str, signs: tuple[int, int, int]) -> dict[str, Any]:
    """Return the entries of x, y, z; ``{}`` in the column's name stands for the axis."""
    return {
        f"{quantity}_{axis}": {"column": column.format(axis.upper()), "unit": unit, "sign": sign}
        for axis, sign in zip("xyz", signs, strict=True)
    }


UP = (1, -1, -1)
"""Signs that turn axes forward, left, up into forward, right, down."""

SEED = {
    "time": {"column": "time_s", "unit": "s"},
    **{f"gyro_{axis}": {"column": f"gyro_{axis}_rps", "unit": "rad/s"} for axis in "xyz"},
    **{f"accel_{axis}": {"column": f"accel_{axis}_mps2", "unit": "m/s2"} for axis in "xyz"},
    "heading": {"column": "mag2D_yaw_deg", "unit": "deg"},
    "heading_std": {"value": 0.02, "unit": "rad"},
    **{f"gps_{name}": {"column": f"gps_{name}_m", "unit": "m"} for name in ("north", "east")},
    "gps_h": {"column": "gps_h_msl_m", "unit": "m"},
    **{f"gps_v{axis}": {"column": f"gps_v{axis}_mps", "unit": "m/s"} for axis in "ned"},
    "gps_std_h": {"value": 1.0, "unit": "m"},
    "gps_std_v": {"value": 1.0, "unit": "m"},
    "gps_std_vel": {"value": 0.05, "unit": "m/s"},
    "origin": {
        "lat_deg": float(np.degrees(SIMULATED.lat)),
        "lon_deg": float(np.degrees(SIMULATED.lon)),
        "alt_m": SIMULATED.alt,
    },
    "heading_source": "magnetometer",
}
"""The seed article's simulation (tsuibeyond/BasicEKF): metres of a flat Earth, the yaw of a level
magnetometer, and the accuracies that its source declares."""

KNOWN: tuple[Known, ...] = (
    Known(
        name="x-IO (time, gyroscope in deg/s, accelerometer in g; z up)",
        header=frozenset({"Time (s)", "Gyroscope X (deg/s)", "Accelerometer X (g)"}),
        columns={
            "time": {"column": "Time (s)", "unit": "s"},
            **_axes("gyro", "Gyroscope {} (deg/s)", "deg/s", UP),
            **_axes("accel", "Accelerometer {} (g)", "g", UP),
        },
    ),
    Known(
        name="the seed article's simulation (flat Earth put near 75 deg north)",
        header=frozenset({"mag2D_yaw_deg", "gps_valid", "gps_north_m", "gps_h_msl_m"}),
        columns=SEED,
        zero_height=SIMULATED.alt,
    ),
)


def find(names: Sequence[str]) -> Known | None:
    """Return the known header that these column names include, or None."""
    return next((one for one in KNOWN if one.header <= set(names)), None)
