"""A flight as the estimator's events, without the wire: for many flights in little time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Trajectory
from sim_autopilot.flight import Flight


def events(flight: Flight, *, has_vel_down: bool = False) -> Events:
    """Return all samples in order of arrival; the stamps of fixes are late by the receiver's delay.

    With ``has_vel_down`` the fixes carry vertical velocity, as logs do and GPS_RAW_INT does not.
    """
    imu, gnss, config = flight.imu, flight.gnss, flight.config.gnss

    def table(kind: Kind, t: Array, *columns: npt.ArrayLike) -> Events:
        return Events.from_columns(_stamps(flight, t), kind, *columns)

    vel_down = gnss.vel_n[:, 2] if has_vel_down else np.nan
    std_h, std_v = np.hypot([config.noise_h, config.noise_v], [config.slow_h, config.slow_v])
    place, velocity = (gnss.lat, gnss.lon, gnss.alt), (*gnss.vel_n[:, :2].T, vel_down)
    stds = (std_h, std_v, config.noise_vel)
    found = [_readings(flight, Kind.AIRSPEED), _readings(flight, Kind.WHEEL)]
    headings = [table(Kind.HEADING, gnss.t, gnss.yaw, config.noise_yaw)] if config.yaw else []
    flows = []
    if (flow := flight.flow) is not None:
        seen, late = flow.quality > 0.0, 0.5 / flight.config.flow.rate
        columns = (*flow.flow[seen].T, *flow.gyro[seen].T, flow.quality[seen], np.nan)
        flows = [table(Kind.FLOW, flow.t[seen] - late, *columns)]
    return merge(
        table(Kind.GNSS, gnss.t, *place, *velocity, *stds, np.nan),
        *headings,
        *(one for one in found if one is not None),
        *flows,
        table(Kind.MAG, flight.mag.t, *flight.mag.mag_b.T),
        table(Kind.BARO, flight.baro.t, flight.baro.alt),
        table(Kind.IMU, imu.t, *imu.gyro_b.T, *imu.accel_b.T),
    )


def _readings(flight: Flight, kind: Kind) -> Events | None:
    """Return ten readings a second of airspeed or wheels; None: there is no such sensor."""
    every = max(1, round(1e8 / flight.period_ns))
    t = flight.imu.t[::every]
    columns: tuple[npt.ArrayLike, ...] = ()
    if kind == Kind.AIRSPEED and len(flight.airspeed):
        columns = (flight.airspeed[::every], np.nan, 1.0)
    elif kind == Kind.WHEEL and len(flight.wheel):
        speed = np.diff(flight.wheel[::every]) / np.diff(t)
        t, columns = 0.5 * (t[1:] + t[:-1]), (speed, np.nan)
    if not columns:
        return None
    return Events.from_columns(_stamps(flight, t), kind, *columns)


def truth(flight: Flight) -> Trajectory:
    """Return the motion at every inertial sample."""
    motion = flight.trajectory.at(flight.imu.t)
    t_ns = _stamps(flight, flight.imu.t)
    return Trajectory(
        name=f"truth of {flight.scenario.name}, seed {flight.seed}",
        pos_t_ns=t_ns,
        lat=motion.lat,
        lon=motion.lon,
        alt=motion.alt,
        vel_t_ns=t_ns,
        vel_n=motion.vel_n,
        att_t_ns=t_ns,
        q_nb=motion.q_nb,
    )


def _stamps(flight: Flight, t: Array) -> npt.NDArray[np.int64]:
    return np.asarray(flight.zero_ns + np.rint(t * 1e6).astype(np.int64) * 1000)
