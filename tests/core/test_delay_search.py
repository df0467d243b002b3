"""Delays that leap by more than a slope can follow are found, both ways, and by nothing else."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import SIGMA, Status
from tests.core.flights import between, flight
from tests.core.test_hypotheses import BEGIN, pipeline

END = 75.0
FIX = 0.2
"""Between two fixes of the simulated receiver, s."""


def delayed(events: Events, later: int, until: float = END) -> Events:
    """Return a flight in which fixes are some intervals later than before, for a while."""
    values = events.values.copy()
    fixes = np.flatnonzero(events.kind == Kind.GNSS)
    late = between(events, BEGIN, until)[fixes]
    values[fixes[late]] = events.values[fixes[np.flatnonzero(late) - later]]
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize("later", [2, 4, 6])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_link_that_begins_to_buffer_is_found_and_its_end_too(later, seed):
    events, _ = flight("figure-eight", END, seed=seed)
    right = pipeline("act").run(events)
    one = pipeline("act")
    table = one.run(delayed(events, later, until=55.0))
    first = int(events.t_ns[0])
    told = [
        (1e-9 * (f.onset_ns - first), f.size[0])
        for f in one.found_faults()
        if f.kind == Fault.DELAY
    ]
    assert told[0][1] == pytest.approx(later * FIX, abs=0.1)
    assert BEGIN <= told[0][0] < BEGIN + 3.0
    assert sum(size for _, size in told) == pytest.approx(0.0, abs=0.1)
    # a second after each leap what is good is no lie, and it is good again soon
    off = np.linalg.norm(table.values[:, 3:6] - right.values[:, 3:6], axis=1)
    sigma = np.linalg.norm(table.columns(SIGMA[:3]), axis=1)
    late = np.asarray(table.stamp_ns) - first > (BEGIN + 5.0) * 1e9
    is_good = np.asarray(table.column("status")) == Status.OK
    t = (np.asarray(table.stamp_ns) - first) * 1e-9
    leapt = [(begin <= t) & (t < begin + 1.0) for begin in (BEGIN, 55.0)]
    is_good &= ~np.any(leapt, axis=0)
    assert np.all(off[is_good] < np.maximum(5.0 * sigma[is_good], 2.0))
    assert is_good[late].mean() > 0.9


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("name", ["hover", "loiter", "figure-eight"])
def test_where_none_has_leapt_none_is_found(name, seed):
    events, _ = flight(name, END, seed=seed)
    one = pipeline("act")
    one.run(events)
    assert Fault.DELAY not in [f.kind for f in one.found_faults()]
