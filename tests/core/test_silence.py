"""Axes of the inertial sensor that do not measure: at the end of their range, or stuck."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.core.memory.scratch import ImuRow
from ekf_companion.core.memory.state import State
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.repetition import CHANCE
from ekf_companion.nav.state import Status
from tests.core.flights import between, flight
from tests.core.interpreted import load

NOISE = np.repeat([2e-3, 3e-2], 3)
TURNING = np.array([0.3, -0.2, 0.4, 0.0, 0.0, -9.8])
"""rad/s, m/s^2."""
FOUND = 8
"""Equal readings in a row that are no chance, of those that never were."""


def readings(count: int, motion: np.ndarray = TURNING, seed: int = 1) -> np.ndarray:
    """Return rates and forces with noise, shape (n, 6)."""
    return motion + NOISE * np.random.default_rng(seed).standard_normal((count, 6))


def unmeasured(samples: np.ndarray, accel: float = 0.0) -> np.ndarray:
    """Return the variance by the second of each axis after each sample, shape (n, 6)."""
    x, imu, silence = State(), ImuRow(), load().silence
    x.accel_n[0] = accel
    found = []
    for sample in samples:
        imu.gyro[:], imu.accel[:] = sample[:3], sample[3:]
        silence.find_unmeasured(x, imu)
        assert silence.is_measured(x) == (not any(x.unmeasured))
        x.gyro[:], x.accel[:] = sample[:3], sample[3:]
        found.append(list(x.unmeasured))
    return np.array(found)


def stuck(samples: np.ndarray, axis: int, begin: int, end: int) -> np.ndarray:
    """Let an axis repeat one of its readings."""
    held = samples.copy()
    held[begin:end, axis] = samples[begin, axis]
    return held


def test_what_is_no_chance_is_so_to_the_filter_and_to_those_who_choose_a_unit():
    assert pytest.approx(CHANCE, abs=0.1) == load().silence.CHANCE


@pytest.mark.parametrize("digits", [9, 3], ids=["float", "in milliradians"])
def test_all_axes_measure_as_long_as_their_readings_differ(digits):
    assert not unmeasured(readings(3000).round(digits)).any()


@pytest.mark.parametrize("axis", range(6))
def test_an_axis_that_repeats_itself_has_what_the_vehicle_moves_by(axis):
    found = unmeasured(stuck(readings(1200), axis, 500, 900), accel=2.0)
    expected = TURNING[:3] @ TURNING[:3] if axis < 3 else 2.0**2
    np.testing.assert_allclose(found[500 + FOUND : 900, axis], expected, rtol=0.1)
    assert not np.delete(found, axis, 1).any()
    assert not found[:500].any()
    assert not found[900:].any()


def test_it_may_stick_again_and_again():
    samples = readings(3000)
    for begin in range(500, 3000, 100):
        samples = stuck(samples, 1, begin, begin + 30)
    found = unmeasured(samples)[500:, 1].reshape(-1, 100)
    assert found[:, FOUND:30].all()
    assert not found[:, 30:].any()


def test_a_dead_axis_does_not_measure_for_ever():
    samples = readings(6000)
    samples[500:, 0] = 0.0
    assert unmeasured(samples)[500 + FOUND :, 0].all()


def test_the_whole_gyro_is_found_by_the_accelerometer_that_goes_on():
    samples = readings(1000)
    samples[500:, :3] = samples[500, :3]
    assert unmeasured(samples)[540:, :3].all()


def test_the_digits_of_a_vehicle_at_rest_cost_nothing():
    flown = readings(2000)
    rest = 0.1 * (readings(3000, seed=2) - TURNING)
    samples = np.concatenate([flown, rest]).round(3)
    share = np.mean(samples[2001:, :3] == samples[2000:-1, :3])
    assert share > 0.8  # they do repeat
    assert unmeasured(samples).max() < 1e-5  # 0.2 deg in a second, were it so all the time


def test_a_simulated_vehicle_in_a_plane_turns_about_one_axis():
    samples = readings(3000)
    samples[:, [0, 1]] = 0.0
    assert not unmeasured(samples).any()


def test_the_end_of_a_range_is_the_largest_reading_again():
    samples = readings(600)
    samples[:, 2] += 2.0 * np.sin(np.arange(600) / 20)
    samples[:, 5] -= 9.0 * np.sin(np.arange(600) / 20)
    ranged = samples.clip([-2.0] * 3 + [-16.0] * 3, [2.0] * 3 + [16.0] * 3)
    is_at_end = ranged != samples
    is_again = np.zeros_like(is_at_end)
    is_again[1:] = is_at_end[1:] & is_at_end[:-1]
    found = unmeasured(ranged)
    assert is_again[:, 2].any()
    assert is_again[:, 5].any()
    assert np.array_equal(found > 0.0, is_again)


@pytest.mark.parametrize("mode", ["off", "act"])
@pytest.mark.parametrize(("axis", "seconds"), [(0, 6.0), (2, 10.0), (3, 6.0)])
def test_a_flight_with_a_stuck_axis_knows_how_far_it_is_off(axis, seconds, mode):
    events, truth = flight("figure-eight", 90.0)
    values, is_held = events.values.copy(), between(events, 45.0, 45.0 + seconds)
    is_held &= events.kind == Kind.IMU
    values[is_held, axis] = values[is_held, axis][0]
    held = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    table = Pipeline(replace(Config(), weigh_faults=mode)).run(held)
    at = np.searchsorted(truth.att_t_ns, table.stamp_ns).clip(0, len(truth.q_nb) - 1)
    q_nb = np.stack([table.column(f"q_{part}") for part in "wxyz"], axis=1)
    down = np.array([0.0, 0.0, 1.0])
    found, right = (so3.rotate(so3.conjugate(q), down) for q in (q_nb, truth.q_nb[at]))
    tilt = np.linalg.norm(np.cross(found, right), axis=1)
    sigma = np.hypot(table.column("sd_roll"), table.column("sd_pitch"))
    is_wrong = (tilt > 5.0 * sigma) & (tilt > np.radians(2.0))
    assert not is_wrong[table.column("status") == Status.OK].any()
    assert tilt[table.stamp_ns > table.stamp_ns[-1] - 10e9].max() < np.radians(2.0)
