"""A truth, or an estimate, over the flat Earth of the seed article's simulation.

Its positions are read as they stand, though by their velocities they are 0.26 percent long north
and 0.20 percent short east: degrees of an ellipsoid were turned into metres of a sphere.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs.table import Table
from ekf_companion.nav import so3
from ekf_companion.nav.earth import SIMULATED

_MOTION = ("time_s", "north_m", "east_m", "h_msl_m", "vn_mps", "ve_mps", "vd_mps")


def _names(unit: str) -> list[str]:
    return [f"{name}_{unit}" for name in ("roll", "pitch", "yaw")]


def read_simulated(table: Table) -> dict[str, npt.NDArray[Any]] | None:
    """Read a truth or an estimate over the flat Earth of a simulation; None: it is not one.

    ``time_s, north_m, east_m, h_msl_m, vn_mps, ve_mps, vd_mps`` and ``roll, pitch, yaw``, all three
    with ``_deg`` or with ``_rad``.

    Returns:
        Columns by our names (``nav.state.COLUMNS``), in its units.

    Raises:
        LogError: A cell is no number.
    """
    units = {"deg": np.pi / 180.0, "rad": 1.0}
    found = [unit for unit in units if {*_MOTION, *_names(unit)} <= set(table.names)]
    if not found:
        return None
    read = table.read([*_MOTION, *_names(found[0])])
    pos_n = np.stack([read["north_m"], read["east_m"], -read["h_msl_m"]], axis=1)
    lat, lon, alt = SIMULATED.to_geodetic(pos_n)
    q_nb = so3.from_euler(*(read[name] * units[found[0]] for name in _names(found[0])))
    return {
        "time_us": np.rint(read["time_s"] * 1e6),
        "lat_deg": np.degrees(lat),
        "lon_deg": np.degrees(lon),
        "alt_m": alt,
        **{f"vel_{axis}": read[f"v{axis}_mps"] for axis in "ned"},
        **dict(zip(("q_w", "q_x", "q_y", "q_z"), q_nb.T, strict=True)),
    }
