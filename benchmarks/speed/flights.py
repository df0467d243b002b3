"""The flight that the filters are timed on: 250 Hz inertial, 10 Hz GNSS, 50 Hz heading."""

from __future__ import annotations

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings, GnssSettings, ImuSettings
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import (
    Events,
    GnssFix,
    HeadingSample,
    HeadingSource,
    ImuSample,
    Kind,
    Measurement,
    merge,
)
from sim_autopilot import events as wireless
from sim_autopilot.config import GnssConfig, ImuConfig, SimConfig
from sim_autopilot.flight import Flight

HEADING_RATE = 50.0
HEADING_STD = float(np.radians(2.0))
SETTINGS = FilterSettings(imu=ImuSettings(lag=0.0), gnss=GnssSettings(delay=0.0, delay_std=0.0))
"""Stamps are times of validity, and the filter knows that."""


def plan(duration: float, seed: int = 1) -> Flight:
    """Draw a figure-eight without delays."""
    config = SimConfig(imu=ImuConfig(rate=250.0), gnss=GnssConfig(rate=10.0, delay=0.0))
    return Flight.plan("figure-eight", config, seed=seed, duration=duration)


def events(flight: Flight) -> Events:
    """Return its events in order of validity: fixes, headings, inertial samples."""
    all_events = wireless.events(flight, has_vel_down=True)
    fixes, samples = (all_events.take(all_events.kind == kind) for kind in (Kind.GNSS, Kind.IMU))
    step = round(flight.config.imu.rate / HEADING_RATE)
    t_ns = samples.t_ns[step - 1 :: step]
    noise = np.random.default_rng(flight.seed).standard_normal(len(t_ns)) * HEADING_STD
    yaw = flight.truth_at(t_ns).euler[:, 2] + noise
    headings = Events.from_columns(
        t_ns,
        Kind.HEADING,
        so3.wrap(yaw),
        np.full(len(t_ns), HEADING_STD),
        np.full(len(t_ns), float(HeadingSource.GNSS)),
    )
    return merge(fixes, headings, samples)


def measurements(table: Events) -> list[Measurement]:
    """Return the same events as the objects that a link delivers."""
    rows = zip(table.t_ns.tolist(), table.kind.tolist(), table.values.tolist(), strict=True)
    return [_FROM_ROW[Kind(kind)](t_ns, values) for t_ns, kind, values in rows]


def _fix(t_ns: int, values: list[float]) -> Measurement:
    lat, lon, alt, north, east, down, std_h, std_v, std_vel = values[:9]
    return GnssFix(
        t_ns=t_ns,
        lat=lat,
        lon=lon,
        alt=alt,
        vel_north=north,
        vel_east=east,
        vel_down=down,
        std_h=std_h,
        std_v=std_v,
        std_vel=std_vel,
    )


def _heading(t_ns: int, values: list[float]) -> Measurement:
    heading, std, source = values[:3]
    return HeadingSample(t_ns=t_ns, heading=heading, std=std, source=HeadingSource(int(source)))


def _sample(t_ns: int, values: list[float]) -> Measurement:
    p, q, r, x, y, z = values[:6]
    return ImuSample(t_ns=t_ns, gyro_x=p, gyro_y=q, gyro_z=r, accel_x=x, accel_y=y, accel_z=z)


_FROM_ROW = {Kind.GNSS: _fix, Kind.HEADING: _heading, Kind.IMU: _sample}
