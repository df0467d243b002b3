"""What a follower of ODOMETRY sees of the estimate, and what is kept from it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from ekf_companion.core.output.follower import NUMBERS, Follower
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.projection import ARDUPILOT, PX4
from tests.core.interpreted import load

DT = 1.0 / 30.0
NOT_AIDED = (0.0, 0.0, 0.0)
POSE, TWIST = slice(13, 34), slice(34, 55)
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, -9.81)
ROWS, COLUMNS = np.triu_indices(6)


def about_down(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def covariance(seed):
    A = np.random.default_rng(seed).normal(size=(6, 6))
    return A @ A.T


@dataclass(frozen=True)
class Given:
    """An estimate, as its ODOMETRY says it."""

    pos_n: tuple = (10.0, 20.0, -30.0)
    euler: tuple = (0.0, 0.0, 0.0)
    vel_n: tuple = (0.0, 0.0, 0.0)
    pose: np.ndarray = field(default_factory=lambda: covariance(1))
    twist: np.ndarray = field(default_factory=lambda: covariance(2))

    @property
    def matrix(self):
        return so3.to_matrix(so3.from_euler(*self.euler))

    @property
    def numbers(self):
        q, vel_b = so3.from_euler(*self.euler), self.matrix.T @ self.vel_n
        triangles = [one[ROWS, COLUMNS] for one in (self.pose, self.twist)]
        return NUMBERS.pack(*self.pos_n, *q, *vel_b, 0.1, 0.2, 0.3, *np.concatenate(triangles))

    def later(self, pos_n=(0.0, 0.0, 0.0), vel_n=(0.0, 0.0, 0.0), yaw=0.0, dt=DT):
        """Return the estimate after a step, and after the motion that its samples show."""
        was, now = np.array(self.vel_n), np.add(self.vel_n, vel_n)
        moved = self.pos_n + 0.5 * dt * (was + now) + np.array(pos_n)
        return replace(
            self,
            pos_n=tuple(moved),
            euler=(self.euler[0], self.euler[1], self.euler[2] + yaw),
            vel_n=tuple(now),
        )

    @property
    def sample(self):
        return (0.0, 0.0, 0.0, *(self.matrix.T @ [0.0, 0.0, -9.81]))


LEANING = Given(euler=(0.1, -0.2, 2.0), vel_n=(5.0, 1.0, -0.5))


class Watch:
    """A follower, and the estimate that it has looked at last."""

    def __init__(self, given=Given(), kind=Follower):
        self.follower, self.given, self.t_ns = kind(), given, 0
        self.step()

    def step(self, stated=NOT_AIDED, dt=DT, **step):
        """Take a step; return in what it is a jump."""
        self.given = self.given.later(**step, dt=dt)
        self.t_ns += round(dt * 1e9)
        self.follower.samples.append(self.given.sample)
        self.follower.look(self.t_ns, self.given.numbers, stated)
        return self.follower.jumps

    def sent(self, climb=1.0, errors=1.0, is_local=False):
        return Sent(self.follower.express(climb, errors, is_local))

    @property
    def as_it_is(self):
        return Sent(self.given.numbers)


class Sent:
    """An ODOMETRY as its receiver reads it."""

    def __init__(self, numbers):
        self.all = n = np.frombuffer(numbers, "<f4").astype(float)
        self.pos, self.q_nb, self.vel = n[:3], n[3:7], n[7:10]
        self.pose, self.twist = (self._matrix(n[part]) for part in (POSE, TWIST))

    @staticmethod
    def _matrix(triangle):
        P = np.zeros((6, 6))
        P[ROWS, COLUMNS] = triangle
        return P + np.triu(P, 1).T

    @property
    def matrix(self):
        return so3.to_matrix(self.q_nb)


# Steps


def circle(t):
    """A banked turn of 5 m and 2 rad/s, 20 m/s^2 to the centre; estimate and sample at a time."""
    radius, rate, bank = 5.0, 2.0, 1.1
    a = rate * t
    now = Given(
        (radius * np.cos(a), radius * np.sin(a), -10.0),
        (bank, 0.0, a + np.pi / 2),
        (-radius * rate * np.sin(a), radius * rate * np.cos(a), 0.0),
    )
    force_n = np.array([-radius * rate**2 * np.cos(a), -radius * rate**2 * np.sin(a), -9.81])
    gyro = now.matrix.T @ [0.0, 0.0, rate]
    return now, (*gyro, *(now.matrix.T @ force_n))


def measured(change=lambda t, now: now):
    """Return the steps at 30 Hz of a second of the turn, of which each estimate is changed."""
    follower, steps = Follower(), []
    for k in range(240):
        now, sample = circle(k / 240)
        follower.samples.append(sample)
        if k % 8 == 0 and follower.look(
            round(k / 240 * 1e9), change(k / 240, now).numbers, NOT_AIDED
        ):
            steps.append(np.array(follower.step))
    return np.array(steps)


def test_a_turn_at_two_g_is_motion_and_no_step():
    steps = measured()
    assert len(steps) == 29
    assert steps[:, 0] == pytest.approx(DT, abs=1e-8)
    assert np.linalg.norm(steps[:, 1:4], axis=1).max() < 0.002
    assert np.linalg.norm(steps[:, 4:7], axis=1).max() < 0.06
    assert abs(steps[:, 7]).max() < 0.001


@pytest.mark.parametrize("is_mean", [True, False])
@pytest.mark.parametrize("rate", [50, 250])
@pytest.mark.parametrize("lag", [0.0, 0.0115])
def test_gusts_that_an_estimate_is_carried_on_by_are_motion_and_no_step(lag, rate, is_mean):
    """30 m/s^2 at 4 Hz, as a fixed wing in turbulence; samples behind a lag, as ArduPilot's are."""
    follower, speeds = Follower(lag, is_mean), []
    size, w = 30.0, 2.0 * np.pi * 4.0

    def speed(t):
        return -size / w * np.cos(w * t)

    for k in range(1, 2 * rate):
        t = k / rate
        force = size * np.sin(w * (t - lag))
        if is_mean:
            force = (speed(t - lag) - speed(t - 1.0 / rate - lag)) * rate
        follower.samples.append((0.0, 0.0, 0.0, 0.0, 0.0, force - 9.81))
        if k % max(rate // 30, 1) == 0:
            # The state lies behind by the lag; the last sample carries it on
            now = Given(vel_n=(0.0, 0.0, speed(t - lag) + lag * force))
            if follower.look(round(t * 1e9), now.numbers, NOT_AIDED):
                speeds.append(np.linalg.norm(follower.step[4:7]))
    assert max(speeds) < 0.1


def test_a_step_is_measured_in_position_velocity_and_yaw_by_itself():
    def moved(t, now):
        if t < 0.5:
            return now
        euler = (now.euler[0], now.euler[1], now.euler[2] + 0.3)
        return Given(
            tuple(now.pos_n + np.array([3.0 + (t - 0.5), -4.0, 1.0])),
            euler,
            tuple(np.add(now.vel_n, (1.0, 0.0, 0.0))),
        )

    steps = measured(moved)
    sizes = np.linalg.norm(steps[:, 1:4], axis=1)
    largest = steps[np.argmax(sizes)]
    assert largest[1:4] == pytest.approx([3.0, -4.0, 1.0], abs=0.02)
    assert largest[4:7] == pytest.approx([1.0, 0.0, 0.0], abs=0.1)
    assert largest[7] == pytest.approx(0.3, abs=0.001)
    assert sorted(sizes)[-2] < 0.02


def test_without_a_look_before_or_a_sample_between_there_is_no_step():
    follower, numbers = Follower(), Given().numbers
    assert not follower.look(0, numbers, NOT_AIDED)
    follower.samples.append(STILL)
    assert not follower.look(1, numbers, NOT_AIDED)
    assert not follower.look(2, numbers, NOT_AIDED)
    follower.samples.append(STILL)
    assert follower.look(3, numbers, NOT_AIDED)
    follower.samples.append(STILL)
    follower.forget()
    assert follower.samples == []
    follower.samples.append(STILL)
    assert not follower.look(4, numbers, NOT_AIDED)
    assert follower.step == ()


# Jumps


def settled(usual=0.0):
    """Return a follower that has seen a minute of usual steps, of fixes at 5 Hz."""
    watch = Watch()
    for k in range(1800):
        watch.step(pos_n=(usual if k % 6 == 0 else 0.0, 0.0, 0.0))
    return watch


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"pos_n": (0.45, 0.0, 0.0)}, (False, False, False)),
        ({"pos_n": (0.33, 0.0, 0.44)}, (True, False, False)),
        ({"vel_n": (0.0, 0.45, 0.0)}, (False, True, False)),
        ({"yaw": np.radians(11.0)}, (False, False, True)),
        # After a pause of a second motion explains more
        (
            {"pos_n": (2.0, 0.0, 0.0), "vel_n": (0.0, 5.0, 0.0), "yaw": 0.5, "dt": 1.0},
            (False, False, False),
        ),
        (
            {"pos_n": (5.0, 0.0, 0.0), "vel_n": (0.0, 12.0, 0.0), "yaw": 1.5, "dt": 1.0},
            (True, True, True),
        ),
    ],
)
def test_a_jump_is_beyond_what_followers_take_for_noise(given, expected):
    assert settled().step(**given) == expected


