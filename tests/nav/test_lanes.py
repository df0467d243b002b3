"""Which of several inertial units is used, and when it is left."""

import math

import numpy as np
import pytest

from ekf_companion.nav.inertial_pair import UNKNOWN
from ekf_companion.nav.inertial_unit import STEP
from ekf_companion.nav.lanes import (
    AXIS,
    CHANGED,
    CHOSEN,
    LEFT,
    SILENT,
    UNHEALTHY,
    USED,
    Lanes,
    used_rows,
)
from ekf_companion.nav.repetition import LIMITED, STUCK

NEVER = math.inf
START = 12.0
"""When a fault begins at the earliest, s."""
LEAVES = 0.2
"""Within which a unit is left, s."""


class Units:
    """Several units on one moving body, each with its own biases, noise and rate."""

    def __init__(self, seed, count=2, rate=250.0, moves=0.3, duration=16.0):
        rng = np.random.default_rng(seed)
        self.begin = START + rng.uniform(0.0, 2.0)
        """Of the fault, s."""
        phase, rates = rng.uniform(0.0, 6.28, (6, 4)), rng.uniform(0.3, 2.0, (6, 4))
        size = moves * rng.uniform(0.2, 1.0, (6, 4)) * np.array([[1.0]] * 3 + [[3.0]] * 3)
        self.t, self.values = [], []
        for number in range(count):
            t = np.arange(0.0, duration, 1.0 / rate) + 1e-3 * number
            motion = np.sin(rates[:, :, None] * t + phase[:, :, None]) * size[:, :, None]
            bias = rng.normal(0.0, 1.0, 6) * np.repeat([0.01, 0.1], 3)
            noise = rng.normal(0.0, 1.0, (len(t), 6)) * np.repeat([0.004, 0.05], 3)
            gravity = np.array([0, 0, 0, 0, 0, -9.81])
            values = motion.sum(axis=1).T + gravity + bias + noise
            self.t.append(t)
            self.values.append(values)

    def after(self, number):
        """Return which samples of a unit come after the fault's begin."""
        return self.t[number] >= self.begin

    def run(self, first=0, is_bad=None):
        """Return the lanes after all samples, and those that were used: number, stamps, values."""
        number = np.concatenate([np.full(len(t), n) for n, t in enumerate(self.t)])
        t_ns = np.rint(np.concatenate(self.t) * 1e9).astype(np.int64) + 10**9
        values = np.concatenate(self.values)
        bad = np.zeros(len(t_ns), dtype=bool)
        if is_bad is not None:
            bad[number == is_bad] = np.concatenate(self.t)[number == is_bad] >= self.begin
        order = np.argsort(t_ns, kind="stable")
        lanes = Lanes(first)
        given = number[order].astype(np.int64), t_ns[order], values[order], bad[order]
        return lanes, used_rows(lanes, *given)

    def left(self, lanes):
        """Return how long after the fault the first unit was left, s, and why."""
        if not lanes.changes:
            return NEVER, ""
        return (lanes.changes[0].t_ns - 10**9) * 1e-9 - self.begin, lanes.changes[0].why


def freeze(units, number):
    after = np.flatnonzero(units.after(number))
    units.values[number][after] = units.values[number][after[0]]


def freeze_axis(units, number):
    after = np.flatnonzero(units.after(number))
    units.values[number][after, 1] = units.values[number][after[0], 1]


def clip(units, number):
    """Pull down to the end of the range while the vehicle pulls up hard: the other reads on."""
    for each in range(len(units.t)):
        units.values[each][units.after(each), 5] -= 30.0
    units.values[number][:, 5] = np.maximum(units.values[number][:, 5], -32.0)


def step_accel(units, number):
    units.values[number][units.after(number), 3] += 1.0


def step_gyro(units, number):
    units.values[number][units.after(number), 2] -= 0.3


def shake(units, number):
    rng = np.random.default_rng(3)
    after = units.after(number)
    noise = rng.normal(0.0, 1.0, (np.count_nonzero(after), 6)) * np.repeat([0.04, 0.5], 3)
    units.values[number][after] += 10.0 * noise


def fall_silent(units, number):
    keep = ~units.after(number)
    units.t[number], units.values[number] = units.t[number][keep], units.values[number][keep]


