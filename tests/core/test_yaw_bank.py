"""The bank: its frame, the mixture on the circle, whom it believes."""

import numpy as np
import pytest

from ekf_companion.core import state as at
from ekf_companion.core.timeline import Timeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from tests.core.flights import flight, without
from tests.core.interpreted import load
from tests.core.test_timeline import a_timeline, settled

B = at.X_BANK
GRAVITY = 9.80665


def carry(x, w, dt, *sample):
    """Carry the frame over dt at a rate and a force."""
    w[at.W_RATE : at.W_RATE + 6] = sample
    load().yaw_frame.carry(x, w, dt)


def parameters() -> np.ndarray:
    k = np.zeros(at.PARAMETERS)
    k[at.K_GYRO_BIAS] = 0.02
    k[at.K_DELAY_STD] = 0.05
    return k


def hypotheses(x: np.ndarray) -> np.ndarray:
    """Give the hypotheses as rows, a view."""
    return x[B + at.B_H : B + at.B_SIZE].reshape(at.HYPOTHESES, at.H_SIZE)


def begun() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, k, w = np.zeros(at.BLOCK), parameters(), np.zeros(at.SCRATCH)
    load().yaw_bank.begin(x, k)
    return x, k, w


def levelled() -> np.ndarray:
    x, k, _ = begun()
    x[B + at.B_U + 2] = -GRAVITY
    load().yaw_bank.level(x, k, 0.0, 0.0, 0.25)
    return x


def fly(seconds: float, yaw: float, accel, gyro_z: float = 0.0, wild: int | None = None):
    """Fly a level body by a bank: forward axis at yaw + gyro_z t, accel(t) in n; 10 fixes a second.

    One fix (by number) may be wild.
    """
    x, k, w = begun()
    dt, velocity = 0.01, np.zeros(2)
    for i in range(round(seconds / dt)):
        t = i * dt
        force = np.asarray(accel(t + 0.5 * dt))
        heading = yaw + gyro_z * (t + 0.5 * dt)
        c, s = np.cos(heading), np.sin(heading)
        body = (c * force[0] + s * force[1], -s * force[0] + c * force[1], -GRAVITY)
        carry(x, w, dt, 0.0, 0.0, gyro_z, *body)
        velocity = velocity + force * dt
        if i % 10 == 9:
            jump = 30.0 if wild == i // 10 else 0.0
            load().yaw_bank.correct(x, k, w, velocity[0] + jump, velocity[1], 0.1)
    return x, yaw + gyro_z * seconds


def heading(x: np.ndarray) -> float:
    """Give the azimuth of the body's forward axis by the bank."""
    q = x[B + at.B_Q : B + at.B_Q + 4]
    return float(so3.wrap(so3.to_euler(q)[2] + x[B + at.B_YAW]))


def test_the_sums_are_those_of_the_exact_motion():
    rng = np.random.default_rng(1)
    x, _, w = begun()
    q, force, turned = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros((3, 3))
    fine = 20
    for _ in range(25):
        gyro, accel = rng.normal(0.0, 1.5, 3), rng.normal(0.0, 4.0, 3)
        carry(x, w, 0.004, *gyro, *accel)
        for _ in range(fine):
            middle = so3.multiply(q, so3.exp(gyro * 0.002 / fine))
            force += so3.rotate(middle, accel) * 0.004 / fine
            turned += so3.to_matrix(middle) * 0.004 / fine
            q = so3.multiply(q, so3.exp(gyro * 0.004 / fine))
    np.testing.assert_allclose(x[B + at.B_Q : B + at.B_Q + 4], q, atol=1e-9)
    np.testing.assert_allclose(x[B + at.B_U : B + at.B_U + 3], force, atol=1e-5)
    # the turn is taken at the start of each sample: half of 1.5 rad/s 4 ms, and random in sign
    np.testing.assert_allclose(x[B + at.B_G : B + at.B_G + 9], turned.ravel(), atol=1e-3)
    assert x[B + at.B_DT] == pytest.approx(0.1)


