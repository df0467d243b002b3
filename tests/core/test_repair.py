"""What follows from a fault that was declared: until it ends, in one way or another."""

import numpy as np
import pytest

from ekf_companion.core.memory.bank import Bank
from ekf_companion.core.memory.enums import Fault
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import SIGMA
from tests.core.flights import between, flight
from tests.core.interpreted import load
from tests.core.states import a_state, some_parameters
from tests.core.test_hypotheses import BEGIN, METRE, pipeline

END = 75.0
STOP = 45.0
"""s."""


def sliding(events: Events, kind: Kind, column: int, slope: float) -> Events:
    """Return a flight with an error that slides for a while, and stays."""
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    mask = (events.kind == kind) & between(events, BEGIN, END)
    values = events.values.copy()
    values[mask, column] += slope * np.minimum(t[mask] - BEGIN, STOP - BEGIN)
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


@pytest.mark.parametrize(
    ("kind", "column", "slope", "halt"),
    [
        (Kind.GNSS, 0, 1.0 * METRE, Fault.HALT),
        (Kind.GNSS, 2, 0.8, Fault.HALT_HEIGHT),
        (Kind.BARO, 0, 0.8, Fault.HALT_BARO),
    ],
    ids=["position", "height", "barometer"],
)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_slide_that_stops_is_held_where_it_was(kind, column, slope, halt, seed):
    events, _ = flight("figure-eight", END, seed=seed)
    right = pipeline("act").run(events).values[-1, 3:6]
    one = pipeline("act")
    table = one.run(sliding(events, kind, column, slope))
    assert halt in [f.kind for f in one.found_faults()]
    off = table.values[-1, 3:6] - right
    assert np.all(np.abs(off) < np.maximum(3.0 * table.columns(SIGMA[:3])[-1], 1.0))


def test_a_reset_holds_no_offset_and_knows_that_it_may_be_there():
    x, b, o, k = a_state(1), Bank(), Observation(), some_parameters()
    x.gnss_offset_var[:] = [0.5, 2.0]
    b.held[:], b.drift[:] = [3.0, -4.0, 6.0, 7.0], [0.1, 0.2, 0.3, 0.4]
    load().repair.let_go(x, k, b, o)
    assert list(b.held) == [0.0, 0.0, 0.0, 7.0]
    assert list(b.drift) == [0.0, 0.0, 0.0, 0.4]
    assert list(b.let_go) == [25.0, 36.0]
    assert list(x.gnss_offset_var) == [25.5, 38.0]
    # it counts at the next fix too, and is forgotten within minutes
    x.gnss_offset_var[:] = [0.5, 2.0]
    load().fix.widen_offsets(x, b)
    assert list(x.gnss_offset_var) == [25.5, 38.0]
    x.fix_dt = 300.0
    load().repair.drive(x, b, 0, 2)
    assert b.let_go[0] < 0.2


def test_a_vertical_velocity_that_is_wild_loosens_no_level_one():
    x, b = a_state(1), Bank()
    x.gnss_vel_offset[:], x.gnss_vel_offset_var[:] = [0.02, 0.01, -5.0], [0.01, 0.01]
    load().fix.widen_offsets(x, b)
    assert list(x.gnss_vel_offset_var) == [0.01, 25.0]
