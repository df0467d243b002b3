"""Samples of a sensor that hangs or is at the end of its range, and samples that repeat for other
reasons."""

import math

import numpy as np
import pytest

from ekf_companion.nav.repetition import AXIS, LIMITED, MEASURED, SPIKE, STUCK, Repetition

PERIOD_US = 4000
STILL = (0.0, 0.0, 0.0, 0.0, 0.0, -9.80665)
TURNING = (0.1, -0.3, 1.2, 0.5, -2.0, -11.4)


def noisy(count, seed=1, mean=TURNING):
    rng = np.random.default_rng(seed)
    return [tuple(row) for row in (mean + 0.01 * rng.standard_normal((count, 6))).tolist()]


def judge(samples, repetition=None):
    repetition = repetition or Repetition()
    return [repetition.judge(PERIOD_US * (n + 1), one) for n, one in enumerate(samples)]


def test_noise_measures_something():
    assert set(judge(noisy(20_000))) == {None}


@pytest.mark.parametrize("mean", [TURNING, STILL])
def test_a_sensor_that_hangs_is_found_within_a_few_samples_and_believed_when_it_speaks(mean):
    before = noisy(2000, mean=mean)
    found = judge([*before, *[before[-1]] * 500, *noisy(100, seed=2)])
    assert set(found[:2003]) == {None}
    assert set(found[2008:2500]) == {STUCK}
    assert set(found[2500:]) == {None}


def test_an_axis_at_the_end_of_its_range_is_found():
    cut = [(gx, gy, 0.5, ax, ay, az) for gx, gy, _, ax, ay, az in noisy(300, seed=2)]
    found = judge([*noisy(2000), *cut, *noisy(100, seed=3)])
    assert set(found[2010:2300]) == {LIMITED}
    assert set(found[2300:]) == {None}


def test_a_simulator_without_noise_is_believed():
    """It stands, and turns evenly, for as long as it likes."""
    assert set(judge([STILL] * 3000 + [TURNING] * 3000)) == {None}


def test_an_axis_that_never_says_anything_does_not_silence_the_others():
    flat = [(gx, gy, 0.0, ax, ay, az) for gx, gy, _, ax, ay, az in noisy(5000)]
    assert set(judge(flat)) == {None}


def test_whole_numbers_in_disguise_are_believed():
    rng = np.random.default_rng(1)
    coarse = np.round(rng.normal((0, 0, 200, 0, 0, -1000), 0.4, size=(20_000, 6)))
    assert set(judge([tuple(row) for row in coarse.tolist()])) == {None}


def test_a_noiseless_vehicle_that_lands_is_believed_after_five_seconds():
    found = judge([*noisy(5000), *[STILL] * 3000])
    assert set(found[5010:6200]) == {STUCK}
    assert set(found[6300:]) == {None}


def test_how_likely_it_is_that_each_axis_measures_falls_with_a_run():
    repetition = Repetition()
    judge(noisy(2000), repetition)
    assert repetition.chance() == 0.0
    last = noisy(2000)[-1]
    found = []
    for n in range(4):
        repetition.judge(PERIOD_US * (2001 + n), (*noisy(4, seed=5)[n][:5], last[5]))
        found.append(repetition.chance())
    # of two thousand none was repeated by chance
    assert found == pytest.approx([-n * math.log(2000.0) for n in range(1, 5)], rel=0.01)


def turning(count, axes, begin=0, value=0.0, digits=None, seed=1, rate=0.5):
    """Return samples of a vehicle that turns while axes say the same from a row on."""
    t = np.arange(count) * 0.01
    samples = np.array(noisy(count, seed=seed, mean=STILL))
    samples[:, :3] += rate * np.sin(np.outer(t, (2.0, 2.3, 1.7)))
    samples[begin:, axes] = value
    return [tuple(row) for row in (samples if digits is None else samples.round(digits)).tolist()]


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("begin", [0, 1, 1500])
@pytest.mark.parametrize("value", [0.0, 0.02])
def test_an_axis_that_is_stuck_near_0_is_named_while_the_others_turn(axis, begin, value):
    found = judge(turning(4000, axis, begin, value))
    assert set(found[:begin]) <= {None}
    assert set(found[begin + 400 :]) == {AXIS}
    assert AXIS in MEASURED


def test_an_axis_that_speaks_again_is_believed():
    before, after = turning(2000, 2, 1500), turning(2000, 2, 2000, seed=2)
    assert set(judge([*before, *after])[2000:]) == {None}


@pytest.mark.parametrize("digits", [None, 3, 2])
def test_a_vehicle_that_lands_and_stands_has_no_axis_that_is_stuck(digits):
    """With coarse digits an axis says the same then, from the last of the landing on."""
    flight = turning(3000, 2, 3000, digits=digits)
    rng = np.random.default_rng(5)
    rest = STILL + rng.normal(0.0, (2e-4, 4e-4, 1e-5, 0.01, 0.01, 0.01), (6000, 6))
    rest = rest if digits is None else rest.round(digits)
    assert set(judge([*flight, *map(tuple, rest.tolist())])) <= {None}


def field_after(rows):
    """Return the field in the body after turns by the rates of samples, 0.01 s each."""
    pitch, roll = np.cumsum(np.array(rows)[:, 1]) * 0.01, np.cumsum(np.array(rows)[:, 0]) * 0.01
    north, down = 0.2, 0.44
    across = north * np.sin(pitch) + down * np.cos(pitch)
    return np.stack(
        [
            north * np.cos(pitch) - down * np.sin(pitch),
            across * np.sin(roll),
            across * np.cos(roll),
        ],
        axis=1,
    )


