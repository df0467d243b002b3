"""A block that stands in a log twice counts once; two flights with the same stamps are two."""

import numpy as np
import pytest

from ekf_companion.logs.repeats import KEPT, Repeats, goes_back, note

SECOND = 1_000_000_000
T_NS = np.arange(1, 3001, dtype=np.int64) * SECOND // 100
ROWS = np.column_stack([T_NS * 1e-9, np.random.default_rng(1).normal(size=(3000, 6))])


def found(order, rows=ROWS, parts=1):
    """Return which rows of a log in this order are copies."""
    repeats, order = Repeats(), np.asarray(order)
    taken = [repeats.take(T_NS[one], rows[one]) for one in np.array_split(order, parts)]
    assert repeats.count == np.concatenate(taken).sum()
    return np.flatnonzero(np.concatenate(taken)).tolist()


@pytest.mark.parametrize("parts", [1, 2, 7, 50])
@pytest.mark.parametrize(("begin", "end"), [(0, 3000), (500, 1000), (1000, 1400), (1700, 2000)])
def test_a_copied_block_is_found_however_the_log_is_read(begin, end, parts):
    after = max(end, 2000)
    order = [*range(after), *range(begin, end), *range(after, 3000)]
    assert found(order, parts=parts) == [*range(after, after + end - begin)]


def test_a_block_that_is_copied_twice_is_found_twice():
    assert found([*range(2000), *range(1000), *range(1000), *range(2000, 3000)]) == [
        *range(2000, 4000)
    ]


def test_a_copy_that_is_damaged_or_lacks_rows_is_one_but_for_these():
    rows = np.concatenate([ROWS, ROWS[1000:2000]])
    rows[3500, 3] += 1.0
    keep = np.delete(np.arange(4000), [3100, 3900])
    t_ns = np.concatenate([T_NS, T_NS[1000:2000]])
    found = Repeats().take(t_ns[keep], rows[keep])
    assert found.sum() == 997
    assert not found[:3000].any()


def test_rows_that_are_late_or_of_another_flight_are_no_copies():
    assert found([*range(1000), *range(900, 3000)]) == []  # a second: packets that came twice
    other = ROWS.copy()
    other[:, 1] += 1e-9
    repeats = Repeats()
    assert not repeats.take(T_NS, ROWS).any()
    assert not repeats.take(T_NS, other).any()


@pytest.mark.parametrize("parts", [1, 2, 7, 50])
def test_packets_that_came_twice_are_no_copies_beside_a_block_that_is_one(parts):
    order = [*range(1000), *range(900, 2000), *range(500, 1000), *range(1900, 3000)]
    assert found(order, parts=parts) == [*range(2100, 2700)]


def test_rows_without_a_time_are_no_copies_of_each_other():
    t_ns = T_NS.copy()
    t_ns[500::100] = 0
    assert not Repeats().take(t_ns, t_ns[:, None]).any()


def test_records_and_numbers_that_are_not_known_are_compared_by_their_bytes():
    rows = np.zeros(3000, dtype=[("t", "<i8"), ("id", "u1"), ("x", "<f4")])
    rows["t"], rows["x"] = T_NS, np.nan
    assert found([*range(3000), *range(3000)], rows) == [*range(3000, 6000)]


def test_no_more_than_the_last_rows_are_remembered():
    repeats = Repeats()
    for first in range(0, KEPT + 3000, 3000):
        t_ns = T_NS + first * SECOND
        repeats.take(t_ns, t_ns[:, None])
    assert repeats.take(t_ns, t_ns[:, None]).all()
    assert not repeats.take(T_NS, T_NS[:, None]).any()


def test_stamps_go_back_within_a_part_or_between_two():
    assert not goes_back([T_NS[:100], T_NS[100:], T_NS[:0]])
    assert goes_back([T_NS, T_NS])
    assert goes_back([np.append(T_NS, T_NS)])


def test_the_note_counts_them():
    assert note(0) == []
    assert note(1) == ["1 row repeats an earlier one to the bit, and counts once"]
    assert note(2) == ["2 rows repeat earlier ones to the bit, and count once"]
