"""The step: one inertial sample, and the events that were true since the one before.

Everything that decides lives in the state: which aid is used, gated or timed out, what is reset and
why. So a state and the events after it always give the same bits, live, replayed or in another
order of arrival.

In all of the kernel x is the state, k the parameters, m the motion over an interval, o an
observation, w what a step works with.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import baro, gnss, heading, lever_arm, wind
from cython.cimports.ekf_companion.core.aids.delay import forget_gain, learn_delay, take_told
from cython.cimports.ekf_companion.core.aids.rest import (
    add_field,
    begin_window,
    check_rest,
    forget_field,
)
from cython.cimports.ekf_companion.core.filter import past, propagate, tape
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.update import copy_nominal
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_HEIGHT,
    AID_POSITION,
    AID_VELOCITY,
    AIDS,
    AZIMUTH_ANTENNA,
    AZIMUTH_MAGNETIC,
    AZIMUTH_OTHER,
    E_ATT,
    E_POS,
    E_VEL,
    KIND_BARO,
    KIND_GNSS,
    KIND_HEADING,
    KIND_MAG,
    KIND_VEHICLE,
    MODE_ATTITUDE,
    MODE_INIT,
    MODE_LEVEL,
    MODE_NAVIGATE,
    NEEDS_FIX,
    RESET_BOUNDS,
    RESET_VELOCITY,
    RUNS,
    VERDICT_SUPERSEDED,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Structs
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Event, ImuRow, Motion, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.start import align, yaw_bank, yaw_frame
from cython.cimports.ekf_companion.core.trust import doubt, gate, leap, walk
from cython.cimports.ekf_companion.core.trust.noise import learn_noise
from cython.cimports.libc.math import fabs, sqrt, tanh

NAN = cython.declare(cython.double, float("nan"))
NEVER = cython.declare(cython.double, -1e18)
MOTION_TIME = cython.declare(cython.double, 0.4)
"""Time over which a vehicle's rate and force are correlated, s: what two samples say of the motion
between them fades with it (measured on recorded flights: ``benchmarks/gaps.py``)."""
RATE_STD = cython.declare(cython.double, 0.5)
"""One sigma of the rate of a vehicle that is flown hard, rad/s, if both ends show no more."""
FORCE_STD = cython.declare(cython.double, 6.7)
"""The same of its specific force beside that of a vehicle at rest, m/s^2."""
COVARIANCE_INTERVAL = cython.declare(cython.double, 0.0095)
"""Interval at which P is carried on, s: 10 ms, give or take the samples' jitter."""
LARGEST_TURN = cython.declare(cython.double, 4.0)
"""Largest square of the turn, rad^2, that is integrated from one sample."""
RESTORE_AGAIN = cython.declare(cython.double, 1e10)
"""A second unsound state within this time is not restored but starts the filter over, ns."""
SLOW_GAP = cython.declare(cython.double, 3.0)
"""Usual intervals without a sample after which there is a gap, however slow the stream."""
FIRST_SHARE = cython.declare(cython.double, 0.3)
"""White share, at first, of the variance that a receiver states for its position."""


