"""The list of events whose stamps are not understood yet, against a list of Python's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ekf_companion.core.memory.scratch import VALUES
from tests.core.interpreted import load

CAPACITY = 5
Waiting = tuple[int, int, int, int]
"""Stamp, kind, first of the values, result."""

adds = st.tuples(
    st.integers(-(2**62), 2**62), st.integers(0, 6), st.integers(0, 99), st.integers(0, 7)
)
steps = st.lists(st.one_of(adds, st.integers(0, CAPACITY - 1)), max_size=40)
"""An event to add, or the place of one to remove."""


def numbers(first: int) -> np.ndarray:
    return first + np.arange(VALUES, dtype=float)


def content(held) -> list[Waiting]:
    """Return the events in their order; the last of their values must follow from the first."""
    n = held.size
    np.testing.assert_array_equal(held.values[:n, -1], held.values[:n, 0] + VALUES - 1)
    columns = (held.t_ns, held.kind, held.values[:, 0], held.result)
    return list(zip(*(column[:n].tolist() for column in columns), strict=True))


@given(steps)
def test_events_stay_in_the_order_of_their_arrival(some):
    stamps = load().stamps
    held, expected = stamps.Held(CAPACITY), []
    for step in some:
        if not isinstance(step, int):
            t_ns, kind, first, result = step
            is_taken = stamps.add(held, t_ns, kind, numbers(first), result)
            assert is_taken == (len(expected) < CAPACITY)
            if is_taken:
                expected.append(step)
        elif step < len(expected):
            stamps.remove(held, step)
            del expected[step]
        assert content(held) == expected


def test_a_full_list_takes_no_more_until_one_is_removed():
    stamps = load().stamps
    held = stamps.Held(2)
    assert stamps.add(held, 1, 0, numbers(1), 0)
    assert stamps.add(held, 2, 0, numbers(2), 0)
    assert not stamps.add(held, 3, 0, numbers(3), 0)
    stamps.remove(held, 0)
    assert stamps.add(held, 4, 0, numbers(4), 0)
    assert held.t_ns.tolist() == [2, 4]


def test_the_values_of_an_event_are_copied():
    stamps = load().stamps
    held, values = stamps.Held(1), numbers(7)
    stamps.add(held, 1, 0, values, 0)
    values[:] = 0.0
    np.testing.assert_array_equal(held.values[0], numbers(7))
