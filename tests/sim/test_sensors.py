"""Bounds are 4.5 sigma of the statistic: a right generator fails once in 1e5 seeds."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from sim_autopilot import sensors
from sim_autopilot.config import BaroConfig, CompassConfig, GnssConfig, ImuConfig
from sim_autopilot.scenarios import SCENARIOS

HOME = LocalFrame(math.radians(47.397742), math.radians(8.545594), 488.0)
STILL = SCENARIOS["static"].build(HOME, 2000.0)
EIGHT = SCENARIOS["figure-eight"].build(HOME, 120.0)
PERIOD = 0.004


def assert_sigma(samples, sigma):
    """Hold the sample variance of independent samples, known mean zero, to its chi-square band."""
    samples = np.ravel(samples)
    low, high = chi2.ppf([3.4e-6, 1.0 - 3.4e-6], len(samples))
    assert low < np.sum(np.square(samples)) / sigma**2 < high


def imu_of(config, seed=1, seconds=200.0):
    t = PERIOD * np.arange(1, round(seconds / PERIOD) + 1)
    data = sensors.imu(STILL, config, np.random.default_rng(seed), t, PERIOD)
    gyro_b, accel_b = sensors.mean_imu(STILL, t, PERIOD)
    return data, gyro_b, accel_b


def test_white_noise_of_the_imu_has_its_density():
    config = ImuConfig()
    data, gyro_b, accel_b = imu_of(config)
    gyro = data.gyro_b - data.gyro_bias_b - gyro_b
    accel = data.accel_b - data.accel_bias_b - accel_b
    assert_sigma(gyro, config.gyro_noise / math.sqrt(PERIOD))
    assert_sigma(accel, config.accel_noise / math.sqrt(PERIOD))
    # white: neighbours are independent
    assert abs(np.mean(gyro[1:] * gyro[:-1])) / np.mean(gyro**2) < 4.5 / math.sqrt(gyro.size)


def test_biases_start_and_wander_as_configured():
    config = dataclasses.replace(ImuConfig(), gyro_bias_instability=0.0, accel_bias_instability=0.0)
    starts = [imu_of(config, seed, seconds=0.04)[0] for seed in range(60)]
    assert_sigma([data.gyro_bias_b[0] for data in starts], config.gyro_bias_start)
    assert_sigma([data.accel_bias_b[0] for data in starts], config.accel_bias_start)
    wander = sensors.gauss_markov(
        np.random.default_rng(5).standard_normal((4_000, 50)), period=1.0, correlation=20.0
    )
    assert_sigma(wander[0], 1.0)
    assert_sigma(wander[-1], 1.0)
    correlation = np.mean(wander[20:] * wander[:-20])
    assert correlation == pytest.approx(math.exp(-1.0), abs=0.05)  # 10 000 independent spans


def test_a_low_pass_lags_a_ramp_by_its_group_delay():
    config = ImuConfig(
        lowpass=20.0,
        gyro_noise=0.0,
        accel_noise=0.0,
        gyro_bias_start=0.0,
        accel_bias_start=0.0,
        gyro_bias_instability=0.0,
        accel_bias_instability=0.0,
    )
    t = PERIOD * np.arange(1, 15001)
    filtered = sensors.imu(EIGHT, config, np.random.default_rng(0), t, PERIOD).gyro_b
    sharp = sensors.mean_imu(EIGHT, t, PERIOD)[0]
    lags = np.arange(-2, 8)
    misfit = [
        np.sum((filtered[100:-100] - np.roll(sharp, lag, axis=0)[100:-100]) ** 2) for lag in lags
    ]
    # sqrt(2) / (2 pi 20 Hz) = 11.3 ms: what was measured on a real autopilot's 20 Hz filter
    assert lags[int(np.argmin(misfit))] * PERIOD == pytest.approx(0.0113, abs=0.5 * PERIOD)


def test_fixes_have_their_sigmas_about_where_the_antenna_was_a_delay_ago():
    config = GnssConfig(lever_arm=(0.3, -0.1, -0.2), yaw=True)
    t = np.arange(1, 590) / config.rate
    fixes = sensors.gnss(EIGHT, config, np.random.default_rng(3), t)
    truth = EIGHT.at(t - 0.12)
    antenna_n = truth.pos_n + so3.rotate(truth.q_nb, np.tile(config.lever_arm, (len(t), 1)))
    error = HOME.to_ned(fixes.lat, fixes.lon, fixes.alt) - antenna_n
    assert_sigma(error[:, :2], 1.0)
    assert_sigma(error[:, 2], 1.5)
    step = 1e-3
    later, before = EIGHT.at(t - 0.12 + step), EIGHT.at(t - 0.12 - step)
    lever = np.tile(config.lever_arm, (len(t), 1))
    swing = (so3.rotate(later.q_nb, lever) - so3.rotate(before.q_nb, lever)) / (2.0 * step)
    assert_sigma(fixes.vel_n - truth.vel_n - swing, 0.1)
    assert_sigma(so3.wrap(fixes.yaw - truth.euler[:, 2]), math.radians(2.0))


def test_slow_errors_of_a_fix_are_added_only_where_asked_for():
    t = np.arange(1, 9000) / 5.0
    slow = GnssConfig(noise_h=0.0, noise_v=0.0, slow_h=1.0, slow_v=2.0, slow_time=10.0)
    fixes = sensors.gnss(STILL, slow, np.random.default_rng(3), t)
    error = HOME.to_ned(fixes.lat, fixes.lon, fixes.alt)
    # 180 correlation times: the variance is known to 15 %
    np.testing.assert_allclose(error.std(axis=0), [1.0, 1.0, 2.0], rtol=0.3)
    assert np.abs(np.diff(error[:, 0])).max() < 1.0


def test_the_compass_gives_the_heading_with_its_sigma():
    config = CompassConfig()
    t = np.arange(1, 5000) / config.rate
    data = sensors.compass(STILL, config, np.random.default_rng(4), t)
    field_n = sensors.earth_field(STILL.frame.lat, STILL.frame.lon, STILL.frame.alt, config.year)
    mag_n = so3.rotate(STILL.at(t).q_nb, data.mag_b)
    assert_sigma(mag_n - field_n, config.noise_heading * math.hypot(field_n[0], field_n[1]))
    turned = np.arctan2(mag_n[:, 1], mag_n[:, 0]) - math.atan2(field_n[1], field_n[0])
    assert_sigma(turned, math.radians(2.0))
    assert 0.2 < np.hypot(field_n[0], field_n[1]) < 0.23
    assert 0.4 < np.linalg.norm(field_n) < 0.55


def test_a_late_compass_shows_the_field_of_before():
    config = CompassConfig(noise_heading=0.0, delay=0.05)
    t = np.arange(1, 500) / config.rate
    data = sensors.compass(EIGHT, config, np.random.default_rng(4), t)
    field_n = sensors.earth_field(EIGHT.frame.lat, EIGHT.frame.lon, EIGHT.frame.alt, config.year)
    then = so3.rotate(EIGHT.at(t - 0.05).q_nb, data.mag_b)
    np.testing.assert_allclose(then - field_n, 0.0, atol=1e-12)


def test_the_slow_error_of_the_compass_is_that_of_its_heading():
    config = CompassConfig(noise_heading=0.0, slow_heading=0.02, slow_time=0.5)
    t = np.arange(1, 40_000) / config.rate
    data = sensors.compass(EIGHT, config, np.random.default_rng(4), t)
    field_n = sensors.earth_field(EIGHT.frame.lat, EIGHT.frame.lon, EIGHT.frame.alt, config.year)
    mag_n = so3.rotate(EIGHT.at(t).q_nb, data.mag_b)
    azimuth = np.arctan2(mag_n[:, 1], mag_n[:, 0]) - math.atan2(field_n[1], field_n[0])
    # a heading is what the declination lies beyond the field: too large where the field turns back
    np.testing.assert_allclose(-azimuth, data.heading_error, atol=1e-12)
    np.testing.assert_allclose(mag_n[:, 2], field_n[2], atol=1e-12)
    # 1600 correlation times: the variance is known to 4 %
    assert data.heading_error.std() == pytest.approx(0.02, rel=0.1)


def test_the_drift_of_the_barometer_is_what_its_altitude_holds_beside_noise():
    config = BaroConfig(noise=0.0, drift=0.7, drift_time=1.0)
    t = np.arange(1, 2900) / config.rate
    data = sensors.baro(EIGHT, config, np.random.default_rng(4), t)
    np.testing.assert_allclose(data.alt - data.drift, EIGHT.at(t).alt, atol=1e-9)
    assert data.drift.std() == pytest.approx(0.7, rel=0.3)  # 116 correlation times


def test_the_barometer_follows_the_height():
    config = dataclasses.replace(BaroConfig(), drift=0.0)
    t = np.arange(1, 2900) / config.rate
    data = sensors.baro(EIGHT, config, np.random.default_rng(4), t)
    assert_sigma(data.alt - EIGHT.at(t).alt, config.noise)
    assert 950.0 < data.pressure.mean() < 960.0  # 488 m above the sea


def test_a_seed_gives_the_same_bits_and_another_seed_others():
    one, again, other = (imu_of(ImuConfig(), seed, seconds=4.0)[0] for seed in (1, 1, 2))
    assert one.gyro_b.tobytes() == again.gyro_b.tobytes()
    assert one.accel_b.tobytes() == again.accel_b.tobytes()
    assert one.gyro_b.tobytes() != other.gyro_b.tobytes()


def test_turning_one_sensor_leaves_the_noise_of_the_others():
    first, second = sensors.generators(9), sensors.generators(9)
    first["gnss"].standard_normal(1000)
    for name in first.keys() - {"gnss"}:
        assert first[name].standard_normal() == second[name].standard_normal()
