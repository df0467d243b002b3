"""Where a line ends and begins anew."""

import numpy as np
import pytest

from ekf_companion.analysis.gaps import begins, broken, covers, middles, parted, thinned


def stamps(*pieces):
    """Return stamps of pieces of (begin, end, step), s."""
    return np.concatenate([np.rint(np.arange(*one) * 1e9).astype(np.int64) for one in pieces])


def test_a_line_ends_at_a_gap_and_begins_anew_behind_it():
    t_ns = stamps((0.0, 10.0, 1.0), (40.0, 50.0, 1.0))
    x, y = broken(t_ns, t_ns * 1e-9, t_ns * 1.0)
    assert np.flatnonzero(np.isnan(y)).tolist() == [10]
    assert len(x) == len(t_ns) + 1
    assert x[10] == 9.0


def test_of_a_long_flight_a_short_gap_still_ends_its_track():
    t_ns = stamps((0.0, 7200.0, 0.1), (7203.0, 14400.0, 0.1))  # thinned to one row in ten seconds
    rows, is_end = thinned(t_ns, 1500)
    (north,) = parted(is_end, t_ns[rows] * 1e-9)
    assert len(rows) < 1600
    at = np.flatnonzero(np.isnan(north)).tolist()
    assert len(at) == 1
    assert north[at[0] - 1] == pytest.approx(7199.9)
    assert north[at[0] + 1] == pytest.approx(7203.0)


def test_a_track_ends_where_it_jumped():
    t_ns = stamps((0.0, 100.0, 0.1))
    _, is_end = thinned(t_ns, 10_000, jumps_ns=[0, 50_000_000_000, 70_010_000_000, 10**15])
    assert np.flatnonzero(is_end).tolist() == [499, 700]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_what_has_hardly_a_row_has_no_gap(count):
    t_ns = np.arange(count, dtype=np.int64) * 10**12
    assert begins(t_ns).tolist() == []
    rows, is_end = thinned(t_ns, 5)
    assert len(rows) == count
    assert not is_end.any()
    assert [len(one) for one in broken(t_ns, t_ns * 1.0, t_ns * 1.0)] == [count, count]


def test_slow_rows_are_no_gaps():
    assert begins(stamps((0.0, 1000.0, 5.0))).tolist() == []


def test_a_moment_in_a_gap_is_between_two_rows_far_apart_and_no_row():
    t_ns = stamps((0.0, 10.0, 1.0), (40.0, 50.0, 1.0))
    at_ns = np.rint(np.array([-1.0, 0.5, 9.0, 9.001, 24.5, 39.999, 40.0, 49.0, 60.0]) * 1e9)
    found = covers(t_ns, at_ns.astype(np.int64))
    assert found.tolist() == [False, False, False, True, True, True, False, False, False]
    assert middles(t_ns).tolist() == [24_500_000_000]
    assert not covers(t_ns[:0], t_ns).any()