def test_corrections_that_are_usual_are_no_jumps_but_a_metre_always_is():
    noisy = settled(usual=0.3)
    assert noisy.step(pos_n=(0.8, 0.0, 0.0)) == (False, False, False)
    assert noisy.step(pos_n=(1.1, 0.0, 0.0)) == (True, False, False)
    fresh = Watch()
    assert fresh.step(pos_n=(0.8, 0.0, 0.0)) == (False, False, False)


def test_a_step_within_the_sigma_that_was_stated_is_no_jump():
    position = (1.4, 0.0, 0.0)
    assert settled().step(position, pos_n=(1.2, 0.0, 0.0)) == (False, False, False)
    assert settled().step(position, pos_n=(1.5, 0.0, 0.0)) == (True, False, False)
    # The second fix of a start corrects the first by as much as both are uncertain
    assert Watch().step(position, pos_n=(4.1, 0.0, 0.0)) == (False, False, False)
    assert Watch().step(position, pos_n=(4.3, 0.0, 0.0)) == (True, False, False)
    others = (0.0, 1.0, 0.2)
    assert settled().step(others, vel_n=(0.0, 0.9, 0.0), yaw=0.3) == (False, False, True)


# What is kept from a follower


def test_with_nothing_to_add_the_bytes_are_the_same():
    watch = Watch(LEANING)
    assert watch.follower.express(1.0, 1.0, False) == watch.given.numbers


