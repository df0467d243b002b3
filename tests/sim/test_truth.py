import math

import numpy as np
import pytest

from ekf_companion.nav import so3
from ekf_companion.nav.earth import (
    ECCENTRICITY_SQUARED,
    ROTATION_RATE,
    LocalFrame,
    gravity,
    radii,
)
from sim_autopilot.scenarios import REST, SCENARIOS
from sim_autopilot.sensors import mean_imu
from sim_autopilot.truth import Trajectory

HOME = LocalFrame(math.radians(47.397742), math.radians(8.545594), 488.0)


def ecef(lat, lon, alt):
    transverse = float(radii(lat)[1])
    return np.array(
        [
            (transverse + alt) * math.cos(lat) * math.cos(lon),
            (transverse + alt) * math.cos(lat) * math.sin(lon),
            (transverse * (1.0 - ECCENTRICITY_SQUARED) + alt) * math.sin(lat),
        ]
    )


def q_en(lat, lon):
    turn_lon = np.array([math.cos(lon / 2), 0.0, 0.0, math.sin(lon / 2)])
    tilt = -lat / 2 - math.pi / 4
    return multiply(turn_lon, np.array([math.cos(tilt), 0.0, math.sin(tilt), 0.0]))


def multiply(p, q):
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    return np.array(
        [
            pw * qw - px * qx - py * qy - pz * qz,
            pw * qx + px * qw + py * qz - pz * qy,
            pw * qy - px * qz + py * qw + pz * qx,
            pw * qz + px * qy - py * qx + pz * qw,
        ]
    )


def rotate(q, v):
    w, u = q[0], q[1:]
    t = 2.0 * cross(u, v)
    return v + w * t + cross(u, t)


def cross(a, b):
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def turn(phi):
    angle = math.sqrt(phi @ phi)
    scale = 0.5 if angle < 1e-8 else math.sin(angle / 2) / angle
    return np.array([math.cos(angle / 2), *(scale * phi)])


def geodetic(position):
    """Bowring's formula once: exact to 1e-11 rad near the ground."""
    x, y, z = position
    a, b = 6378137.0, 6378137.0 * math.sqrt(1.0 - ECCENTRICITY_SQUARED)
    p = math.hypot(x, y)
    theta = math.atan2(z * a, p * b)
    lat = math.atan2(
        z + (a * a - b * b) / b * math.sin(theta) ** 3,
        p - ECCENTRICITY_SQUARED * a * math.cos(theta) ** 3,
    )
    return lat, math.atan2(y, x), p / math.cos(lat) - float(radii(lat)[1])


def strapdown(trajectory: Trajectory, duration: float, rate: float):
    """Integrate ideal samples in the earth-fixed frame, with two-sample coning and sculling.

    Shares no equation with the trajectory but gravity and the ellipsoid: no north-east-down
    frame that turns, no Euler angles. Source: Savage 1998, parts 1 and 2; Groves 2013, ch. 5.3.
    """
    dt = 1.0 / rate
    ends = dt * np.arange(1, round(duration * rate) + 1)
    gyro, accel = mean_imu(trajectory, ends, dt)
    angles, speeds = gyro * dt, accel * dt
    start = trajectory.at(0.0)
    lat, lon, alt = float(start.lat[0]), float(start.lon[0]), float(start.alt[0])
    position, frame = ecef(lat, lon, alt), q_en(lat, lon)
    velocity, q = rotate(frame, start.vel_n[0]), multiply(frame, start.q_nb[0])
    earth = np.array([0.0, 0.0, ROTATION_RATE])
    back, half_back = turn(-earth * dt), turn(-earth * dt / 2)
    angle_before, speed_before = angles[0], speeds[0]
    for angle, speed in zip(angles, speeds, strict=True):
        sculling = (cross(angle_before, speed) + cross(speed_before, angle)) / 12.0
        turned = 0.5 * cross(angle, speed) + cross(angle, cross(angle, speed)) / 6.0
        push = rotate(multiply(half_back, q), speed + turned + sculling)
        middle = position + 0.5 * dt * velocity
        lat, lon, alt = geodetic(middle)
        down = rotate(q_en(lat, lon), np.array([0.0, 0.0, float(gravity(lat, alt))]))
        gain = push + down * dt
        gain = gain - 2.0 * dt * cross(earth, velocity + 0.5 * gain)
        position = position + dt * (velocity + 0.5 * gain)
        velocity = velocity + gain
        q = multiply(back, multiply(q, turn(angle + cross(angle_before, angle) / 12.0)))
        angle_before, speed_before = angle, speed

    end = trajectory.at(ends[-1])
    lat, lon, _ = geodetic(position)
    frame = q_en(lat, lon)
    back_to_n = frame * np.array([1.0, -1.0, -1.0, -1.0])
    moved = trajectory.frame.to_ned(*geodetic(position)) - end.pos_n[0]
    turned = so3.log(so3.multiply(so3.conjugate(end.q_nb[0]), multiply(back_to_n, q)))
    return (
        float(np.linalg.norm(moved)),
        float(np.linalg.norm(rotate(back_to_n, velocity) - end.vel_n[0])),
        float(np.linalg.norm(turned)),
    )


