"""Events of several sources, merged part by part."""

import numpy as np
import pytest

from ekf_companion.nav import event_columns
from ekf_companion.nav.event_columns import EventColumns, EventSource, MergedEvents, merged
from ekf_companion.nav.measurements import Kind

KINDS = (Kind.IMU, Kind.MAG, Kind.BARO, Kind.GNSS)


def sources(arrivals, rng):
    """Return sources whose rows have an event where a mask says so, and the events of all."""
    found, whole = [], []
    for kind, arrival in zip(KINDS, arrivals, strict=False):
        values, has = rng.standard_normal(len(arrival)), rng.random(len(arrival)) < 0.8

        def read(first, end, kind=kind, arrival=arrival, values=values, has=has):
            rows = slice(first, end)
            kept = EventColumns(arrival[rows], kind, values[rows], 0.5).take(has[rows])
            return [(kept, arrival[rows][has[rows]])] if has[rows].any() else []

        found.append(EventSource(len(arrival), read))
        whole += read(0, len(arrival))
    return found, merged(whole)


def ascending(rng, count):
    return np.sort(rng.integers(0, 500, count))


def swapped(rng, count):
    return ascending(rng, count) + rng.integers(-20, 20, count)


def shuffled(rng, count):
    return rng.integers(0, 500, count)


def frozen(rng, count):
    return np.full(count, 7)


@pytest.mark.parametrize("order", [ascending, swapped, shuffled, frozen])
@pytest.mark.parametrize("part", [1, 7, 64, 1 << 14])
@pytest.mark.parametrize("seed", range(3))
def test_the_order_is_that_of_a_stable_sort_of_all(monkeypatch, order, part, seed):
    monkeypatch.setattr(event_columns, "PART", part)
    rng = np.random.default_rng(seed)
    found, whole = sources([order(rng, count) for count in (400, 90, 31, 1)], rng)
    events = MergedEvents(found)
    assert len(events) == len(whole)
    first = 0
    while first < len(whole):
        index = np.arange(first, min(first + int(rng.integers(1, 150)), len(whole)))
        some, wanted = events.take(index), whole.take(index)
        first += len(index)
        np.testing.assert_array_equal(some.t_ns, wanted.t_ns)
        np.testing.assert_array_equal(some.kind, wanted.kind)
        np.testing.assert_array_equal(some.values, wanted.values)
    np.testing.assert_array_equal(events.values, whole.values)


def test_few_rows_of_a_long_source_are_read_at_once():
    count, most = 200_000, 0

    def read(first, end):
        nonlocal most
        most = max(most, end - first)
        rows = np.arange(first, end)
        return [(EventColumns(rows, Kind.IMU, rows), rows)]

    events = MergedEvents([EventSource(count, read)])
    np.testing.assert_array_equal(
        events.take(np.arange(150_000, 170_000)).t_ns[[0, -1]], [150_000, 169_999]
    )
    assert most <= event_columns.PART


def test_without_a_source_there_are_no_events():
    assert len(MergedEvents([])) == 0
    assert len(MergedEvents([]).values) == 0
