import numpy as np
import pytest

from ekf_companion.core.settings import FilterSettings, ImuSettings
from ekf_companion.errors import LogError
from ekf_companion.filters.alignment import MOVING_TILT, UNKNOWN_VELOCITY, align
from ekf_companion.filters.observation import Azimuth, Position, Velocity
from ekf_companion.filters.strapdown import ATT, BA, BG, POS, VEL
from ekf_companion.nav import so3
from ekf_companion.nav.earth import STANDARD_GRAVITY, earth_rate_n

TRUE = so3.from_euler(0.15, -0.1, 2.5)
FIELD_N = np.array([0.215, 0.013, 0.433])
GYRO_BIAS = np.array([0.004, -0.003, 0.002])
RATE_N = earth_rate_n(0.83)
SETTINGS = FilterSettings(imu=ImuSettings(accel_bias=0.05, gyro_bias=0.01))
LEVER = np.array([0.3, 0.0, -0.2])


def readings(rng, shake=0.02, bias=(0.0, 0.0, 0.0)):
    C_nb = so3.to_matrix(TRUE)
    t_ns = np.arange(300, dtype=np.int64) * 10_000_000
    gyro = GYRO_BIAS + C_nb.T @ RATE_N + rng.normal(0.0, 0.002, (300, 3))
    accel = C_nb.T @ [0.0, 0.0, -STANDARD_GRAVITY] + bias + rng.normal(0.0, shake, (300, 3))
    return t_ns, gyro, accel


def aids(rng, vel_n=(0.0, 0.0, 0.0), noise=0.0):
    C_nb = so3.to_matrix(TRUE)
    field = C_nb.T @ FIELD_N
    declination = float(np.arctan2(FIELD_N[1], FIELD_N[0]))
    pos_n = np.array([1.0, 2.0, 3.0])
    found = [
        (1_200_000_000, Position(pos_n=pos_n, std=np.array([1.0, 1.0, 2.0]), lever_b=LEVER)),
        (1_200_000_000, Velocity(vel_n=np.array(vel_n), std=0.2, swing_b=np.zeros(3))),
    ]
    for k in range(40):
        seen_b = field + noise * rng.standard_normal(3)
        t_ns = 20_000_000 * k + 500_000_000
        found.append((t_ns, Azimuth(seen_b=seen_b, azimuth=declination, std=0.02)))
    return sorted(found, key=lambda one: one[0])


def error_n(start):
    return so3.log(so3.multiply(TRUE, so3.conjugate(start.state.q_nb)))


def test_at_rest_it_finds_level_north_and_the_bias_of_the_gyro():
    rng = np.random.default_rng(1)
    start = align(*readings(rng), aids(rng), SETTINGS, RATE_N)
    assert start.t_ns == 1_200_000_000
    np.testing.assert_allclose(error_n(start), 0.0, atol=2e-3)
    np.testing.assert_allclose(
        start.state.gyro_bias, GYRO_BIAS, atol=8e-4
    )  # 4 sigma of 100 samples
    antenna = start.state.pos_n + so3.to_matrix(TRUE) @ LEVER
    np.testing.assert_allclose(antenna, [1.0, 2.0, 3.0], atol=2e-3)
    assert np.linalg.eigvalsh(start.P).min() > 0.0
    np.testing.assert_allclose(np.sqrt(np.diag(start.P)[POS]), [1.0, 1.0, 2.0])
    assert (np.sqrt(np.diag(start.P)[BG]) < 0.002).all()


def test_its_errors_are_as_large_and_tied_together_as_it_says():
    rng = np.random.default_rng(2)
    squares = []
    for _ in range(60):
        bias = rng.normal(0.0, 0.05, 3)
        start = align(*readings(rng, bias=bias), aids(rng, noise=0.004), SETTINGS, RATE_N)
        C_nb = so3.to_matrix(start.state.q_nb)
        gap = np.concatenate([C_nb.T @ error_n(start), bias])
        both = np.r_[ATT, BA]
        squares.append(gap @ np.linalg.solve(start.P[np.ix_(both, both)], gap) / 6.0)
    # Many looks at north count as one, whose errors may be slow: so below 1
    assert 0.5 < np.mean(squares) < 1.2


def test_a_level_is_as_wrong_as_the_bias_makes_it():
    rng = np.random.default_rng(3)
    bias = so3.to_matrix(TRUE).T @ [0.3, 0.0, 0.0]
    start = align(*readings(rng, bias=bias), aids(rng), SETTINGS, RATE_N)
    assert error_n(start)[1] == pytest.approx(-0.3 / STANDARD_GRAVITY, rel=0.05)
    # Told the bias, the covariance turns the level back
    back = start.P[ATT, BA] @ np.linalg.solve(start.P[BA, BA], bias)
    left = so3.to_matrix(start.state.q_nb).T @ error_n(start) - back
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(error_n(start))