def step(x: State, k: Parameters, w: Scratch, rows: Structs, first: int, last: int) -> None:
    """Process the sample rows[last]; rows[first:last] are the events valid since the sample before.

    With a tape (``w.tape``) what happens is recorded there.
    """
    imu = address(rows[last].values.imu)
    t = rows[last].t
    span = (t - x.t) * 1e-9

    # The first sample only says what time it is
    if x.mode == MODE_INIT:
        forget_sensors(x)
        start(x, t)
        yaw_bank.restart(address(x.yaw_bank), k)
        keep_sample(x, imu)
        return
    if span <= 0.0:
        return

    # Go to each event in turn, then to the sample's own time
    find_interval_motion(x, k, address(w.motion), imu, span)
    is_gap = cython.declare(cython.bint, span > k.gap and span > SLOW_GAP * x.dt)
    if is_gap:
        x.gap_t = t
    begin = x.t
    for r in range(first, last + 1):
        advance(x, k, w, rows[r].t, begin, span)
        if r < last:
            carry_on(x, k, w)
            apply_event(x, k, w, address(rows[r]))
            if w.tape.is_on:
                tape.record_event(x, w)
    if span > k.gap:
        carry_on(x, k, w)
        inflate_after_gap(x, k, span, shown_rate(x, imu), is_gap)
        yaw_frame.restart(address(x.yaw_bank))
        if w.tape.is_on:
            tape.record_gap(x, w)

    # Learn from the sample itself: noise, rest, which aids are silent
    learn_noise(x, imu, span)
    doubt.find_clipping(x, imu)
    keep_sample(x, imu)
    check_rest(x, k, w)
    learn_delay(x, k, w)
    wind.add_force(x, k, w)


def carry_on(x: State, k: Parameters, w: Scratch) -> None:
    """Carry P on to the state's time."""
    dt = x.pending.dt
    if dt > 0.0:
        propagate.propagate_covariance(x, k, address(w.motion))
        if w.tape.is_on:
            tape.record_motion(x, k, w, dt)


def advance(x: State, k: Parameters, w: Scratch, t: float, begin: float, span: float) -> None:
    """Advance the state to a time within the interval of length span (s) that began at begin.

    P follows where that is worth it; a tape wants it at each sample, and so does a clipped one.
    """
    m = address(w.motion)
    dt = (t - x.t) * 1e-9
    if dt > 0.0:
        # the mean over this part of the interval, from that over the whole
        part = ((t - begin) + (x.t - begin)) * 0.5e-9 - 0.5 * span
        for i in range(3):
            m.rate[i] = m.mean[i] + part * m.rate_slope[i]
            m.force[i] = m.mean[3 + i] + part * m.force_slope[i]
        if x.mode == MODE_LEVEL:
            align.integrate(x, m, dt)
        else:
            propagate.integrate_strapdown(x, k, m, dt)
            if x.pending.dt >= COVARIANCE_INTERVAL or w.tape.is_on or doubt.is_clipping(x):
                carry_on(x, k, w)
            if x.needs_reset != 0.0:
                align.integrate(x, m, dt)
        yaw_frame.integrate(address(x.yaw_bank), m, dt)
        x.t = t
        past.keep_velocity(x)


def find_interval_motion(x: State, k: Parameters, m: Motion, imu: ImuRow, span: float) -> None:
    """Write the mean rate and force of the interval before a sample, and their slopes.

    A sample stands for the interval before it, if it is a mean and none is missing; else it is a
    reading at its end. Either way two in a row say how fast rate and force change.
    """
    turn = 0.0
    is_regular = cython.declare(cython.bint, span <= 1.5 * x.dt)
    for i in range(3):
        turn += imu.gyro[i] * imu.gyro[i]
    if turn * span * span > LARGEST_TURN:
        find_lost_motion(x, k, m, imu, 0.0)
        is_regular = False
    elif span > k.gap:
        find_lost_motion(x, k, m, imu, MOTION_TIME / span * tanh(0.5 * span / MOTION_TIME))
        is_regular = False
    else:
        for i in range(3):
            m.mean[i] = imu.gyro[i]
            m.mean[3 + i] = imu.accel[i]
            if k.mean_samples == 0.0 or not is_regular:
                m.mean[i] = 0.5 * (m.mean[i] + x.gyro[i])
                m.mean[3 + i] = 0.5 * (m.mean[3 + i] + x.accel[i])
    for i in range(3):
        m.rate_slope[i] = 0.0
        m.force_slope[i] = 0.0
        if is_regular and x.samples > 1.0:
            m.rate_slope[i] = (imu.gyro[i] - x.gyro[i]) / span
            m.force_slope[i] = (imu.accel[i] - x.accel[i]) / span


