"""One rule says which stamps belong to a clock, of one stamp and of a whole column."""

import numpy as np
import pytest

from ekf_companion.nav.stamps import BACK_US, GAP_US, LONG_US, SHORT, goes_on, least_lag, rounds

AROUND = [-BACK_US - 1, -BACK_US, -1, 0, LONG_US, LONG_US + 1, GAP_US, GAP_US + 1]


@pytest.mark.parametrize(("ahead_us", "last"), [(LONG_US, 4), (GAP_US, 6)])
def test_a_stamp_goes_on_if_it_is_a_little_late_or_not_too_far_ahead(ahead_us, last):
    expected = [1 <= place <= last for place in range(len(AROUND))]
    assert [bool(goes_on(step, ahead_us)) for step in AROUND] == expected
    assert goes_on(np.array(AROUND), ahead_us).tolist() == expected


def test_the_rounds_of_a_counter_are_found_by_a_stamp_near_to_it():
    near = [5, SHORT - 5, 20, SHORT // 2, 3 * SHORT + 7]
    reference = [SHORT - 5, SHORT + 5, 3 * SHORT - 40, 5, 3 * SHORT + 9]
    expected = [1, 0, 3, 0, 0]
    found = [rounds(one, other, SHORT, 100) for one, other in zip(near, reference, strict=True)]
    assert found == expected
    assert rounds(np.array(near), np.array(reference), SHORT, 100).tolist() == expected


def test_the_least_lag_is_that_of_what_nothing_has_delayed():
    rng, found = np.random.default_rng(2), 10**12
    for k in range(
        2000
    ):  # every 5 ms, in ns; the other clock is 50 ppm fast, and starts 7 s behind
        true = 7_000_000_000 - 250 * k
        found = least_lag(found, true + 300_000 + int(rng.exponential(2e6)), 5_000_000)
    assert abs(found - true - 300_000) < 200_000


def test_of_a_clock_that_runs_slow_the_lag_grows():
    found = 0
    for k in range(1, 1000):
        found = least_lag(found, 400 * k, 5_000_000)
    assert found == 400 * 999
