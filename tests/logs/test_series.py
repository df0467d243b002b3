import numpy as np

from ekf_companion.logs import series

SECOND = 1_000_000_000


def seconds(*values: float) -> np.ndarray:
    return np.array([round(value * SECOND) for value in values], dtype=np.int64)


def test_a_steady_clock_is_one_run():
    t_ns = np.arange(100, dtype=np.int64) * SECOND
    mask, spans = series.clock_run(t_ns)
    assert mask.all()
    assert spans == [(0, 99 * SECOND)]


def test_single_wild_stamps_are_left_out_and_the_rest_stays_whole():
    t_ns = np.arange(1000, dtype=np.int64) * SECOND
    t_ns[100], t_ns[500] = 10**17, -(10**17)
    mask, _ = series.clock_run(t_ns)
    assert np.flatnonzero(~mask).tolist() == [100, 500]


def test_after_a_reboot_the_longer_run_counts():
    first, second = np.arange(100), np.arange(300)
    t_ns = np.concatenate([first, second]).astype(np.int64) * SECOND
    mask, spans = series.clock_run(t_ns)
    assert not mask[:100].any()
    assert mask[100:].all()
    assert spans == [(0, 299 * SECOND)]


def test_a_long_gap_does_not_end_the_run():
    t_ns = np.concatenate([np.arange(100), 5000 + np.arange(100)]).astype(np.int64) * SECOND
    mask, spans = series.clock_run(t_ns)
    assert mask.all()
    assert len(spans) == 2


def test_stamps_all_over_the_place_leave_something_and_end_soon():
    t_ns = np.random.default_rng(1).integers(0, 2**62, 100_000)
    mask, _ = series.clock_run(t_ns)
    assert 0 < mask.sum() < 1000


def test_no_rows_have_no_run():
    mask, spans = series.clock_run(np.zeros(0, dtype=np.int64))
    assert len(mask) == 0
    assert spans == []


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
