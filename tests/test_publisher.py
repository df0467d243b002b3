"""When something periodic is due."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.publisher import Due

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
