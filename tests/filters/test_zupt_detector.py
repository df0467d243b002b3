import numpy as np
import pytest

from ekf_companion.filters.zupt_detector import Detector, Limits, moving_variance, statistic

GRAVITY = 9.81
LIMITS = Limits(gyro=0.3, accel=1.5)


@pytest.fixture
def samples():
    rng = np.random.default_rng(1)
    return rng.normal(size=(23, 3)), rng.normal(loc=[1.0, -2.0, -9.0], size=(23, 3))


def windows(n, half):
    return [slice(max(0, index - half), index + half + 1) for index in range(n)]


def direct(detector, gyro, accel, window):
    f, w = accel[window], gyro[window]
    mean = f.mean(axis=0)
    along = GRAVITY * mean / np.linalg.norm(mean)
    shoe = np.sum((f - along) ** 2) / LIMITS.accel**2 + np.sum(w**2) / LIMITS.gyro**2
    return {
        Detector.SHOE: shoe,
        Detector.VARIANCE: np.sum((f - mean) ** 2) / LIMITS.accel**2,
        Detector.MAGNITUDE: np.sum((np.linalg.norm(f, axis=1) - GRAVITY) ** 2) / LIMITS.accel**2,
        Detector.RATE: np.sum(w**2) / LIMITS.gyro**2,
    }[detector] / len(f)


@pytest.mark.parametrize("detector", list(Detector))
@pytest.mark.parametrize("half", [0, 1, 4, 30])
def test_a_statistic_is_the_articles_formula_over_a_centred_window(samples, detector, half):
    gyro, accel = samples
    found = statistic(detector, gyro, accel, GRAVITY, LIMITS, half)
    expected = [direct(detector, gyro, accel, window) for window in windows(len(gyro), half)]
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)  # cumulative sums of 23 terms


@pytest.mark.parametrize("detector", list(Detector))
def test_a_sensor_at_rest_is_still_however_it_is_held(detector):
    down = np.array([0.6, 0.0, -0.8]) * GRAVITY
    found = statistic(detector, np.zeros((9, 3)), np.tile(down, (9, 1)), GRAVITY, LIMITS, 2)
    assert found == pytest.approx(0.0, abs=1e-9)


def test_only_a_turn_tells_a_steady_turn_from_rest():
    gyro, accel = np.full((9, 3), 0.5), np.tile([0.0, 0.0, -GRAVITY], (9, 1))
    is_still = {
        one: (statistic(one, gyro, accel, GRAVITY, LIMITS, 2) < 1).all() for one in Detector
    }
    assert is_still == {
        Detector.SHOE: False,
        Detector.RATE: False,
        Detector.VARIANCE: True,
        Detector.MAGNITUDE: True,
    }


def test_a_variance_far_from_nought_keeps_its_digits():
    values = np.array([[1e6], [1e6 + 1e-3], [1e6], [1e6 + 1e-3]])
    assert moving_variance(values, 10) == pytest.approx(0.25e-6, rel=1e-6)
