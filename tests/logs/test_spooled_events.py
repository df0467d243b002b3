"""Events in a temporary file."""

import numpy as np
import pytest

from ekf_companion.logs import spool
from ekf_companion.logs.spooled_events import SpooledEvents
from ekf_companion.nav.measurements import WIDTH, Events


def some(count: int) -> Events:
    rng = np.random.default_rng(3)
    return Events(
        t_ns=rng.integers(-(1 << 62), 1 << 62, count),
        kind=rng.integers(0, 7, count),
        values=rng.standard_normal((count, WIDTH)),
    )


@pytest.mark.parametrize("in_memory", [1 << 24, 0])
def test_events_come_back_to_the_bit_by_any_index(monkeypatch, in_memory):
    monkeypatch.setattr(spool, "IN_MEMORY", in_memory)
    events = some(1000)
    stored = SpooledEvents()
    for first in range(0, 1000, 300):
        stored.append(events.take(np.arange(first, min(first + 300, 1000))))
    assert len(stored) == 1000
    mask = events.kind == 3
    for index in (np.arange(250, 650), np.array([7, 3, 999]), np.arange(0), mask):
        found, wanted = stored.take(index), events.take(index)
        for name in ("t_ns", "kind", "values"):
            assert getattr(found, name).tobytes() == getattr(wanted, name).tobytes()
    assert stored.values.tobytes() == events.values.tobytes()
