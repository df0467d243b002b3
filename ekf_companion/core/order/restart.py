"""Start with nothing known, start over, and replace an unsound state."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.aids import lag, lever_arm, wind
from cython.cimports.ekf_companion.core.aids.delay import forget_gain
from cython.cimports.ekf_companion.core.aids.rest import begin_window
from cython.cimports.ekf_companion.core.filter import past
from cython.cimports.ekf_companion.core.filter.slow_error import copy_covariance
from cython.cimports.ekf_companion.core.filter.strapdown import forget_pending
from cython.cimports.ekf_companion.core.filter.update import copy_nominal
from cython.cimports.ekf_companion.core.memory.constants import NAN, NEVER
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    AIDS,
    E_VEL,
    MODE_ATTITUDE,
    MODE_LEVEL,
    RESET_BOUNDS,
    RUNS,
    VEHICLE_UNKNOWN,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import clear_estimated, errors
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order.interval import inflate_after_gap
from cython.cimports.ekf_companion.core.trust import doubt, gate, leap, magnetic_field, walk
from cython.cimports.libc.math import fabs

LATEST = cython.declare(cython.double, 2.0)
"""A fix that is later than the velocity is kept for can be none, s."""
RESTORE_AGAIN = cython.declare(cython.double, 1e10)
"""A second unsound state within this time is not restored but starts the filter over, ns."""
FIRST_SHARE = cython.declare(cython.double, 0.3)
"""White share, at first, of the variance that a receiver states for its position."""


def forget_sensors(x: State) -> None:
    """Forget what the sensors have said of each other and of the vehicle.

    That is not the estimate's fault: starting over keeps it.
    """
    x.armed = NAN
    x.landed = NAN
    x.vehicle = VEHICLE_UNKNOWN
    x.raw_fix_t = NEVER
    x.receiver = 0.0
    lag.forget(x)
    x.alone_t = NEVER
    x.compass = 0.0
    x.split_t = NEVER
    x.slide.t = NEVER
    x.slide.apart_t = NEVER
    x.voices.t = NEVER
    x.voices.baro_t = NEVER
    x.voices.apart_t = NEVER


def start(x: State, t: float) -> None:
    """Start with nothing known but the time; counts continue."""
    x.t = t
    x.mode = MODE_LEVEL
    x.q_nb[0] = 1.0
    x.field.declination = NAN
    doubt.restart(x)
    walk.restart(x)
    lever_arm.restart(x)
    magnetic_field.forget_noise(x)
    if x.white_share[AID_POSITION] == 0.0:
        # of a receiver that nothing is known of from before
        x.white_share[AID_POSITION] = FIRST_SHARE
        x.white_share[AID_HEIGHT] = FIRST_SHARE
        x.white_share[AID_VELOCITY] = 1.0
    past.forget(x)
    forget_gain(x)
    x.fix_t = NEVER
    x.mag_t = NEVER
    leap.forget(x)
    x.innovation_t = NEVER
    x.force_t = NEVER
    x.fake_t = t
    x.proven_t = NEVER
    x.gap_t = NEVER
    x.restored_t = NEVER
    for i in range(3):
        x.heading_t[i] = NEVER
    for aid in range(AIDS):
        x.used_t[aid] = NEVER
        x.refused_t[aid] = NEVER
    for aid in range(RUNS):
        gate.clear_run(x, aid)
        x.last_z_t[aid] = NEVER
    x.alignment.start_t = t
    wind.restart(x)
    begin_window(x, t)


def is_sound(x: State) -> bool:
    """Return whether the state is finite and within physical bounds."""
    speed = 0.0
    bias = 0.0
    largest = x.q_nb[0] * x.q_nb[0]
    estimates = errors(x)
    if not fabs(x.gnss_delay) < LATEST:
        return False
    for i in range(3):
        speed += x.vel_n[i] * x.vel_n[i]
        bias += x.gyro_bias[i] * x.gyro_bias[i] * 100.0 + x.accel_bias[i] * x.accel_bias[i]
        largest += x.q_nb[1 + i] * x.q_nb[1 + i]
    for i in range(N - E_VEL):
        largest += fabs(estimates[i])
    for i in range(N):
        if not x.P[i][i] >= 0.0:
            return False
        largest += x.P[i][i]
    # 1 km/s, 1 rad/s or 10 m/s^2 of bias; a sigma of 1000 km
    return speed < 1e6 and bias < 100.0 and largest < 1e12


def recover(x: State, k: Parameters, good: State, t: float) -> None:
    """Replace an unsound state by an earlier sound one, with its covariance grown by its age.

    The accounts and the last sample live on. A second time so soon, or without a good state in
    flight, the filter starts over.
    """
    if t - x.restored_t < RESTORE_AGAIN or good.mode < MODE_ATTITUDE:
        start_over(x, t, RESET_BOUNDS)
        x.restored_t = t
        return
    copy_nominal(x, good)
    x.mode = good.mode
    x.has_yaw = good.has_yaw
    for aid in range(AIDS):
        x.has_aid[aid] = good.has_aid[aid]
    forget_pending(x)
    copy_covariance(x, good)
    for i in range(3):
        x.accel_n[i] = 0.0
    gate.begin_reset(x, RESET_BOUNDS)
    x.t = t
    x.restored_t = t
    inflate_after_gap(x, k, (t - good.t) * 1e-9, 0.0, False)


def start_over(x: State, t: float, reason: float) -> None:
    """Discard an unsound state and level again; keep the origin and the counts."""
    clear_estimated(x)
    x.gnss_delay = x.first_delay
    x.gain.shown = 0.0
    x.alignment.motion.has_fix = 0.0
    x.alignment.reference.is_known = 0.0
    x.resets += 1.0
    x.reset_reason = reason
    start(x, t)
