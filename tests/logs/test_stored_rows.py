"""The rows of one table of a log, in memory or in a file."""

import numpy as np
import pytest

from ekf_companion.logs import stored_rows
from ekf_companion.logs.stored_rows import StoredRows

TYPE = np.dtype([("@", "<i8"), ("gyro:", "<f4"), ("name", "S3"), ("many", "<i2", (3,))])


@pytest.mark.parametrize("in_memory", [1 << 22, 0])
def test_rows_come_back_to_the_bit(monkeypatch, in_memory):
    monkeypatch.setattr(stored_rows, "IN_MEMORY", in_memory)
    monkeypatch.setattr(stored_rows, "AT_ONCE", 7)
    rows = np.frombuffer(np.random.default_rng(1).bytes(100 * TYPE.itemsize), dtype=TYPE)
    stored = StoredRows(TYPE)
    for first in range(0, 100, 30):
        stored.append(rows[first : first + 30])
    assert len(stored) == 100
    assert stored.all().tobytes() == rows.tobytes()
    assert stored.read(40, 45).tobytes() == rows[40:45].tobytes()
    assert b"".join(some.tobytes() for _, some in stored.parts()) == rows.tobytes()
    assert len(stored.read(95, 200)) == 5


def test_rows_without_columns_are_counted():
    stored = StoredRows(np.dtype([]))
    stored.append(np.empty(3, dtype=stored.dtype))
    assert len(stored) == len(stored.all()) == 3


def test_rows_are_kept_by_what_a_function_says_of_them(monkeypatch):
    monkeypatch.setattr(stored_rows, "AT_ONCE", 7)
    rows = np.zeros(100, dtype=TYPE)
    rows["@"] = np.arange(100)
    stored = StoredRows(TYPE)
    stored.append(rows)
    assert stored.kept(lambda first, some: some["@"] >= first) is stored
    even = stored.kept(lambda first, some: (first + np.arange(len(some))) % 2 == 0)
    np.testing.assert_array_equal(even.all()["@"], np.arange(0, 100, 2))
    assert len(stored.kept(lambda first, some: np.zeros(len(some), dtype=bool))) == 0
