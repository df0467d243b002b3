"""What a PX4 log tells of the motion: EKF2's estimate, the simulator's truth.

Source: PX4-Autopilot msg/versioned/VehicleLocalPosition.msg, src/lib/geo/geo.cpp.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.logs import series
from ekf_companion.logs.ulog_topics import Topic, Topics, rotations, sample_ns
from ekf_companion.nav import so3
from ekf_companion.nav.state import Trajectory

Array = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]

EARTH_RADIUS = 6371000.0
"""m; of the sphere that PX4 projects on (CONSTANTS_RADIUS_OF_EARTH)."""


def _unproject(x: Array, y: Array, ref_lat: Array, ref_lon: Array) -> tuple[Array, Array]:
    """Give latitude and longitude, rad, of metres north and east about a reference, rad.

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
    """Give what the topics with a suffix tell: EKF2's estimate, or the simulator's truth."""
    attitude = topics.get(f"vehicle_attitude{suffix}", {})
    local = topics.get(f"vehicle_local_position{suffix}", {})
    if not attitude and not local:
        return None
    att_t_ns, q_nb = np.zeros(0, dtype=np.int64), np.zeros((0, 4))
    if attitude:
        valid, q_nb = rotations(attitude)
        att_t_ns = sample_ns(attitude)
        valid &= series.ascending(att_t_ns)
        att_t_ns, q_nb = att_t_ns[valid], q_nb[valid]
    vel_t_ns, vel_n = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    if "vx" in local:
        vel_n = np.stack([local[axis] for axis in ("vx", "vy", "vz")], axis=1).astype(float)
        for valid_field, axes in (("v_xy_valid", slice(0, 2)), ("v_z_valid", slice(2, 3))):
            if valid_field in local:
                vel_n[local[valid_field] == 0, axes] = np.nan
        vel_t_ns = sample_ns(local)
        known = np.isfinite(vel_n).any(axis=1) & series.ascending(vel_t_ns)
        vel_t_ns, vel_n = vel_t_ns[known], vel_n[known]
    pos_t_ns, lat, lon, alt = _positions(local, topics.get(f"vehicle_global_position{suffix}", {}))
    words = f"vehicle_attitude{suffix}, vehicle_local_position{suffix}"
    return Trajectory(
        name=f"{name} ({words})",
        pos_t_ns=pos_t_ns,
        lat=lat,
        lon=lon,
        alt=alt,
        vel_t_ns=vel_t_ns,
        vel_n=vel_n,
        att_t_ns=att_t_ns,
        q_nb=q_nb,
    )


def _positions(local: Topic, world: Topic) -> tuple[Stamps, Array, Array, Array]:
    """Give stamps, latitude, longitude (rad), altitude; the local topic first: it comes oftener."""
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
            return t_ns[valid], lat, lon, alt[valid]
    if "lat" in world:
        t_ns = sample_ns(world)
        lat, lon = np.deg2rad(world["lat"]), np.deg2rad(world["lon"])
        valid = np.isfinite(lat) & np.isfinite(lon) & series.ascending(t_ns)
        alt = np.asarray(world["alt"], dtype=float)
        return t_ns[valid], lat[valid], so3.wrap(lon[valid]), alt[valid]
    return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), np.zeros(0)
