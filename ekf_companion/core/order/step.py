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
from cython.cimports.ekf_companion.core.aids import (
    delay,
    rest,
    wind,
)
from cython.cimports.ekf_companion.core.filter import tape
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_VELOCITY,
    AZIMUTH_ANTENNA,
    AZIMUTH_MAGNETIC,
    AZIMUTH_OTHER,
    KIND_GNSS,
    KIND_HEADING,
    KIND_MAG,
    KIND_VEHICLE,
    MODE_INIT,
    MODE_LEVEL,
    MODE_NAVIGATE,
    RESET_VELOCITY,
    VERDICT_SUPERSEDED,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.overlay import Structs
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Event, ImuRow, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order import aid, dispatch, fix, yaw
from cython.cimports.ekf_companion.core.order.interval import (
    add_lost,
    advance,
    carry_on,
    find_interval_motion,
    inflate_after_change,
    inflate_after_gap,
    inflate_within_gap,
    shown_rate,
)
from cython.cimports.ekf_companion.core.order.restart import forget_sensors, start, start_over
from cython.cimports.ekf_companion.core.order.zero_velocity import check_rest
from cython.cimports.ekf_companion.core.start import yaw_bank, yaw_frame
from cython.cimports.ekf_companion.core.trust import gate, silence
from cython.cimports.ekf_companion.core.trust.noise import learn_noise

WITHOUT = cython.declare(cython.double, 1.0)
"""Time without the receiver's velocity after which the force is used, s."""
SLOW_GAP = cython.declare(cython.double, 3.0)
"""Usual intervals without a sample after which there is a gap, however slow the stream."""


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
    if imu.gyro_std > 0.0 or imu.accel_std > 0.0:
        inflate_after_change(x, k, imu)
        if w.tape.is_on:
            tape.record_gap(x, w)
    begin = x.t
    done = 0.0
    for r in range(first, last + 1):
        advance(x, k, w, rows[r].t, begin, span)
        if r < last:
            carry_on(x, k, w)
            if span > k.gap and k.weighs_faults == WEIGH_ACT and x.mode != MODE_LEVEL:
                done = inflate_within_gap(x, shown_rate(x, imu), done, (x.t - begin) * 1e-9)
                if w.tape.is_on:
                    tape.record_gap(x, w)
            apply_event(x, k, w, address(rows[r]))
            if w.tape.is_on:
                tape.record_event(x, w)
    if span > k.gap:
        carry_on(x, k, w)
        inflate_after_gap(x, k, span, shown_rate(x, imu), is_gap)
        if done > 0.0:
            add_lost(x, done, shown_rate(x, imu), -1.0)
        yaw_frame.restart(address(x.yaw_bank))
        if w.tape.is_on:
            tape.record_gap(x, w)

    # Learn from the sample itself: noise, rest, which aids are silent
    learn_noise(x, imu, span)
    silence.find_unmeasured(x, imu)
    keep_sample(x, imu)
    check_rest(x, k, w)
    if delay.is_due(x):
        carry_on(x, k, w)
        delay.learn(x, k, w)
    use_force(x, k, w)


def use_force(x: State, k: Parameters, w: Scratch) -> None:
    """Add the sample to the drag's block; learn from a full one, or fuse it without velocity."""
    o = address(w.observation)
    if not wind.add_force(x):
        return
    if x.mode == MODE_NAVIGATE and x.at_rest == 0.0 and x.needs_reset == 0.0 and wind.is_flying(x):
        if not gate.is_timed_out(x, AID_VELOCITY, WITHOUT):
            wind.learn(x, o)
        elif wind.is_proven(x):
            carry_on(x, k, w)
            wind.observe(x, o)
            if innovate(x, o) <= k.gate[1]:
                apply_update(x, o)
    wind.begin_block(x)


def keep_sample(x: State, imu: ImuRow) -> None:
    """Keep the sample for the next step."""
    x.samples += 1.0
    for i in range(3):
        x.gyro[i] = imu.gyro[i]
        x.accel[i] = imu.accel[i]


def apply_event(x: State, k: Parameters, w: Scratch, event: Event) -> None:
    """Apply one event at its time of validity."""
    o = address(w.observation)
    r = address(w.reference)
    v = address(event.values)
    if event.kind == KIND_GNSS:
        if not fix.fuse_fix(x, k, w, address(v.gnss)):
            # fixes kept coming and were refused: the attitude or a bias is wrong as well
            start_over(x, x.t, RESET_VELOCITY)
    elif event.kind == KIND_HEADING:
        source = cython.cast(cython.Py_ssize_t, v.heading.source)
        if yaw.is_heading_used(x, k, source):
            yaw.fuse_heading(x, k, o, r, address(v.heading))
        else:
            kind = AZIMUTH_ANTENNA if source == 0 else AZIMUTH_OTHER
            gate.count_heading(x, VERDICT_SUPERSEDED, kind)
    elif event.kind == KIND_MAG:
        rest.add_field(x, v.mag.mag_b)
        yaw.use_compass(x, k, v.mag.compass)
        if yaw.is_field_used(x, k):
            yaw.fuse_field(x, k, o, r, v.mag.mag_b)
            if x.natural_fields == 0.0:
                rest.forget_field(x)
        else:
            gate.count_heading(x, VERDICT_SUPERSEDED, AZIMUTH_MAGNETIC)
    elif event.kind == KIND_VEHICLE:
        x.armed = v.vehicle.armed
        x.landed = v.vehicle.landed
        x.vehicle = v.vehicle.type
        if v.vehicle.tells_delay == 1.0:
            delay.take_told(x, k, v.vehicle.gnss_delay)
    else:
        which = dispatch.aid_of(cython.cast(cython.Py_ssize_t, event.kind))
        if which >= 0:
            aid.fuse_aid(x, k, w, which, v.all)