@pytest.mark.parametrize("up", [(0, 0, -1), (0, 0, 1), (1, 0, 0), (0, -1, 0), (0.3, -0.8, 0.5)])
def test_any_attitude_is_levelled(up):
    x, k, w = begun()
    force = GRAVITY * np.array(up, dtype=float) / np.linalg.norm(up)
    for _ in range(120):
        carry(x, w, 0.01, 0.0, 0.0, 0.0, *force)
    load().yaw_bank.correct(x, k, w, 1.0, 2.0, 0.1)
    assert x[B + at.B_MODE] == at.BANK_RUNNING
    level = so3.rotate(x[B + at.B_Q : B + at.B_Q + 4], force)
    np.testing.assert_allclose(level, [0.0, 0.0, -GRAVITY], atol=1e-9)
    assert hypotheses(x)[:, at.H_X].tolist() == [1.0] * at.HYPOTHESES


def test_yaws_on_both_sides_of_south_have_their_mean_there():
    x = levelled()
    rows = hypotheses(x)
    rows[:, at.H_W] = 0.0
    rows[:2, at.H_W] = 0.5
    rows[:2, at.H_X + 2] = np.radians([170.0, -170.0])
    rows[:2, at.H_P + 2 * (at.H_N + 1)] = np.radians(5.0) ** 2
    load().yaw_bank.conclude(x)
    assert abs(np.degrees(x[B + at.B_YAW])) == pytest.approx(180.0)
    assert np.degrees(x[B + at.B_STD]) == pytest.approx(np.hypot(10.0, 5.0))


def test_the_mean_tilt_and_bias_go_into_the_frame_and_nothing_is_lost():
    x = levelled()
    rows = hypotheses(x)
    rng = np.random.default_rng(2)
    rows[:, at.H_X + 3 : at.H_X + 8] = rng.normal(0.0, 1e-3, (at.HYPOTHESES, 5))
    before = rows[:, at.H_X + 3 : at.H_X + 8].copy()
    load().yaw_bank.conclude(x)
    assert np.abs(rows[:, at.H_X + 3 : at.H_X + 8].mean(axis=0)).max() < 1e-15
    tilt = so3.log(x[B + at.B_Q : B + at.B_Q + 4])
    after = rows[:, at.H_X + 3 : at.H_X + 8] + [*tilt[:2], *x[B + at.B_BG : B + at.B_BG + 3]]
    np.testing.assert_allclose(after, before, atol=1e-15)


@pytest.mark.parametrize("yaw", np.radians([-170.0, -60.0, 10.0, 22.5, 100.0, 179.0]))
def test_a_circle_shows_the_yaw_wherever_it_lies(yaw):
    x, truth = fly(12.0, yaw, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)) if t > 2 else (0, 0))
    assert x[B + at.B_GOOD] >= 5.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 1.0
    assert np.degrees(x[B + at.B_STD]) < 10.0


def test_a_turning_body_and_its_gyro_bias_are_followed():
    """The gyro says 0.1 rad/s too much about down while nothing but the heading turns."""
    x, k, w = begun()
    dt, velocity, told = 0.01, np.zeros(2), 0.01
    for i in range(6000):
        t = i * dt
        force = np.array([2.0 * np.cos(0.7 * t), 2.0 * np.sin(0.7 * t)])
        carry(x, w, dt, 0.0, 0.0, told, force[0], force[1], -GRAVITY)
        velocity = velocity + force * dt
        if i % 10 == 9:
            load().yaw_bank.correct(x, k, w, *velocity, 0.1)
    assert abs(np.degrees(heading(x))) < 3.0
    assert x[B + at.B_BG + 2] == pytest.approx(told, abs=2e-3)


def test_who_does_not_move_has_no_heading():
    x, _ = fly(60.0, 0.3, lambda _: (0.0, 0.0))
    assert np.degrees(x[B + at.B_STD]) > 60.0
    assert x[B + at.B_GOOD] == 0.0