def judge_with_field(samples, fields):
    repetition, found = Repetition(), []
    for n, (one, field) in enumerate(zip(samples, fields.tolist(), strict=True)):
        repetition.see(*field)
        found.append(repetition.judge(PERIOD_US * (n + 1), one))
    return found


@pytest.mark.parametrize("begin", [0, 1, 1500])
@pytest.mark.parametrize("value", [0.0, 0.02])
def test_a_gyro_that_is_stuck_near_0_on_all_axes_is_found_by_the_field(begin, value):
    fields = field_after(turning(4000, [], rate=1.0))
    found = judge_with_field(turning(4000, [0, 1, 2], begin, value), fields)
    assert set(found[:begin]) <= {None}
    assert set(found[begin + 400 :]) == {STUCK}
    again = judge_with_field([*turning(2000, [0, 1, 2]), *turning(2000, [])], fields)
    assert set(again[2001:]) == {None}


def test_a_field_that_is_disturbed_at_rest_makes_no_gyro_stuck():
    """Three digits, and a current that adds as much as motors do."""
    flight = turning(2000, [], digits=3)
    rest = np.random.default_rng(5).normal(STILL, (1e-4, 1e-4, 1e-4, 0.01, 0.01, 0.01), (4000, 6))
    fields = np.vstack([field_after(flight), np.tile(field_after(flight)[-1], (4000, 1))])
    fields[4000:] += (0.12, 0.0, 0.12)
    found = judge_with_field([*flight, *map(tuple, rest.round(3).tolist())], fields)
    assert set(found) == {None}


@pytest.mark.parametrize("axes", [[0, 1], [1, 2], [0, 2], [0, 1, 2]])
@pytest.mark.parametrize("begin", [0, 1500])
def test_axes_of_a_gyro_that_are_stuck_are_found_by_the_vehicles_vibration(axes, begin):
    samples = np.array(turning(4000, axes, begin))
    samples[:, 3:] += np.random.default_rng(2).normal(0.0, 1.0, (4000, 3))
    found = judge([tuple(row) for row in samples.tolist()])
    assert set(found[:begin]) <= {None}
    assert set(found[begin + 400 :]) == {STUCK if len(axes) == 3 else AXIS}


@pytest.mark.parametrize("axes", [[0, 1], [1, 2], [0, 2]])
def test_two_axes_that_fall_silent_while_the_third_turns_are_stuck(axes):
    assert set(judge(turning(4000, axes, 1500))[1900:]) == {AXIS}


def test_an_accelerometer_that_is_stuck_near_0_on_all_axes_while_the_gyro_turns_is_stuck():
    for begin in (0, 1500):
        assert set(judge(turning(4000, [3, 4, 5], begin))[begin + 400 :]) == {STUCK}


def test_a_vehicle_that_goes_straight_without_noise_has_no_gyro_that_is_stuck():
    t = np.arange(4000) * 0.01
    rows = np.zeros((4000, 6))
    rows[:, 3], rows[:, 5] = 3.0 * np.sin(t), -9.80665
    assert set(judge([tuple(row) for row in rows.tolist()])) == {None}


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("value", [32.767, -32.768, 15.0])
def test_a_rate_that_leaps_and_comes_back_was_not_measured(count, value):
    samples = noisy(1000, mean=STILL)
    for begin in range(100, 1000, 100):
        for n in range(begin, begin + count):
            samples[n] = (samples[n][0], value, *samples[n][2:])
    found = judge(samples)
    assert [n for n, one in enumerate(found) if one == SPIKE] == [
        n for begin in range(100, 1000, 100) for n in range(begin, begin + count)
    ]
    assert set(found) == {None, SPIKE}


def test_a_rate_that_leaps_and_goes_on_costs_one_sample():
    before, after = (
        noisy(500, mean=STILL),
        noisy(500, seed=2, mean=(25.0, 0.0, 0.0, 0.0, 0.0, -9.8)),
    )
    found = judge([*before, *after, *before])
    assert [n for n, one in enumerate(found) if one is not None] == [500, 1000]
    # Without noise, five
    flat = judge([*before, *[after[0]] * 4, after[0], *after])
    assert flat[500:505] == [SPIKE] * 4 + [None]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_log_that_begins_with_spikes_loses_those_alone(count):
    samples = noisy(100, mean=STILL)
    for n in range(count):
        samples[n] = (32.767, *samples[n][1:])
    assert judge(samples)[:5] == [SPIKE] * count + [None] * (5 - count)


@pytest.mark.parametrize("axis", [3, 4, 5])
def test_a_force_that_leaps_and_comes_back_was_not_measured(axis):
    samples = noisy(100, mean=STILL)
    for n in (40, 41, 70):
        samples[n] = (*samples[n][:axis], 321.33, *samples[n][axis + 1 :])
    assert [n for n, one in enumerate(judge(samples)) if one == SPIKE] == [40, 41, 70]


def test_a_vehicle_in_a_plane_has_no_axis_that_is_stuck():
    t = np.arange(4000) * 0.01
    rows = np.zeros((4000, 6))
    rows[:, 2], rows[:, 3], rows[:, 5] = np.sin(t), np.cos(t), -9.80665
    assert set(judge([tuple(row) for row in rows.tolist()])) == {None}
