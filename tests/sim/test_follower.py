"""An autopilot's filter on our ODOMETRY, beside the same filter on its own receiver."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.config.service import OdometryConfig, OutputConfig
from ekf_companion.engine.companion import Companion
from ekf_companion.nav import so3
from sim_autopilot.acceptance import DEFAULTS
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight
from sim_autopilot.flown import fly
from sim_autopilot.follower import EKF2, EKF3, Follower
from sim_autopilot.judgement import Stack
from sim_autopilot.loop import Bench
from sim_autopilot.personality import Kind

PARTS = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
ON_OURS = {
    Kind.PX4: {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0},
    Kind.ARDUPILOT: {
        **{name: float(value) for name, value in DEFAULTS[Stack.ARDUPILOT].items()},
        "VISO_TYPE": 1.0,
        **{f"EK3_SRC1_{part}": 6.0 for part in PARTS},
    },
}


@cache
def flown(tuning, kind, **odometry):
    """Return the results on ODOMETRY and on the receiver, with the noise of PX4's simulator.

    Its inertial unit shakes as in SIH's hover; its receiver states 0.9 and 1.8 m and is off by as
    much, but the same for the whole flight.
    """
    config = SimConfig(parameters=ON_OURS[kind])
    config = replace(
        config,
        imu=replace(config.imu, accel_noise=0.088, gyro_noise=0.005),
        gnss=replace(
            config.gnss,
            rate=8.0,
            delay=0.0,
            noise_h=0.03,
            noise_v=0.05,
            slow_h=0.9,
            slow_v=1.78,
            slow_time=1e5,
            noise_vel=0.07,
        ),
    )
    flight = Flight.plan("figure-eight", config, seed=1, duration=60.0)
    ours = Companion(Config(output=OutputConfig(odometry=OdometryConfig(**odometry))))
    return fly(Bench(flight, ours, personality=kind), tuning)


@pytest.mark.campaign
@pytest.mark.parametrize(("tuning", "kind"), [(EKF2, Kind.PX4), (EKF3, Kind.ARDUPILOT)])
def test_a_covariance_without_the_slow_error_lets_it_follow_in_height_and_place(tuning, kind):
    ours, _ = flown(tuning, kind)
    whole, _ = flown(tuning, kind, covariance="whole")
    assert ours.vertical < 0.75 * whole.vertical
    assert ours.horizontal < (0.9 if kind is Kind.ARDUPILOT else 1.05) * whole.horizontal


@pytest.mark.campaign
def test_flown_on_ours_ekf2_is_as_good_as_on_its_receiver():
    ours, own = flown(EKF2, Kind.PX4)
    assert ours.velocity < own.velocity
    assert ours.vertical < own.vertical
    assert ours.tilt < 1.05 * own.tilt
    assert ours.yaw < 1.05 * own.yaw
    assert abs(ours.lead) < 0.012
    assert ours.rejected == 0
    assert ours.events == ()


LEVEL = (1.0, 0.0, 0.0, 0.0)
BODY_FRD, LOCAL_NED = 12, 1


def message(
    t, pos_n=(0.0, 0.0, 0.0), vel=(0.0, 0.0, 0.0), counter=1, quality=100, q=LEVEL, child=BODY_FRD
):
    c, v = [0.0] * 21, [0.0] * 21
    for k in (0, 6, 11):
        c[k], v[k] = 0.01, 0.01
    for k in (15, 18, 20):
        c[k] = 1e-4
    return SimpleNamespace(
        time_usec=round(t * 1e6),
        child_frame_id=child,
        **dict(zip("xyz", pos_n, strict=True)),
        **dict(zip(("vx", "vy", "vz"), vel, strict=True)),
        q=tuple(q),
        pose_covariance=c,
        velocity_covariance=v,
        reset_counter=counter,
        quality=quality,
    )


def resting(tuning, seconds, change=lambda t: {}):
    """Return a follower at rest that gets thirty messages a second, with what changes in them."""
    follower, k = Follower(tuning), 0
    for t in np.arange(0.0, seconds, 0.004):
        follower.sample(float(t), np.zeros(3), np.array([0.0, 0.0, -9.80665]))
        if t * 30.0 >= k:
            k += 1
            if (given := change(t)) is not None:
                follower.odometry(message(t, **given))
    return follower


def far(t):
    return {"pos_n": (46.0 if t > 4.0 else 0.0, 0.0, 0.0)}


def test_a_jump_without_a_counter_is_refused_by_ekf2_for_a_second_then_taken_by_a_reset():
    follower = resting(EKF2, 8.0, far)
    assert 20 < follower.rejected < 40
    ((t, text),) = follower.events
    assert text == "reset by time"
    assert t == pytest.approx(5.0, abs=0.3)
    assert follower.pos_n[0] == pytest.approx(46.0, abs=0.1)


def test_ekf3_refuses_it_for_ten_seconds():
    follower = resting(EKF3, 10.0, far)
    assert follower.rejected > 100
    assert follower.events == []
    assert abs(follower.pos_n[0]) < 5.0


@pytest.mark.parametrize("tuning", [EKF2, EKF3])
def test_a_jump_that_is_told_is_taken_at_once(tuning):
    follower = resting(tuning, 8.0, lambda t: far(t) | {"counter": 2 if t > 4.0 else 1})
    assert follower.rejected == 0
    assert [text for _, text in follower.events] == ["reset by the counter"]
    assert follower.pos_n[0] == pytest.approx(46.0, abs=0.1)


def test_of_a_velocity_north_east_and_down_ekf2_learns_nothing_of_our_error_of_attitude():
    q_nb, vel_n = so3.from_euler(0.0, np.deg2rad(2.0), 0.0), np.array([0.0, 0.0, -5.0])
    climb = {"q": q_nb, "vel": so3.to_matrix(q_nb).T @ vel_n}
    body = resting(EKF2, 8.0, lambda t: climb | {"pos_n": vel_n * t})
    climb = {"q": q_nb, "vel": vel_n, "child": LOCAL_NED}
    local = resting(EKF2, 8.0, lambda t: climb | {"pos_n": vel_n * t})
    pitches = [abs(np.rad2deg(so3.to_euler(one.q_nb)[1])) for one in (body, local)]
    assert pitches[0] > 0.5
    assert pitches[1] < 0.02
    assert abs(body.accel_bias[0]) > 0.05
    assert abs(local.accel_bias[0]) < 0.005


def test_below_the_least_quality_nothing_is_fused_and_silence_ends_the_fusion():
    strict = replace(EKF2, quality_min=50)
    follower = resting(strict, 6.0, lambda t: far(t) | {"quality": 20 if t > 4.0 else 100})
    assert follower.pos_n[0] == pytest.approx(0.0, abs=0.1)
    silent = resting(EKF2, 6.0, lambda t: None if t > 4.0 else {})
    assert [text for _, text in silent.events] == ["the stream has ended"]


def test_what_comes_sooner_than_ekf3_reads_is_dropped():
    follower = Follower(EKF3)
    for t in np.arange(0.0, 1.0, 0.004):
        follower.sample(float(t), np.zeros(3), np.array([0.0, 0.0, -9.80665]))
        follower.odometry(message(t))
    assert len(follower._waiting) < 0.3 / 0.020


def test_its_motion_is_carried_on_from_the_horizon_to_now():
    follower = resting(EKF2, 3.0, lambda t: {"vel": (1.0, 0.0, 0.0), "pos_n": (t, 0.0, 0.0)})
    now = follower.motion()
    assert now.t == pytest.approx(2.996)
    assert now.pos_n[0] == pytest.approx(2.996, abs=0.03)
    assert so3.to_euler(now.q_nb) == pytest.approx([0.0, 0.0, 0.0], abs=0.01)