def test_a_small_motion_is_no_manoeuvre_however_long():
    """A velocity of 0.4 m/s shows the yaw in the end, but it is not told."""
    x, truth = fly(90.0, 0.3, lambda t: (0.8 * np.cos(2.0 * t), 0.8 * np.sin(2.0 * t)))
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 20.0
    assert x[B + at.B_GOOD] == 0.0


def test_a_wild_fix_is_refused_and_leaves_the_yaw_alone():
    def circle(t):
        return (2.0 * np.cos(t), 2.0 * np.sin(t))

    x, truth = fly(12.0, 1.0, circle, wild=119)
    assert x[B + at.B_GOOD] == 0.0  # not consecutive any more
    assert x[B + at.B_REFUSED] == 1.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 1.0


def test_a_hypothesis_that_nothing_speaks_for_does_not_take_up_a_wild_fix():
    x, k, w = levelled(), parameters(), np.zeros(at.SCRATCH)
    rows = hypotheses(x)
    rows[:, at.H_W] = [1.0, *[1e-6] * 7]
    rows[5, at.H_X] = 20.0
    carry(x, w, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    assert not load().yaw_bank.weigh(x, k, w, 20.0, 0.0, 0.25)
    rows[:, at.H_W] = 1.0 / 8.0
    carry(x, w, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    assert load().yaw_bank.weigh(x, k, w, 20.0, 0.0, 0.25)


def test_a_bank_that_began_at_a_wild_fix_begins_again():
    def circle(t):
        return (2.0 * np.cos(t), 2.0 * np.sin(t))

    x, _ = fly(2.0, 1.0, circle, wild=9)
    assert x[B + at.B_MODE] == at.BANK_LEVELLING
    x, truth = fly(14.0, 1.0, circle, wild=9)
    assert x[B + at.B_GOOD] >= 5.0
    assert abs(np.degrees(so3.wrap(heading(x) - truth))) < 3.0


@pytest.mark.parametrize("blow", [(25.0, 0.0), (0.0, 100.0)])
def test_a_blow_loses_the_frame_but_not_the_bias(blow):
    x, _ = fly(12.0, 1.0, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)))
    x[B + at.B_BG : B + at.B_BG + 3] = [0.01, -0.02, 0.005]
    rate, force = blow
    carry(x, np.zeros(at.SCRATCH), 0.01, rate, 0.0, 0.0, force, 0.0, -GRAVITY)
    assert x[B + at.B_MODE] == at.BANK_LEVELLING
    assert x[B + at.B_GOOD] == 0.0
    assert x[B + at.B_BG : B + at.B_BG + 3].tolist() == [0.01, -0.02, 0.005]


def test_a_noise_that_is_not_a_number_makes_the_bank_begin_anew():
    x, _ = fly(12.0, 1.0, lambda t: (2.0 * np.cos(t), 2.0 * np.sin(t)))
    x[B + at.B_WHITE] = np.nan
    carry(x, np.zeros(at.SCRATCH), 0.01, 0.0, 0.0, 0.0, 0.0, 0.0, -GRAVITY)
    load().yaw_bank.correct(x, parameters(), np.zeros(at.SCRATCH), 0.0, 0.0, 0.1)
    assert x[B + at.B_MODE] == at.BANK_LEVELLING
    assert np.isfinite(x[B : B + at.B_H]).all()


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
    assert timeline.block()[at.X_MODE] == at.MODE_NAVIGATE
    assert settled(a_timeline(), shuffled) == in_order


def test_interpreted_and_compiled_agree_to_the_last_bit_through_a_start_by_motion():
    events = no_compass(13.0)
    blocks = []
    for kind in (Timeline, load().timeline.Timeline):
        timeline = a_timeline(kind)
        blocks.append(settled(timeline, events))
        assert timeline.block()[at.X_MODE] == at.MODE_NAVIGATE
    assert blocks[0] == blocks[1]