def test_what_is_spread_goes_on_without_a_step_and_the_variances_cover_it():
    watch = Watch(LEANING)
    watch.step(pos_n=(3.0, 4.0, 0.0), vel_n=(1.0, 0.0, 0.0), yaw=0.5)
    watch.follower.spread(True, True, True)
    before, after = watch.as_it_is, watch.sent()
    assert after.pos == pytest.approx(before.pos - [3.0, 4.0, 0.0], abs=1e-5)
    unturned = about_down(-0.5) @ before.matrix
    assert after.matrix == pytest.approx(unturned, abs=1e-6)
    assert after.matrix @ after.vel == pytest.approx(
        before.matrix @ before.vel - [1.0, 0.0, 0.0], abs=1e-4
    )
    assert abs(np.linalg.norm(after.q_nb) - 1.0) < 1e-6
    grown = np.diag(after.pose - before.pose)
    assert grown == pytest.approx([9.0, 16.0, 0, 0, 0, 0.25], abs=1e-4)
    assert np.trace(after.twist - before.twist) == pytest.approx(1.0, abs=1e-3)


def test_what_is_spread_comes_to_the_estimate_at_its_speed():
    watch = Watch(LEANING)
    watch.step(pos_n=(3.0, 4.0, 0.0), vel_n=(0.0, 2.0, 0.0), yaw=-0.5)
    watch.follower.spread(True, True, True)
    for _ in range(30):
        watch.step()
    before, after = watch.as_it_is, watch.sent()
    assert after.pos - before.pos == pytest.approx([-2.7, -3.6, 0.0], abs=1e-4)
    left = after.matrix @ after.vel - before.matrix @ before.vel
    assert np.linalg.norm(left) == pytest.approx(1.0, abs=1e-3)
    assert watch.follower.is_spreading
    for _ in range(30 * 10):
        watch.step()
    assert not watch.follower.is_spreading
    assert watch.follower.express(1.0, 1.0, False) == watch.given.numbers


