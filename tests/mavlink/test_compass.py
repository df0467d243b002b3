"""Which of several compasses is used: by the gyro, the others, and their usual differences."""

import math

import pytest

from ekf_companion.mavlink.decode.compass import Compasses

FIRST, SECOND, THIRD = 0, 1, 2
EARTH = (0.21, 0.02, 0.42)
IRON = {FIRST: (0.0, 0.0, 0.0), SECOND: (0.05, -0.1, 0.2), THIRD: (-0.02, 0.04, 0.0)}
PERIOD_NS = 100_000_000
OFF = (0.35, 0.0, 0.0)


def turned(field, yaw):
    """Return a level field in the axes of a body that has turned."""
    c, s = math.cos(yaw), math.sin(yaw)
    return c * field[0] + s * field[1], c * field[1] - s * field[0], field[2]


def plus(*vectors):
    return tuple(map(sum, zip(*vectors, strict=True)))


def used(added, *, others=(SECOND, THIRD), rate=lambda t: 0.0, seconds=40.0):
    """Return the compass in use over time, and the objects; ``added(compass, t)`` is a fault."""
    compasses, yaw, chosen = Compasses(), 0.0, []
    for k in range(round(seconds * 10.0)):
        t = k * 0.1
        yaw += 0.1 * 0.5 * (rate(t) + rate(t - 0.1))

        def field(compass, t=t, yaw=yaw):
            return plus(turned(EARTH, yaw), IRON[compass], added(compass, t))

        for other in others:
            now = compasses.compare(
                other, k * PERIOD_NS, field(other), field(FIRST), (0.0, 0.0, rate(t))
            )
            if now != compasses.used:
                compasses.use(now)
        chosen.append(compasses.used)
    return chosen, compasses


def leap(which, at=20.0, by=OFF):
    return lambda compass, t: by if compass in which and t >= at else (0.0, 0.0, 0.0)


def test_compasses_that_agree_leave_the_first_in_use_in_any_turn():
    for rate in (lambda t: 0.0, lambda t: 1.5 * math.sin(0.8 * t), lambda t: 3.0 * (t > 25.0)):
        assert set(used(leap(()), rate=rate)[0]) == {FIRST}


@pytest.mark.parametrize("rate", [lambda t: 0.0, lambda t: 0.8 * math.sin(0.5 * t)])
@pytest.mark.parametrize("others", [(SECOND, THIRD), (SECOND,), (THIRD,)])
def test_a_first_compass_that_leaps_against_the_gyro_is_left_within_half_a_second(rate, others):
    chosen, _ = used(leap((FIRST,)), rate=rate, others=others)
    assert set(chosen[:200]) == {FIRST}
    assert set(chosen[205:]) == {others[0]}


def test_another_that_leaps_is_not_gone_to_nor_two_beside_one_that_does_not():
    assert set(used(leap((SECOND,)))[0]) == {FIRST}
    assert set(used(leap((SECOND, THIRD)))[0]) == {FIRST}  # currents near both


def test_where_all_leap_alike_none_is_better():
    assert set(used(leap((FIRST, SECOND, THIRD)))[0]) == {FIRST}


def test_one_that_drifts_away_is_outvoted_by_two_and_not_by_one():
    def drift(compass, t):
        return (0.02 * max(t - 20.0, 0.0), 0.0, 0.0) if compass == FIRST else (0.0, 0.0, 0.0)

    assert used(drift)[0][-1] == SECOND
    assert used(drift, others=(SECOND,))[0][-1] == FIRST


def test_when_the_one_in_use_leaps_too_the_third_is_used():
    def both(compass, t):
        return (
            leap((FIRST,), 15.0)(compass, t)
            if compass == FIRST
            else leap((SECOND,), 30.0)(compass, t)
        )

    chosen, _ = used(both)
    assert (chosen[140], chosen[280], chosen[-1]) == (FIRST, SECOND, THIRD)


def test_its_field_is_sent_as_the_first_would_have_measured_it():
    _, compasses = used(leap((FIRST,)))
    field = plus(EARTH, IRON[SECOND])
    assert compasses.as_first(field) == pytest.approx(plus(EARTH, IRON[FIRST]), abs=1e-6)


def test_one_that_comes_and_goes_does_not_change_it_back():
    def passing(compass, t):
        return OFF if compass == FIRST and 20.0 <= t < 25.0 else (0.0, 0.0, 0.0)

    assert used(passing)[0][-1] == SECOND


def test_a_small_deviation_changes_nothing():
    assert set(used(leap((FIRST,), by=(0.05, 0.0, 0.0)))[0]) == {FIRST}