FAULTS = {
    freeze: {STUCK},
    freeze_axis: {AXIS, LIMITED},  # a large rate that stays is the end of a range
    clip: {LIMITED, STEP},
    step_accel: {STEP},
    step_gyro: {STEP},
    shake: {STEP},
    fall_silent: {SILENT},
}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("rate", [250.0, 50.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_unit_in_use_is_left_at_once_where_it_fails(fault, count, rate, seed):
    units = Units(seed, count, rate)
    fault(units, 0)
    lanes, _ = units.run()
    after, why = units.left(lanes)
    assert 0.0 <= after <= LEAVES
    assert lanes.changes[0].left == 0
    assert why in FAULTS[fault]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_a_spare_unit_that_fails_is_not_gone_to(fault, count, seed):
    units = Units(seed, count)
    fault(units, 1)
    lanes, (_, _, used) = units.run()
    assert not lanes.changes
    np.testing.assert_array_equal(used[:, :6], units.values[0])


@pytest.mark.parametrize("moves", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_units_that_differ_as_usual_change_nothing(moves, count):
    units = Units(5, count, moves=moves, duration=40.0)
    lanes, (_, _, used) = units.run()
    assert not lanes.changes
    np.testing.assert_array_equal(used[:, :6], units.values[0])
    assert not used[:, 6:].any()


@pytest.mark.parametrize("fault", [freeze, step_accel, fall_silent])
def test_the_readings_of_the_next_unit_continue_those_before(fault):
    units = Units(1)
    fault(units, 0)
    lanes, (_, t_ns, used) = units.run()
    (change,) = lanes.changes
    difference = units.values[0][~units.after(0)] - units.values[1][~units.after(1)]
    np.testing.assert_allclose(change.offset[:3], difference.mean(axis=0)[:3], atol=5e-4)
    np.testing.assert_allclose(change.offset[3:], difference.mean(axis=0)[3:], atol=5e-3)
    # No sample is missing, none comes twice, and the first of the next says how sure that is
    assert np.diff(t_ns).min() > 0
    assert np.diff(t_ns).max() < 50e6
    (first,) = np.flatnonzero(used[:, 6:].any(axis=1))
    assert 0.0 < used[first, 6] < 0.01
    assert 0.0 < used[first, 7] < 0.1


def test_what_the_unit_that_is_left_has_done_is_told():
    units = Units(1)
    step_accel(units, 0)
    lanes, _ = units.run()
    after, _ = units.left(lanes)
    assert lanes.changes[0].std[3] == pytest.approx(1.0 * after, rel=0.6)
    assert lanes.changes[0].std[3] >= 0.9 * after


def test_nobody_knows_which_of_two_is_wrong_in_motion_and_the_biases_are_found_anew():
    units = Units(1, moves=3.0)
    units.values[0][units.after(0), 3] += 1.0
    lanes, (_, t_ns, used) = units.run()
    assert not lanes.changes
    assert lanes.doubts == 1
    (at,) = np.flatnonzero(used[:, 6:].any(axis=1))
    assert (t_ns[at] - 10**9) * 1e-9 - units.begin < 0.4
    # As uncertain as they differ, and as much as that has done since
    assert used[at, 7] == pytest.approx(1.0, rel=0.3)
    assert used[at, 9] == pytest.approx(0.2, rel=0.3)


def test_nobody_knows_which_of_two_is_wrong_that_drift_apart():
    units = Units(2, duration=40.0)
    late = units.t[0] > units.begin
    units.values[0][late, 3] += 0.2 * (units.t[0][late] - units.begin)
    lanes, _ = units.run()
    assert not lanes.changes


def test_of_three_the_one_that_drifts_is_left():
    units = Units(2, count=3, duration=40.0)
    late = units.t[0] > units.begin
    units.values[0][late, 3] += 0.2 * (units.t[0][late] - units.begin)
    lanes, _ = units.run()
    assert lanes.changes[0].why == STEP


def test_two_that_fail_together_are_not_gone_between():
    units = Units(1)
    freeze(units, 0)
    freeze(units, 1)
    lanes, _ = units.run()
    assert len(lanes.changes) <= 1


def test_a_unit_that_comes_back_is_gone_to_only_for_the_same_reason():
    units = Units(1, duration=40.0)
    kept = ~((units.t[0] >= units.begin) & (units.t[0] < units.begin + 3.0))
    units.t[0], units.values[0] = units.t[0][kept], units.values[0][kept]
    late = units.t[1] >= 35.0
    units.values[1][late] = units.values[1][late][0]
    lanes, _ = units.run()
    assert [(one.left, one.used, one.why) for one in lanes.changes] == [
        (0, 1, SILENT),
        (1, 0, STUCK),
    ]
    # the readings are the first unit's own again
    np.testing.assert_allclose(lanes.offset[:3], 0.0, atol=2e-3)
    np.testing.assert_allclose(lanes.offset[3:], 0.0, atol=2e-2)


def test_the_autopilots_own_word_and_its_choice_are_followed():
    units = Units(1)
    lanes, _ = units.run(is_bad=0)
    assert units.left(lanes) == (pytest.approx(0.0, abs=0.02), UNHEALTHY)
    lanes = Lanes(0)
    for n, (t, other) in enumerate(zip(*units.t, strict=True)):
        if t > 5.0 and not lanes.changes:
            lanes.want(1)
        lanes.add(0, round(t * 1e9), *units.values[0][n])
        lanes.add(1, round(other * 1e9), *units.values[1][n])
    assert [one.why for one in lanes.changes] == [CHOSEN]
    assert lanes.used == 1


def test_a_slow_unit_is_not_gone_to():
    units = Units(1)
    units.t[1], units.values[1] = units.t[1][::25], units.values[1][::25]
    freeze(units, 0)
    lanes, _ = units.run()
    assert not lanes.changes


@pytest.mark.parametrize("late", [0.0, 0.05])
@pytest.mark.parametrize("scale", [1.0, 1.05])
def test_a_unit_that_is_late_or_of_another_scale_is_no_fault(late, scale):
    units = Units(4, moves=1.0, duration=60.0)
    units.t[1] = units.t[1] + late
    units.values[1] = scale * units.values[1]
    lanes, _ = units.run()
    assert not lanes.changes


def test_a_clock_that_begins_anew_is_gone_on_by():
    units = Units(1, duration=6.0)
    lanes = Lanes(0)
    for start in (100.0, 1.0):
        for n, t in enumerate(units.t[0]):
            assert lanes.add(0, round((start + t) * 1e9), *units.values[0][n]) == USED
            assert lanes.add(1, round((start + t) * 1e9), *units.values[1][n]) == LEFT
    assert lanes.knows(1)


def test_a_frozen_unit_is_left_though_nothing_of_the_other_is_known_yet():
    units = Units(1)
    lanes = Lanes(0)
    became = set()
    for n in range(400):
        values = units.values[0][min(n, 300)]
        became.add(lanes.add(0, round(units.t[0][n] * 1e9), *values))
        if n > 270:
            lanes.add(1, round(units.t[1][n] * 1e9), *units.values[1][n])
    assert CHANGED in became
    assert lanes.changes[0].std[:2] == (UNKNOWN, UNKNOWN)


def test_a_unit_with_gaps_does_not_keep_the_others_from_being_compared():
    units = Units(1, count=3)
    gaps = (np.arange(len(units.t[2])) % 100) < 30  # 0.28 s without a sample, 40 % of the time
    units.t[2], units.values[2] = units.t[2][gaps], units.values[2][gaps]
    step_accel(units, 0)
    lanes, _ = units.run()
    after, why = units.left(lanes)
    assert 0.0 <= after <= LEAVES
    assert why == STEP


def test_no_more_than_four_units_are_watched():
    units = Units(1, count=6, duration=3.0)
    units.begin = NEVER
    lanes, _ = units.run()
    assert [one.number for one in lanes.units] == [0, 1, 2, 3]


def test_a_unit_whose_gyro_falls_to_0_on_all_axes_is_left():
    units = Units(3)
    units.values[0][units.after(0), :3] = 0.0
    lanes, _ = units.run()
    after, why = units.left(lanes)
    assert after < LEAVES
    assert why in (AXIS, STUCK, STEP)