def find_lost_motion(x: State, k: Parameters, m: Motion, imu: ImuRow, share: float) -> None:
    """Write the mean rate and force expected over a time from the samples at both its ends.

    Args:
        x: The state at the begin, with the sample there.
        k: The parameters.
        m: Receives the mean.
        imu: The sample at the end.
        share: What each end counts beside no turn and no acceleration; 0.5: the mean of both.
    """
    to_dcm(x.q_nb, m.C_nb)
    for i in range(3):
        rate = x.gyro_bias[i]
        force = x.accel_bias[i] - k.gravity * m.C_nb[2][i]
        m.mean[i] = rate + share * (x.gyro[i] + imu.gyro[i] - 2.0 * rate)
        m.mean[3 + i] = force + share * (x.accel[i] + imu.accel[i] - 2.0 * force)


def keep_sample(x: State, imu: ImuRow) -> None:
    """Keep the sample for the next step."""
    x.samples += 1.0
    for i in range(3):
        x.gyro[i] = imu.gyro[i]
        x.accel[i] = imu.accel[i]


def forget_sensors(x: State) -> None:
    """Forget what the sensors have said of each other and of the vehicle.

    That is not the estimate's fault: starting over keeps it.
    """
    x.armed = NAN
    x.landed = NAN
    x.raw_fix_t = NEVER
    x.receiver = 0.0
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
    heading.forget_field_noise(x)
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
    largest = x.q_nb[0] * x.q_nb[0] + fabs(x.baro_offset) + fabs(x.heading_offset)
    if not fabs(x.gnss_delay) < 1.0:
        return False
    for i in range(3):
        speed += x.vel_n[i] * x.vel_n[i]
        bias += x.gyro_bias[i] * x.gyro_bias[i] * 100.0 + x.accel_bias[i] * x.accel_bias[i]
        largest += x.q_nb[1 + i] * x.q_nb[1 + i] + fabs(x.pos_n[i])
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
    propagate.forget_pending(x)
    for i in range(N):
        for j in range(N):
            x.P[i][j] = good.P[i][j]
    for i in range(3):
        x.accel_n[i] = 0.0
    gate.begin_reset(x, RESET_BOUNDS)
    x.t = t
    x.restored_t = t
    inflate_after_gap(x, k, (t - good.t) * 1e-9, 0.0, False)


def start_over(x: State, t: float, reason: float) -> None:
    """Discard an unsound state and level again; keep the origin and the counts."""
    propagate.forget_pending(x)
    for i in range(4):
        x.q_nb[i] = 0.0
    for i in range(3):
        x.vel_n[i] = 0.0
        x.pos_n[i] = 0.0
        x.gyro_bias[i] = 0.0
        x.accel_bias[i] = 0.0
        x.gnss_offset[i] = 0.0
        x.gnss_vel_offset[i] = 0.0
        x.hard_iron[i] = 0.0
        x.gyro[i] = 0.0
        x.accel[i] = 0.0
        x.accel_n[i] = 0.0
        x.white_share[i] = 0.0
    for i in range(6):
        x.noise[i] = 0.0
    for i in range(N):
        for j in range(N):
            x.P[i][j] = 0.0
    x.baro_offset = 0.0
    x.gnss_delay = x.first_delay
    x.gain.shown = 0.0
    x.heading_offset = 0.0
    x.dt = 0.0
    x.has_yaw = 0.0
    x.has_baro = 0.0
    x.needs_reset = 0.0
    x.alignment.motion.has_fix = 0.0
    x.alignment.reference.is_known = 0.0
    x.resets += 1.0
    x.reset_reason = reason
    start(x, t)


def shown_rate(x: State, imu: ImuRow) -> float:
    """Return the RMS of the rates at both ends of a gap, per axis, rad/s."""
    power = 0.0
    for i in range(3):
        power += x.gyro[i] * x.gyro[i] + imu.gyro[i] * imu.gyro[i]
    return sqrt(power / 6.0)


