"""Steep flights, and the errors of Euler angles and of a quaternion in them.

An aerobatic aeroplane, 20 m/s along its forward axis over a flat Earth that does not turn: a climb
at a chosen pitch with the wings rocking, or loops. 50 Hz of inertial means, fixes at 5 Hz, a
magnetic field at 10 Hz, each with the noise that the default settings declare.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.filters.euler import Euler
from ekf_companion.filters.iterated import Iterated
from ekf_companion.filters.sequence import MeasurementSequence, NavigationFilter, run_sequence
from ekf_companion.filters.solution import Solution
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import SIMULATED
from ekf_companion.nav.measurements import Events, Kind, merge

DT = 0.02
SPEED, GRAVITY = 20.0, 9.81
FIX_EVERY, FIELD_EVERY = 10, 5
STRAIGHT, LEVEL = 3.0, 13.0
"""s: of flight straight on, for the start; when the climb begins, wings level."""
DIP, STRENGTH = 1.0, 0.5
"""rad, gauss."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Flight:
    """A motion at 50 Hz, and its events."""

    q_nb: Array
    pos_n: Array
    vel_n: Array
    events: Events


def climb(peak: float, seed: int, seconds: float = 24.0) -> Flight:
    """Pull up to a pitch (rad) in 3 s and stay there, the wings rocking."""
    t = np.arange(0.0, LEVEL + seconds + DT / 2.0, DT)
    roll, yaw = _gently(t)
    return _flight(so3.from_euler(roll, peak * _eased((t - LEVEL) / 3.0), yaw), seed)


def loops(peak: float, seed: int, count: int = 3) -> Flight:
    """Fly loops of 20 m radius in 6.3 s, banked so that the pitch reaches a peak (rad)."""
    t = np.arange(0.0, LEVEL + DT / 2.0, DT)
    bank = (0.5 * np.pi - peak) * _eased((t - LEVEL + 3.0) / 3.0)
    roll, yaw = _gently(t)
    start = so3.from_euler(roll + bank, 0.0, yaw)
    turn = np.zeros((int(np.ceil(2.0 * np.pi / DT)), 3))
    turn[:, 1] = 2.0 * np.pi / len(turn)
    one = np.concatenate([turn, np.zeros((100, 3))])
    rows = [start[-1]]
    for step in np.tile(one, (count, 1)):
        rows.append(so3.normalise(so3.multiply(rows[-1], so3.exp(step))))
    return _flight(np.concatenate([start, np.array(rows[1:])]), seed)


def _gently(t: Array) -> tuple[Array, Array]:
    """Return roll and yaw that rock after a straight stretch; wings level at ``LEVEL``."""
    since = t - STRAIGHT
    share = np.clip(since / 2.0, 0.0, 1.0)
    roll = 0.4 * share * np.sin(2.0 * np.pi * since / 5.0)
    return roll, 0.3 + 0.5 * share * np.sin(2.0 * np.pi * since / 12.0)


def _eased(share: Array) -> Array:
    """Return 0 before 0, 1 after 1, and a smooth transition between."""
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(share * share * (3.0 - 2.0 * share))


