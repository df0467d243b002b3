import numpy as np

from ekf_companion.logs import series

SECOND = 1_000_000_000


def seconds(*values: float) -> np.ndarray:
    return np.array([round(value * SECOND) for value in values], dtype=np.int64)


def test_only_rows_later_than_all_before_ascend():
    assert series.ascending(seconds(1, 2, 2, 1.5, 3)).tolist() == [True, True, False, False, True]


def test_thinning_keeps_a_series_that_is_slow_enough():
    t_ns = np.arange(100, dtype=np.int64) * SECOND // 10
    assert len(t_ns[series.thinned(t_ns, 10.0)]) == 100
    assert len(t_ns[series.thinned(t_ns, 5.0)]) == 50


def test_the_nearest_of_others_is_found_at_both_ends():
    others = seconds(1, 2, 4)
    assert series.nearest(seconds(0, 1.4, 1.6, 3.5, 9), others).tolist() == [0, 0, 1, 2, 2]
    assert series.nearest(seconds(0, 5), seconds(3)).tolist() == [0, 0]


def test_a_value_that_is_missing_twice_has_not_changed():
    nan = float("nan")
    assert series.changed([1.0, 1.0, nan, nan, 2.0]).tolist() == [True, False, True, False, True]
