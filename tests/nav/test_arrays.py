import numpy as np

from ekf_companion.nav.arrays import known_rows, median, runs


def test_runs_are_half_open():
    assert runs(np.array([True, False, True, True])) == [(0, 1), (2, 4)]
    assert runs(np.zeros(3, dtype=bool)) == []


def test_a_known_row_is_finite_in_every_column():
    rows = np.array([[1.0, 2.0], [np.nan, 0.0], [0.0, np.inf]])
    assert known_rows(rows).tolist() == [True, False, False]


def test_the_median_is_that_of_numpy():
    rng = np.random.default_rng(3)
    for values in (rng.standard_normal(7), rng.standard_normal(8), rng.integers(0, 9, 100), [2.0]):
        assert median(values) == np.median(values)
