"""Trajectories in a PX4 log: EKF2's estimate, the simulator's truth.

Source: PX4-Autopilot msg/versioned/VehicleLocalPosition.msg, src/lib/geo/geo.cpp.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.ulog_topics import Topic, Topics, rotations, sample_ns
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.state import Trajectory

EARTH_RADIUS = 6371000.0
"""m; of the sphere that PX4 projects on (CONSTANTS_RADIUS_OF_EARTH)."""


def _unproject(x: Array, y: Array, ref_lat: Array, ref_lon: Array) -> tuple[Array, Array]:
    """Return latitude and longitude, rad, of metres north and east of a reference, rad.

    Source: Snyder 1987, "Map projections: a working manual", (20-14), (20-15), azimuthal
    equidistant on a sphere, as PX4's MapProjection::reproject has it.
    """
    c = np.hypot(x, y) / EARTH_RADIUS
    scale = np.sinc(c / np.pi) / EARTH_RADIUS  # numpy's sinc(x) is sin(pi x) / (pi x)
    north, east = x * scale, y * scale
    lat = np.arcsin(np.clip(np.cos(c) * np.sin(ref_lat) + north * np.cos(ref_lat), -1.0, 1.0))
    dlon = np.arctan2(east, np.cos(ref_lat) * np.cos(c) - north * np.sin(ref_lat))
    return lat, so3.wrap(ref_lon + dlon)


def trajectory(topics: Topics, suffix: str, name: str) -> Trajectory | None:
    """Return the trajectory in the topics with a suffix: EKF2's estimate, or the truth."""
    attitude = topics.get(f"vehicle_attitude{suffix}", {})
    local = topics.get(f"vehicle_local_position{suffix}", {})
    if not attitude and not local:
        return None
    parts: dict[str, npt.NDArray[Any]] = {}
    if attitude:
        valid, q_nb = rotations(attitude)
        att_t_ns = sample_ns(attitude)
        valid &= series.ascending(att_t_ns)
        parts |= {"att_t_ns": att_t_ns[valid], "q_nb": q_nb[valid]}
    if "vx" in local:
        vel_n = series.stack(local, "vx", "vy", "vz")
        for valid_field, axes in (("v_xy_valid", slice(0, 2)), ("v_z_valid", slice(2, 3))):
            if valid_field in local:
                vel_n[local[valid_field] == 0, axes] = np.nan
        vel_t_ns = sample_ns(local)
        known = np.isfinite(vel_n).any(axis=1) & series.ascending(vel_t_ns)
        parts |= {"vel_t_ns": vel_t_ns[known], "vel_n": vel_n[known]}
    parts |= _positions(local, topics.get(f"vehicle_global_position{suffix}", {}))
    words = f"vehicle_attitude{suffix}, vehicle_local_position{suffix}"
    return Trajectory(name=f"{name} ({words})", **parts)


def _positions(local: Topic, world: Topic) -> dict[str, npt.NDArray[Any]]:
    """Return the position fields of a trajectory, preferably of the local topic: it is faster."""
    if "ref_lat" in local:
        x, y, z = (np.asarray(local[axis], dtype=float) for axis in "xyz")
        ref_lat, ref_lon = np.deg2rad(local["ref_lat"]), np.deg2rad(local["ref_lon"])
        valid = np.isfinite([x, y, ref_lat, ref_lon]).all(axis=0)
        for field in ("xy_valid", "xy_global"):
            valid &= local[field] != 0 if field in local else True
        t_ns = sample_ns(local)
        valid &= series.ascending(t_ns) & (np.hypot(np.nan_to_num(x), np.nan_to_num(y)) < 1e7)
        if valid.any():
            alt = np.asarray(local["ref_alt"], dtype=float) - z
            if "z_valid" in local:
                alt = np.where(local["z_valid"] != 0, alt, np.nan)
            lat, lon = _unproject(x[valid], y[valid], ref_lat[valid], ref_lon[valid])
            return {"pos_t_ns": t_ns[valid], "lat": lat, "lon": lon, "alt": alt[valid]}
    if "lat" in world:
        t_ns = sample_ns(world)
        lat, lon = np.deg2rad(world["lat"]), np.deg2rad(world["lon"])
        alt = np.asarray(world["alt"], dtype=float)
        valid = np.isfinite(lat) & np.isfinite(lon) & series.ascending(t_ns)
        lat, lon, alt = lat[valid], so3.wrap(lon[valid]), alt[valid]
        return {"pos_t_ns": t_ns[valid], "lat": lat, "lon": lon, "alt": alt}
    return {}
