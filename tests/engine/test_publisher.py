"""When something periodic is due."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.engine.publisher import Due
from ekf_companion.mavlink.stamp import SECOND_NS

STEPS = st.lists(
    st.tuples(st.integers(-(10**9), 10**9), st.sampled_from([None, 0.0, 1.0, 30.0])),
    min_size=1,
    max_size=40,
)


@given(STEPS)
def test_nothing_is_due_while_it_says_so(steps):
    """However stamps go and rates are turned; and outside of that span something is."""
    due, t_ns = Due(30.0), 0
    for step_ns, rate in steps:
        t_ns += step_ns
        if rate is not None:
            due.set_rate(rate)
        begin_ns, end_ns = due.idle_ns
        assert due.is_due(t_ns) == (not begin_ns <= t_ns < end_ns)


def test_what_is_due_keeps_its_rate_over_uneven_stamps():
    due = Due(10.0)
    stamps = [k * 7_000_000 for k in range(1000)]
    kept = [t for t in stamps if due.is_due(t)]
    assert abs(len(kept) - 70) <= 1
    assert all(93_000_000 <= b - a <= 107_000_000 for a, b in itertools.pairwise(kept))


@pytest.mark.parametrize("leap_ns", [-3600 * SECOND_NS, 3600 * SECOND_NS])
def test_what_is_due_follows_a_clock_that_begins_anew(leap_ns):
    due = Due(10.0)
    assert due.is_due(5_000_000_000)
    assert not due.is_due(5_050_000_000)
    assert due.is_due(5_050_000_000 + leap_ns)
    assert not due.is_due(5_100_000_000 + leap_ns)
