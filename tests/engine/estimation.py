"""A pipeline run over a simulated flight, and how far its estimates are off."""

from __future__ import annotations

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events
from ekf_companion.nav.state import Status, Table

KNOWN = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.02))


def run(events: Events, settings: FilterSettings = KNOWN) -> tuple[Table, Pipeline]:
    pipeline = Pipeline(settings)
    return pipeline.run(events), pipeline


def errors(table: Table, truth, start: float) -> dict[str, np.ndarray]:
    """Return estimate minus truth per sample from a time on, and what sigma says of it."""
    begin = np.searchsorted(truth.pos_t_ns, table.stamp_ns[0])
    keep = slice(begin, begin + len(table))
    late = (table.stamp_ns - table.stamp_ns[0]) * 1e-9 >= start

    def columns(*names):
        return np.stack([table.column(name) for name in names], axis=1)[late]

    lat, lon = np.radians(columns("lat_deg", "lon_deg")).T
    frame_scale = 6.367e6
    pos = np.stack(
        [
            (lat - truth.lat[keep][late]) * frame_scale,
            (lon - truth.lon[keep][late]) * frame_scale * np.cos(lat),
            truth.alt[keep][late] - table.column("alt_m")[late],
        ],
        axis=1,
    )
    angles = so3.to_euler(columns("q_w", "q_x", "q_y", "q_z")) - so3.to_euler(
        truth.q_nb[keep][late]
    )
    return {
        "pos": pos,
        "vel": columns("vel_n", "vel_e", "vel_d") - truth.vel_n[keep][late],
        "euler": so3.wrap(angles),
        "sd_pos": columns("sd_pos_n", "sd_pos_e", "sd_pos_d"),
        "sd_vel": columns("sd_vel_n", "sd_vel_e", "sd_vel_d"),
        "sd_euler": columns("sd_roll", "sd_pitch", "sd_yaw"),
    }


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def statuses(table: Table) -> list[Status]:
    changes = np.flatnonzero(np.diff(table.column("status"), prepend=-1.0))
    return [Status(int(table.column("status")[i])) for i in changes]


def deviations(table, truth):
    """Return velocity and Euler angles less the truth, and their sigmas, at every sample."""
    found = np.searchsorted(truth.pos_t_ns, table.stamp_ns)

    def columns(*names):
        return np.stack([table.column(name) for name in names], axis=1)

    q_nb = columns("q_w", "q_x", "q_y", "q_z")
    angles = so3.wrap(so3.to_euler(q_nb) - so3.to_euler(truth.q_nb[found]))
    velocity = columns("vel_n", "vel_e", "vel_d") - truth.vel_n[found]
    sigmas = columns("sd_vel_n", "sd_vel_e", "sd_vel_d", "sd_roll", "sd_pitch", "sd_yaw")
    return np.hstack([velocity, angles]), sigmas