@pytest.mark.parametrize("name", SCENARIOS)
def test_ideal_samples_integrate_back_to_the_motion(name):
    trajectory = SCENARIOS[name].build(HOME, 20.0)
    position, velocity, attitude = strapdown(trajectory, 20.0, 250.0)
    # What the integration itself leaves at 250 Hz (the next test); the foot's swing is the worst,
    # 0.05 mm, 2e-5 m/s, 2e-7 rad. Without the transport rate the loiter would miss by 3 mm.
    assert position < 2e-4
    assert velocity < 5e-5
    assert attitude < 1e-6


@pytest.mark.parametrize("name", ["figure-eight", "walk"])
def test_what_is_left_is_the_integration_and_shrinks_with_its_step(name):
    trajectory = SCENARIOS[name].build(HOME, 12.0)
    coarse = strapdown(trajectory, 12.0, 250.0)
    fine = strapdown(trajectory, 12.0, 500.0)
    # Second order in position, third in velocity and attitude: 4 and 8, less rounding
    assert fine[0] < coarse[0] / 3.5
    assert fine[1] < coarse[1] / 6.5
    assert fine[2] < coarse[2] / 6.5


@pytest.mark.parametrize("name", SCENARIOS)
def test_derivatives_agree_with_differences(name):
    trajectory = SCENARIOS[name].build(HOME, 40.0)
    t = np.linspace(1.0, 39.0, 500)
    step = 1e-4
    before, now, after = (trajectory.at(t + shift) for shift in (-step, 0.0, step))
    meridian, transverse = radii(now.lat)
    north = (after.lat - before.lat) * (meridian + now.alt)
    east = (after.lon - before.lon) * (transverse + now.alt) * np.cos(now.lat)
    difference = np.stack([north, east, before.alt - after.alt], axis=-1) / (2.0 * step)
    # rounding of 1e-16 rad x 6.4e6 m / 2e-4 s
    np.testing.assert_allclose(now.vel_n, difference, atol=2e-5)
    turned = so3.log(so3.multiply(so3.conjugate(before.q_nb), after.q_nb)) / (2.0 * step)
    # third derivative of the foot's attitude, 4e4 rad/s^3, x step^2 / 6
    np.testing.assert_allclose(now.rate_nb_b, turned, atol=1e-4)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_begins_at_rest(name):
    truth = SCENARIOS[name].build(HOME, 20.0).at(np.linspace(0.0, REST, 200))
    # rounding of the splines' derivatives
    assert np.abs(truth.vel_n).max() < 1e-12
    assert np.abs(truth.rate_nb_b).max() < 1e-12
    assert np.abs(truth.pos_n).max() < 1e-12


def test_a_foot_stands_still_between_its_steps():
    truth = SCENARIOS["walk"].build(HOME, 60.0).at(np.arange(10.0, 60.0, 0.005))
    motion = np.hstack([truth.vel_n, truth.rate_nb_b])
    is_still = np.abs(motion).max(axis=1) < 1e-10  # rounding of the splines' derivatives
    assert 0.3 < is_still.mean() < 0.45
    assert np.ptp(truth.pos_n[:, 0]) > 10.0


def test_the_square_spiral_has_the_size_and_speed_of_the_seed_flight():
    truth = SCENARIOS["square-spiral"].build(HOME, 400.0).at(np.arange(0.0, 400.0, 0.1))
    speed = np.linalg.norm(truth.vel_n[600:], axis=1)
    tilt = np.degrees(np.abs(truth.euler[:, 0]).max())
    assert 1000.0 < np.ptp(truth.pos_n[:, 0]) < 1100.0
    assert 1000.0 < np.ptp(truth.pos_n[:, 1]) < 1100.0
    assert 12.5 < speed.min() < 14.0
    assert 22.0 < speed.max() < 24.0
    assert 28.0 < tilt < 38.0


def test_the_figure_eight_is_aggressive():
    truth = SCENARIOS["figure-eight"].build(HOME, 60.0).at(np.arange(15.0, 60.0, 0.01))
    tilt = np.arccos(np.cos(truth.euler[:, 0]) * np.cos(truth.euler[:, 1]))
    assert 8.0 < np.linalg.norm(truth.vel_n, axis=1).max() < 10.0
    assert 35.0 < np.degrees(tilt.max()) < 42.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_flights_go_on_for_as_long_as_one_likes(name):
    truth = SCENARIOS[name].build(HOME, 1300.0).at(np.arange(0.0, 1300.0, 0.5))
    assert np.isfinite(truth.accel_b).all()
    assert np.abs(truth.accel_b).max() < 30.0
