"""The bank: its frame, the mixture on the circle, whom it believes."""

import math

import numpy as np
import pytest

from ekf_companion.core.memory.enums import YAW_FILTERS, Mode
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Motion, YawUpdate
from ekf_companion.core.memory.state import State, YawBank
from ekf_companion.core.order.timeline import Timeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from tests.core.flights import flight, without
from tests.core.interpreted import load
from tests.core.states import array
from tests.core.test_timeline import a_timeline, settled

GRAVITY = 9.80665


def carry(b: YawBank, dt: float, *sample: float) -> None:
    """Carry the frame over dt at a rate and a force."""
    m = Motion()
    m.rate[:], m.force[:] = sample[:3], sample[3:]
    load().yaw_frame.integrate(b, m, dt)


def fuse(x: State, north: float, east: float) -> None:
    """Fuse a velocity of 0.1 m/s."""
    u = YawUpdate()
    u.vel_n[:] = [north, east]
    load().yaw_bank.fuse_velocity(x, parameters(), u, 0.1)


def parameters() -> Parameters:
    return Parameters(gyro_bias_std=0.02, delay_std=0.05)


def filters(b: YawBank) -> np.ndarray:
    """Return the filters as records, a view."""
    return array(b.filter)


def begun() -> State:
    x = State()
    load().yaw_bank.restart(x.yaw_bank, parameters())
    return x


def levelled() -> YawBank:
    b = begun().yaw_bank
    b.sums.dv[2] = -GRAVITY
    u = YawUpdate()
    load().yaw_bank.start_filters(b, parameters(), u, 0.25)
    return b


def fly(seconds: float, yaw: float, accel, gyro_z: float = 0.0, wild: int | None = None):
    """Fly a level body by a bank: forward axis at yaw + gyro_z t, accel(t) in n; 10 fixes a second.

    One fix (by number) may be wild.
    """
    x = begun()
    dt, velocity = 0.01, np.zeros(2)
    for i in range(round(seconds / dt)):
        t = i * dt
        force = np.asarray(accel(t + 0.5 * dt))
        heading = yaw + gyro_z * (t + 0.5 * dt)
        c, s = np.cos(heading), np.sin(heading)
        body = (c * force[0] + s * force[1], -s * force[0] + c * force[1], -GRAVITY)
        carry(x.yaw_bank, dt, 0.0, 0.0, gyro_z, *body)
        velocity = velocity + force * dt
        if i % 10 == 9:
            jump = 30.0 if wild == i // 10 else 0.0
            fuse(x, velocity[0] + jump, velocity[1])
    return x, yaw + gyro_z * seconds


def heading(x: State) -> float:
    """Return the azimuth of the body's forward axis by the bank."""
    b = x.yaw_bank
    return float(so3.wrap(so3.to_euler(np.array(b.q_sb))[2] + b.yaw))


def test_the_sums_are_those_of_the_exact_motion():
    rng = np.random.default_rng(1)
    b = begun().yaw_bank
    q, force, turned = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros((3, 3))
    fine = 20
    for _ in range(25):
        gyro, accel = rng.normal(0.0, 1.5, 3), rng.normal(0.0, 4.0, 3)
        carry(b, 0.004, *gyro, *accel)
        for _ in range(fine):
            middle = so3.multiply(q, so3.exp(gyro * 0.002 / fine))
            force += so3.rotate(middle, accel) * 0.004 / fine
            turned += so3.to_matrix(middle) * 0.004 / fine
            q = so3.multiply(q, so3.exp(gyro * 0.004 / fine))
    np.testing.assert_allclose(b.q_sb, q, atol=1e-9)
    np.testing.assert_allclose(b.sums.dv, force, atol=1e-5)
    # the turn is taken at the start of each sample: half of 1.5 rad/s 4 ms, and random in sign
    np.testing.assert_allclose(array(b.sums.turn), turned, atol=1e-3)
    assert b.sums.dt == pytest.approx(0.1)


@pytest.mark.parametrize("up", [(0, 0, -1), (0, 0, 1), (1, 0, 0), (0, -1, 0), (0.3, -0.8, 0.5)])
def test_any_attitude_is_levelled(up):
    x = begun()
    b = x.yaw_bank
    force = GRAVITY * np.array(up, dtype=float) / np.linalg.norm(up)
    for _ in range(120):
        carry(b, 0.01, 0.0, 0.0, 0.0, *force)
    fuse(x, 1.0, 2.0)
    assert b.is_running
    level = so3.rotate(np.array(b.q_sb), force)
    np.testing.assert_allclose(level, [0.0, 0.0, -GRAVITY], atol=1e-9)
    assert filters(b)["x"][:, 0].tolist() == [1.0] * YAW_FILTERS


def test_yaws_on_both_sides_of_south_have_their_mean_there():
    b = levelled()
    rows = filters(b)
    rows["weight"] = [0.5, 0.5, *[0.0] * (YAW_FILTERS - 2)]
    rows["x"][:2, 2] = np.radians([170.0, -170.0])
    rows["P"][:2, 2, 2] = np.radians(5.0) ** 2
    load().yaw_bank.merge_filters(b)
    assert abs(np.degrees(b.yaw)) == pytest.approx(180.0)
    assert np.degrees(b.yaw_std) == pytest.approx(np.hypot(10.0, 5.0))


def test_the_mean_tilt_and_bias_go_into_the_frame_and_nothing_is_lost():
    b = levelled()
    errors = filters(b)["x"][:, 3:8]
    errors[:] = np.random.default_rng(2).normal(0.0, 1e-3, (YAW_FILTERS, 5))
    before = errors.copy()
    load().yaw_bank.merge_filters(b)
    assert np.abs(errors.mean(axis=0)).max() < 1e-15
    tilt = so3.log(np.array(b.q_sb))
    after = errors + np.hstack([tilt[:2], b.gyro_bias])
    np.testing.assert_allclose(after, before, atol=1e-15)


