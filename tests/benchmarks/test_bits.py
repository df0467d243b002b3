"""What ``make bits`` finds between two trees."""

import numpy as np

from benchmarks.bits.__main__ import compare
from benchmarks.bits.hashes import by_column, by_field, by_part
from ekf_companion.core.memory.overlay import as_state
from ekf_companion.core.memory.state import BLOCK, State


def test_a_result_that_differs_is_named_with_its_case():
    base = {"one": {"table.yaw": "a", "sent": "b"}, "two": {"table.yaw": "a"}}
    here = {"one": {"table.yaw": "a", "sent": "c"}, "two": {"table.yaw": "a"}}
    assert compare(base, here) == (["sent differ in one"], 1)
    assert compare(base, base) == ([], 0)


def test_what_only_one_tree_has_is_named_and_no_difference():
    base = {"one": {"table.yaw": "a", "old": "b"}, "gone": {}}
    here = {"one": {"table.yaw": "a", "new": "b"}}
    lines, wrong = compare(base, here)
    assert wrong == 0
    assert lines == [
        "new are new in one",
        "old are gone in one",
        "gone: done by one of them only",
    ]


def test_what_differs_in_the_same_cases_is_one_line():
    base = {case: {f"table.{n}": "a" for n in range(20)} for case in ("one", "two")}
    here = {case: dict.fromkeys(one, "b") for case, one in base.items()}
    lines, wrong = compare(base, here)
    assert len(lines) == 1
    assert "and 12 more differ in one, two" in lines[0]
    assert wrong == 40


def test_a_bug_differs_even_from_itself():
    lines, wrong = compare({"one": {"bug": "KeyError: 1"}}, {"one": {"bug": "KeyError: 1"}})
    assert wrong == 1
    assert "KeyError" in lines[0]


def test_one_field_of_the_state_changes_one_hash():
    blocks = np.zeros((1, BLOCK))
    before = by_field(blocks)
    as_state(blocks[0]).yaw_bank.yaw = 0.5
    after = by_field(blocks)
    assert [name for name in before if before[name] != after[name]] == ["state.yaw_bank.yaw"]
    assert len({name.split(".")[1] for name in before}) == len(State._fields_)


def test_one_column_changes_one_hash_and_no_nan_does():
    stamps, rows = np.arange(3), np.full((3, 4), np.nan)
    before = by_column("table", stamps, rows)
    other = rows.copy()
    other.view(np.uint64)[0, 0] |= 7  # another NaN
    assert by_column("table", stamps, other) == before
    other[1, 2] = 1.0
    after = by_column("table", stamps, other)
    assert sum(before[name] != after[name] for name in before) == 1
    assert len(by_column("table", stamps, rows[:, :3])) == len(before) - 1


def test_parts_of_a_status_have_hashes_of_their_own_but_for_the_clock_s():
    found = by_part("status", [{"gnss": {"fixes": 3}, "unix_ns": 5}, {"gnss": {"fixes": 4}}])
    assert list(found) == ["status.gnss"]
    assert found != by_part("status", [{"gnss": {"fixes": 3}}])