def test_a_frame_takes_jumps_up_and_the_offset_leads_back():
    """Two jumps with turns: nothing steps, and R(yaw) pos + shift is the estimate."""
    watch = Watch()
    sent = watch.sent()
    for turn, moved in ((0.4, (5.0, -2.0, 1.0)), (-0.9, (-40.0, 7.0, 0.5))):
        watch.step(pos_n=moved, yaw=turn)
        watch.follower.move_frame()
        again = watch.sent()
        assert again.pos == pytest.approx(sent.pos, abs=1e-4)
        assert again.matrix == pytest.approx(sent.matrix, abs=1e-5)
    *shift, yaw = watch.follower.offset
    assert yaw == pytest.approx(-0.5, abs=1e-6)
    assert about_down(yaw) @ again.pos + shift == pytest.approx(watch.as_it_is.pos, abs=1e-4)


def test_the_covariance_turns_with_the_frame():
    watch = Watch(LEANING)
    watch.step(yaw=0.7)
    watch.follower.move_frame()
    P, Q, R = watch.as_it_is.pose, watch.sent().pose, about_down(-0.7)
    assert Q[:3, :3] == pytest.approx(R @ P[:3, :3] @ R.T, rel=1e-4, abs=1e-5)
    assert Q[:3, 3:] == pytest.approx(R @ P[:3, 3:], rel=1e-4, abs=1e-5)
    assert Q[3:, 3:] == pytest.approx(P[3:, 3:])


def test_a_covariance_that_is_not_known_stays_unknown():
    unknown = np.zeros((6, 6))
    unknown[0, 0] = np.nan
    watch = Watch(replace(LEANING, pose=unknown, twist=unknown))
    watch.step(pos_n=(3.0, 0.0, 0.0), yaw=0.2)
    watch.follower.spread(True, False, True)
    watch.follower.move_frame()
    for is_local in (False, True):
        after = watch.sent(climb=4.0, errors=9.0, is_local=is_local).all
        assert np.isnan(after[[13, 34]]).all()
        assert not after[14:34].any()
        assert not after[35:].any()
    follower = watch.follower
    assert follower.std_position == follower.std_velocity == follower.std_yaw == np.inf
    assert follower.std_ground_speed() == np.inf
    assert follower.std_attitude == 0.0


# What is asked for


def test_a_velocity_along_the_local_axes_is_the_same_with_its_covariance_turned():
    watch = Watch(LEANING)
    body, local = watch.sent(), watch.sent(is_local=True)
    C = body.matrix
    assert local.vel == pytest.approx(watch.given.vel_n, rel=1e-5)
    P, Q = body.twist, local.twist
    assert Q[:3, :3] == pytest.approx(C @ P[:3, :3] @ C.T, rel=1e-4, abs=1e-5)
    assert Q[:3, 3:] == pytest.approx(C @ P[:3, 3:], rel=1e-4, abs=1e-5)
    kept = [*range(7), *range(10, 34)]
    assert (local.all[kept] == body.all[kept]).all()
    assert watch.follower.std_ground_speed() == pytest.approx(np.sqrt(Q[0, 0] + Q[1, 1]))