def test_in_motion_nothing_is_taken_for_rest():
    rng = np.random.default_rng(4)
    start = align(*readings(rng), aids(rng, vel_n=(5.0, 0.0, 0.0)), SETTINGS, RATE_N)
    assert (start.state.gyro_bias == 0.0).all()
    assert start.state.vel_n[0] == 5.0
    assert np.sqrt(np.trace(start.P[ATT, ATT])) > MOVING_TILT
    shaken = align(*readings(rng, shake=2.0), aids(rng), SETTINGS, RATE_N)
    assert (shaken.state.gyro_bias == 0.0).all()


def test_a_vertical_velocity_that_no_fix_says_is_unknown():
    rng = np.random.default_rng(5)
    start = align(*readings(rng, shake=2.0), aids(rng, vel_n=(3.0, 0.0)), SETTINGS, RATE_N)
    sigmas = np.sqrt(np.diag(start.P)[VEL])
    np.testing.assert_allclose(sigmas, [0.2, 0.2, UNKNOWN_VELOCITY])


def test_a_recording_that_ends_too_early_is_refused():
    rng = np.random.default_rng(6)
    t_ns, gyro, accel = readings(rng)
    with pytest.raises(LogError, match="ends before"):
        align(t_ns[:50], gyro[:50], accel[:50], aids(rng), SETTINGS)
    only_fixes = [one for one in aids(rng) if not isinstance(one[1], Azimuth)]
    with pytest.raises(LogError, match="no heading"):
        align(t_ns, gyro, accel, only_fixes, SETTINGS)


def test_headings_about_south_are_averaged_there():
    rng = np.random.default_rng(7)
    forward = np.array([1.0, 0.0, 0.0])
    both = [
        (500_000_000 + k, Azimuth(seen_b=forward, azimuth=np.pi + 0.01 * (-1) ** k, std=0.02))
        for k in range(10)
    ]
    found = [one for one in aids(rng) if not isinstance(one[1], Azimuth)]
    start = align(*readings(rng), sorted(both + found, key=lambda one: one[0]), SETTINGS)
    assert abs(so3.to_euler(start.state.q_nb)[2]) == pytest.approx(np.pi, abs=1e-3)


@pytest.mark.parametrize("rate", [0.15, 0.3])
def test_a_slow_steady_turn_is_no_bias(rate):
    rng = np.random.default_rng(8)
    t_ns, gyro, accel = readings(rng)
    start = align(t_ns, gyro + np.array([0.0, 0.0, rate]), accel, aids(rng), SETTINGS, RATE_N)
    assert (start.state.gyro_bias == 0.0).all()
    assert np.sqrt(start.P[BG, BG].max()) == pytest.approx(SETTINGS.imu.gyro_bias)


def test_a_steady_push_is_no_rest():
    rng = np.random.default_rng(9)
    t_ns, gyro, accel = readings(rng)
    start = align(t_ns, gyro, 1.2 * accel, aids(rng), SETTINGS, RATE_N)
    assert (start.state.gyro_bias == 0.0).all()


def test_what_is_older_than_the_window_is_not_begun_from():
    rng = np.random.default_rng(10)
    t_ns, gyro, accel = readings(rng)
    norths = [one for one in aids(rng) if isinstance(one[1], Azimuth)]
    std = np.ones(3)

    def fix(t, north, speed):
        pos_n = np.array([north, 0.0, 0.0])
        vel_n = np.array([speed, 0.0, 0.0])
        return [
            (t, Position(pos_n=pos_n, std=std, lever_b=np.zeros(3))),
            (t, Velocity(vel_n=vel_n, std=0.1, swing_b=np.zeros(3))),
        ]

    # The only heading comes long after the first fix
    late = [(t + 1_900_000_000, aid) for t, aid in norths[:5]]
    early = fix(100_000_000, 0.0, 50.0)
    with pytest.raises(LogError, match="within 1 s"):
        align(t_ns, gyro, accel, sorted(early + late, key=lambda o: o[0]), SETTINGS)
    both = sorted(early + late + fix(2_600_000_000, 70.0, 0.0), key=lambda o: o[0])
    start = align(t_ns, gyro, accel, both, SETTINGS)
    assert start.t_ns == 2_600_000_000
    assert start.state.pos_n[0] == 70.0
    assert start.state.vel_n[0] == 0.0


def test_a_start_at_the_last_sample_leaves_nothing_to_estimate():
    rng = np.random.default_rng(11)
    t_ns, gyro, accel = readings(rng)
    with pytest.raises(LogError, match="ends before"):
        align(t_ns[:121], gyro[:121], accel[:121], aids(rng), SETTINGS)
    assert align(t_ns[:122], gyro[:122], accel[:122], aids(rng), SETTINGS).t_ns == t_ns[120]