def _flight(q_nb: Array, seed: int) -> Flight:
    """Draw the sensors' samples for a series of attitudes."""
    rng = np.random.default_rng(seed)
    n = len(q_nb)
    t_ns = np.arange(n, dtype=np.int64) * round(DT * 1e9)
    vel_n = so3.rotate(q_nb, np.array([SPEED, 0.0, 0.0]))
    pos_n = np.concatenate([np.zeros((1, 3)), np.cumsum((vel_n[1:] + vel_n[:-1]) * DT / 2.0, 0)])
    turn = so3.log(so3.multiply(so3.conjugate(q_nb[:-1]), q_nb[1:]))
    middle = so3.multiply(q_nb[:-1], so3.exp(0.5 * turn))
    force_n = np.diff(vel_n, axis=0) / DT - [0.0, 0.0, GRAVITY]
    defaults = FilterSettings()
    spread = DT**-0.5 * np.repeat([defaults.imu.gyro_noise, defaults.imu.accel_noise], 3)
    bias = rng.normal(0.0, np.repeat([0.01, 0.05], 3))
    inertial = np.concatenate([turn / DT, so3.rotate(so3.conjugate(middle), force_n)], axis=1)
    inertial = np.concatenate([inertial[:1], inertial]) + bias + spread * rng.normal(size=(n, 6))
    std = np.repeat([0.5, 0.8, 0.15], [2, 1, 3])
    fix = np.concatenate([pos_n, vel_n], axis=1)[::FIX_EVERY]
    fix = fix + std * rng.normal(size=fix.shape)
    field_n = STRENGTH * np.array([np.cos(DIP), 0.0, np.sin(DIP)])
    field_b = so3.rotate(so3.conjugate(q_nb[::FIELD_EVERY]), field_n)
    field_b = field_b + defaults.heading.magnetometer_noise * rng.normal(size=field_b.shape)
    place = SIMULATED.to_geodetic(fix[:, :3] - [0.0, 0.0, 160.0])
    # sigmas; then declination, flags, dip and strength of the field
    receiver = (0.5, 0.8, 0.15, 0.0, 0.0, DIP, STRENGTH)
    events = merge(
        Events.from_columns(t_ns[::FIX_EVERY], Kind.GNSS, *place, *fix[:, 3:].T, *receiver),
        Events.from_columns(t_ns[::FIELD_EVERY], Kind.MAG, *field_b.T),
        Events.from_columns(t_ns, Kind.IMU, *inertial.T),
    )
    return Flight(q_nb=q_nb, pos_n=pos_n, vel_n=vel_n, events=events)


def fly(name: str, flight: Flight, limit: float = np.inf) -> Solution:
    """Run ``euler`` with a limit of the pitch (rad), or ``iterated``."""
    course = MeasurementSequence(flight.events, FilterSettings())
    setup = course.setup()
    tried: NavigationFilter = Euler(setup, limit) if name == "euler" else Iterated(setup)
    return run_sequence(name, tried, course, setup)


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Errors from 13 s on."""

    tilt: float
    """RMSE of the attitude, any axis, deg."""
    worst: float
    """Its largest error, deg."""
    position: float
    """RMSE of the horizontal position, m."""
    nees: float
    """Mean of the attitude's normalised error squared; 3 if the covariance is true."""


def score(solution: Solution, flight: Flight) -> Score:
    """Compare a solution with the truth."""
    table = solution.table
    rows = np.rint(table.stamp_ns / (DT * 1e9)).astype(int)
    kept = rows * DT > LEVEL
    q_nb = np.stack([table.column(f"q_{axis}") for axis in "wxyz"], axis=1)
    # A rotation vector in n: true = exp(error) estimate
    error_n = so3.log(so3.multiply(flight.q_nb[rows], so3.conjugate(q_nb)))
    size = np.degrees(np.linalg.norm(error_n[kept], axis=1))
    pos_n = np.stack([table.column(f"pos_{axis}") for axis in "ned"], axis=1)
    drift = pos_n - flight.pos_n[rows]
    drift -= np.median(drift[kept], axis=0)  # its origin is the first fix
    kept_at = np.searchsorted(table.stamp_ns, solution.covariance_ns)
    nees = [
        float(error @ np.linalg.solve(P[:3, :3], error))
        for error, P, row in zip(error_n[kept_at], solution.covariance, rows[kept_at], strict=True)
        if row * DT > LEVEL
    ]
    return Score(
        tilt=float(np.sqrt(np.mean(np.square(size)))),
        worst=float(size.max()),
        position=float(np.sqrt(np.mean(np.square(drift[kept, :2]).sum(axis=1)))),
        nees=float(np.mean(nees)),
    )