def test_errors_are_scaled_for_position_and_velocity_and_stay_a_covariance():
    watch = Watch(LEANING)
    before, after = watch.sent(), watch.sent(errors=9.0)
    for P, Q in ((before.pose, after.pose), (before.twist, after.twist)):
        assert Q[:3, :3] == pytest.approx(9.0 * P[:3, :3], rel=1e-5)
        assert Q[3:, 3:] == pytest.approx(P[3:, 3:])
        assert np.linalg.eigvalsh(Q).min() > 0.0
    assert before.all[:13] == pytest.approx(after.all[:13])


def test_a_factor_on_the_velocity_down_leaves_all_else_alone():
    watch = Watch()
    before, after = watch.sent().all, watch.sent(climb=4.0).all
    assert np.flatnonzero(before != after).tolist() == [45]
    assert after[45] == pytest.approx(4.0 * before[45], rel=1e-6)


def test_a_vehicle_that_leans_knows_its_velocity_over_ground_as_well_as_before():
    """Along the axis of b that is nearest to down it does not: 2 m/s of a climb became sideways.

    So PX4 was told after a restart that it did not know where it flew to, and left its mode.
    """
    twist = np.diag([0.1, 0.2, 4.0, 1e-6, 1e-6, 1e-6])
    watch = Watch(replace(Given(), euler=(0.3, 0.2, 0.0), twist=twist))
    before, after = watch.sent(is_local=True).twist, watch.sent(climb=30.0, is_local=True).twist
    assert after[2, 2] == pytest.approx(30.0 * before[2, 2], rel=1e-4)
    after[2, 2] = before[2, 2]
    assert after == pytest.approx(before, abs=1e-4)


@pytest.mark.parametrize("sphere", [ARDUPILOT, PX4])
@pytest.mark.parametrize("lon", [8.5, 180.0])
def test_a_position_is_put_on_the_map_of_the_follower(sphere, lon):
    ours = np.radians(47.4), np.radians(lon), 493.5
    theirs = np.radians(47.4001), np.radians(lon - 1e-4), 489.4
    watch = Watch(Given((600.0, 250.0, -12.0)))
    scale = LocalFrame(*ours).scale
    watch.follower.place = sphere.is_azimuthal, sphere.radius, *ours, *scale, *theirs
    lat, place, alt = (float(x) for x in LocalFrame(*ours).to_geodetic(np.array([600, 250, -12])))
    sent = watch.sent()
    assert sent.pos[:2] == pytest.approx(sphere.to_metres(lat, place, *theirs[:2]), abs=1e-3)
    assert theirs[2] - sent.pos[2] == pytest.approx(alt, abs=1e-3)
    assert (sent.all[3:] == watch.as_it_is.all[3:]).all()


def test_compiled_and_interpreted_see_and_send_the_same_bits():
    rng = np.random.default_rng(5)
    watches = [Watch(LEANING, kind) for kind in (Follower, load().follower.Follower)]
    ours = np.radians(47.4), np.radians(8.5), 493.5
    for k in range(40):
        step = {"pos_n": rng.normal(size=3), "vel_n": rng.normal(size=3), "yaw": rng.normal()}
        parts = [bool(one) for one in rng.integers(2, size=3)]
        sphere, sent = (ARDUPILOT, PX4)[k % 2], []
        for watch in watches:
            follower = watch.follower
            scale = LocalFrame(*ours).scale
            follower.place = sphere.is_azimuthal, sphere.radius, *ours, *scale, *ours
            jumps = watch.step(**step)
            follower.spread(*parts)
            if k % 3 == 0:
                follower.move_frame()
            found = follower.step, jumps, follower.offset, follower.std_ground_speed()
            sent.append((*found, follower.express(1.0 + k, 1.0 + k % 2, k % 5 == 0)))
        assert sent[0] == sent[1]