def inflate_after_gap(x: State, k: Parameters, span: float, rate: float, is_gap: bool) -> None:
    """Inflate P by what may have happened while no sample came; reset velocity after a long gap.

    Rate and force are those of a first-order Gauss-Markov process, of which the samples at both
    ends are known: over a time T the integral has a variance of 2 s^2 c^2 (T/c - 2 tanh(T / 2 c)),
    where s is their sigma and c their correlation time. Tilt is bounded, heading and speed hardly
    are. A stream that is always as slow has no gap, only doubt.

    Args:
        x: The state at the end.
        k: The parameters.
        span: Length of the gap, s.
        rate: RMS of the rates at both ends, per axis, rad/s.
        is_gap: Samples are missing.
    """
    ratio = span / MOTION_TIME
    spread = MOTION_TIME * sqrt(2.0 * (ratio - 2.0 * tanh(0.5 * ratio)))
    turned = (rate if rate > RATE_STD else RATE_STD) * spread
    gained = FORCE_STD * spread
    yawed = turned
    if is_gap:
        x.gaps += 1.0
        x.force_sum[0] = NAN
        forget_gain(x)
        begin_window(x, x.t)
    if x.mode == MODE_LEVEL:
        if is_gap:
            x.alignment.motion.has_fix = 0.0
        return
    if yawed > 1.8:
        yawed = 1.8
    if turned > 0.5:
        turned = 0.5
    if gained > 20.0:
        gained = 20.0
    for i in range(2):
        x.P[E_ATT + i][E_ATT + i] += turned * turned
    x.P[E_ATT + 2][E_ATT + 2] += yawed * yawed
    for i in range(3):
        x.P[E_VEL + i][E_VEL + i] += gained * gained
        x.P[E_POS + i][E_POS + i] += 0.25 * gained * gained * span * span
    if is_gap and span > k.gap_reset and x.mode == MODE_NAVIGATE:
        x.needs_reset = NEEDS_FIX
        x.alignment.motion.has_fix = 0.0
        x.alignment.reference.is_known = 0.0


def apply_event(x: State, k: Parameters, w: Scratch, event: Event) -> None:
    """Apply one event at its time of validity."""
    o = address(w.observation)
    r = address(w.reference)
    v = address(event.values)
    if event.kind == KIND_GNSS:
        if not gnss.fuse_fix(x, k, w, address(v.gnss)):
            # fixes kept coming and were refused: the attitude or a bias is wrong as well
            start_over(x, x.t, RESET_VELOCITY)
    elif event.kind == KIND_HEADING:
        source = cython.cast(cython.Py_ssize_t, v.heading.source)
        if heading.is_heading_used(x, k, source):
            heading.fuse_heading(x, k, o, r, address(v.heading))
        else:
            azimuth = AZIMUTH_ANTENNA if source == 0 else AZIMUTH_OTHER
            gate.count_heading(x, VERDICT_SUPERSEDED, azimuth)
    elif event.kind == KIND_MAG:
        add_field(x, v.mag.mag_b)
        heading.use_compass(x, k, v.mag.compass)
        if heading.is_field_used(x, k):
            heading.fuse_field(x, k, o, r, v.mag.mag_b)
            if x.natural_fields == 0.0:
                forget_field(x)
        else:
            gate.count_heading(x, VERDICT_SUPERSEDED, AZIMUTH_MAGNETIC)
    elif event.kind == KIND_BARO:
        baro.fuse_baro(x, k, w, v.baro_alt)
    elif event.kind == KIND_VEHICLE:
        x.armed = v.vehicle.armed
        x.landed = v.vehicle.landed
        if v.vehicle.tells_delay == 1.0:
            take_told(x, k, v.vehicle.gnss_delay)