@pytest.mark.parametrize("yaw", np.radians([-170.0, -60.0, 10.0, 22.5, 100.0, 179.0]))
def test_a_circle_shows_the_yaw_wherever_it_lies(yaw):
    x, truth = fly(12.0, yaw, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)) if t > 2 else (0, 0))
    assert x.yaw_bank.good >= 5.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 1.0
    assert np.degrees(x.yaw_bank.yaw_std) < 10.0


def test_a_turning_body_and_its_gyro_bias_are_followed():
    """The gyro says 0.1 rad/s too much about down while nothing but the heading turns."""
    x = begun()
    dt, velocity, told = 0.01, np.zeros(2), 0.01
    for i in range(6000):
        t = i * dt
        force = np.array([2.0 * np.cos(0.7 * t), 2.0 * np.sin(0.7 * t)])
        carry(x.yaw_bank, dt, 0.0, 0.0, told, force[0], force[1], -GRAVITY)
        velocity = velocity + force * dt
        if i % 10 == 9:
            fuse(x, *velocity)
    assert abs(np.degrees(heading(x))) < 3.0
    assert x.yaw_bank.gyro_bias[2] == pytest.approx(told, abs=2e-3)


def test_who_does_not_move_has_no_heading():
    x, _ = fly(60.0, 0.3, lambda _: (0.0, 0.0))
    assert np.degrees(x.yaw_bank.yaw_std) > 60.0
    assert x.yaw_bank.good == 0.0


def test_a_small_motion_is_no_manoeuvre_however_long():
    """A velocity of 0.4 m/s shows the yaw in the end, but it is not told."""
    x, truth = fly(90.0, 0.3, lambda t: (0.8 * np.cos(2.0 * t), 0.8 * np.sin(2.0 * t)))
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 20.0
    assert x.yaw_bank.good == 0.0


def test_a_wild_fix_is_refused_and_leaves_the_yaw_alone():
    def circle(t):
        return (2.0 * np.cos(t), 2.0 * np.sin(t))

    x, truth = fly(12.0, 1.0, circle, wild=119)
    assert x.yaw_bank.good == 0.0  # not consecutive any more
    assert x.yaw_bank.refused == 1.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 1.0


def test_a_filter_that_nothing_speaks_for_does_not_take_up_a_wild_fix():
    x, u = State(yaw_bank=levelled()), YawUpdate()
    u.vel_n[:] = [20.0, 0.0]
    b = x.yaw_bank
    filters(b)["weight"] = [1.0, *[1e-6] * 7]
    b.filter[5].x[0] = 20.0
    carry(b, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    assert not load().yaw_bank.update_filters(x, parameters(), u, 0.25)
    filters(b)["weight"] = 1.0 / 8.0
    carry(b, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    assert load().yaw_bank.update_filters(x, parameters(), u, 0.25)


def test_a_bank_that_began_at_a_wild_fix_begins_again():
    def circle(t):
        return (2.0 * np.cos(t), 2.0 * np.sin(t))

    x, _ = fly(2.0, 1.0, circle, wild=9)
    assert not x.yaw_bank.is_running
    x, truth = fly(14.0, 1.0, circle, wild=9)
    assert x.yaw_bank.good >= 5.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 3.0


@pytest.mark.parametrize("blow", [(25.0, 0.0), (0.0, 100.0)])
def test_a_blow_loses_the_frame_but_not_the_bias(blow):
    x, _ = fly(12.0, 1.0, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)))
    x.yaw_bank.gyro_bias[:] = [0.01, -0.02, 0.005]
    rate, force = blow
    carry(x.yaw_bank, 0.01, rate, 0.0, 0.0, force, 0.0, -GRAVITY)
    assert not x.yaw_bank.is_running
    assert x.yaw_bank.good == 0.0
    assert list(x.yaw_bank.gyro_bias) == [0.01, -0.02, 0.005]


def test_a_noise_that_is_not_a_number_makes_the_bank_begin_anew():
    x, _ = fly(12.0, 1.0, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)))
    x.yaw_bank.vel_var = np.nan
    carry(x.yaw_bank, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    fuse(x, 0.0, 0.0)
    assert not x.yaw_bank.is_running
    assert np.isfinite(array(x.yaw_bank.sums.turn)).all()
    assert math.isfinite(x.yaw_bank.vel_var + x.yaw_bank.sums.dt + x.yaw_bank.yaw)


def no_compass(seconds: float) -> Events:
    events, _ = flight("figure-eight", duration=seconds, rate=50.0)
    return without(events, Kind.MAG)


def test_any_order_of_arrival_gives_the_same_bits_through_a_start_by_motion():
    events = no_compass(14.0)
    rng = np.random.default_rng(5)
    late = events.t_ns + rng.uniform(0.0, 1.8e9, len(events))
    shuffled = events.take(np.argsort(late, kind="stable"))
    timeline = a_timeline()
    in_order = settled(timeline, events)
    assert as_state(timeline.block()).mode == Mode.NAVIGATE
    assert settled(a_timeline(), shuffled) == in_order


def test_interpreted_and_compiled_agree_to_the_last_bit_through_a_start_by_motion():
    events = no_compass(13.0)
    blocks = []
    for kind in (Timeline, load().timeline.Timeline):
        timeline = a_timeline(kind)
        blocks.append(settled(timeline, events))
        assert as_state(timeline.block()).mode == Mode.NAVIGATE
    assert blocks[0] == blocks[1]
