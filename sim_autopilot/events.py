"""A flight as the estimator's events, without the wire: for many flights in little time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.state import Trajectory
from sim_autopilot.flight import Flight

Array = npt.NDArray[np.float64]


def events(flight: Flight, *, has_vel_down: bool = False) -> Events:
    """Return all samples, in order of arrival.

    Args:
        flight: Its stamps are kept: those of fixes are late by the receiver's delay.
        has_vel_down: The fixes carry vertical velocity, as logs do and GPS_RAW_INT does not.
    """
    imu, gnss, config = flight.imu, flight.gnss, flight.config.gnss
    count = len(gnss.t)
    std_h = np.full(count, np.hypot(config.noise_h, config.slow_h))
    std_v = np.full(count, np.hypot(config.noise_v, config.slow_v))
    vel_down = gnss.vel_n[:, 2] if has_vel_down else np.full(count, np.nan)
    tables = [
        Events.from_columns(
            _stamps(flight, gnss.t),
            Kind.GNSS,
            gnss.lat,
            gnss.lon,
            gnss.alt,
            gnss.vel_n[:, 0],
            gnss.vel_n[:, 1],
            vel_down,
            std_h,
            std_v,
            np.full(count, config.noise_vel),
            np.full(count, np.nan),
        ),
        Events.from_columns(_stamps(flight, flight.mag.t), Kind.MAG, *flight.mag.mag_b.T),
        Events.from_columns(_stamps(flight, flight.baro.t), Kind.BARO, flight.baro.alt),
        Events.from_columns(_stamps(flight, imu.t), Kind.IMU, *imu.gyro_b.T, *imu.accel_b.T),
    ]
    if config.yaw:
        tables.insert(
            1,
            Events.from_columns(
                _stamps(flight, gnss.t), Kind.HEADING, gnss.yaw, np.full(count, config.noise_yaw)
            ),
        )
    return merge(*tables)


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
