"""Process noise: the scale of Q, learnt, before P is carried on by a motion."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_BARO,
    AIDS,
    AZIMUTH_FIELD,
    E_HEADING,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import doubt, walk

PROVEN_SHARE = cython.declare(cython.double, 0.25)
"""Least share of the variance of a compass's slow error that counts: one look at it by GNSS, which
found none, makes no more of the little that is known before."""


SLOW_INTERVAL = cython.declare(cython.double, 0.0199)
"""Interval at which the slow errors of heading and GNSS are carried on, s: 20 ms, give or take."""


def heading_level(x: State, k: Parameters) -> float:
    """Return the variance that the heading's slow error has in the long run, rad^2.

    A compass whose error GNSS has shown to be small counts as better than expected: the level is
    then what is left of the error, estimate and variance, but no less than a share of what is set.
    While nothing shows the error, its variance is the level already, and nothing changes.
    """
    level = x.heading_std * x.heading_std
    if k.weighs_faults == WEIGH_ACT and x.heading_offset * x.heading_offset > THREE_SIGMA2 * level:
        return x.heading_offset * x.heading_offset
    if x.azimuth != AZIMUTH_FIELD or k.learn_noise == 0.0:
        return level
    seen = x.heading_offset * x.heading_offset + x.P[E_HEADING][E_HEADING]
    least = PROVEN_SHARE * level
    if seen > level:
        return level
    return seen if seen > least else least


def scale_noise(x: State, k: Parameters, m: Motion) -> None:
    """Write the variances that the pending motion adds to P, as they are learnt, into ``m``."""
    dt = x.pending.dt
    doubt.write_noise(x, k, m, dt)
    share = 1.0
    gyro_share = 1.0
    new = 0.0
    if k.learn_noise != 0.0:
        new = doubt.new_bias_share(x)
        share = doubt.walk_share(x)
        gyro_share = doubt.gyro_walk_share(x, share)
        walk.learn_walk(x, dt)
    m.gyro_walk = gyro_share * k.gyro_bias_walk * k.gyro_bias_walk * dt
    m.accel_walk = share * k.accel_bias_walk * k.accel_bias_walk * dt
    m.new_bias = new * k.accel_bias_std * k.accel_bias_std
    walk.note_gyro_walk(x, m.gyro_walk)
    speed2 = x.vel_n[0] * x.vel_n[0] + x.vel_n[1] * x.vel_n[1] + x.vel_n[2] * x.vel_n[2]
    for aid in range(AIDS):
        first = cython.cast(cython.Py_ssize_t, k.aid[aid].error)
        for i in range(cython.cast(cython.Py_ssize_t, k.aid[aid].errors)):
            steady = k.aid[aid].walk[i] * k.aid[aid].walk[i] * dt
            by_speed = k.aid[aid].speed_walk[i] * k.aid[aid].speed_walk[i] * speed2 * dt
            if aid == AID_BARO:
                by_speed *= x.walk.speed_share if k.learn_noise != 0.0 else 1.0
                walk.note_baro_walk(x, steady, by_speed, speed2)
            by_climb = k.aid[aid].climb_walk[i] * x.vel_n[2]
            m.slow_walk[first + i] = steady + by_speed + by_climb * by_climb * dt

    # What changes within a minute need not be carried on every few milliseconds
    x.slow_dt += dt
    m.slow_dt = 0.0
    m.heading_faded = 0.0
    if x.slow_dt >= SLOW_INTERVAL:
        m.slow_dt = x.slow_dt
        x.slow_dt = 0.0
        share = x.walk.heading_share if k.learn_noise != 0.0 else 1.0
        m.heading_faded = share * m.slow_dt / (share * m.slow_dt + k.heading_time)
        m.heading_level = heading_level(x, k)
        walk.note_fading(x, m.heading_faded, m.heading_level)
