"""The autopilot's own position (GLOBAL_POSITION_INT), beside a receiver and without one."""

import numpy as np

from ekf_companion.core.field import FLAGS
from ekf_companion.core.settings import FilterSettings, GnssSettings
from ekf_companion.nav.measurements import Events, GnssFlag, Kind, merge
from ekf_companion.nav.state import COLUMNS, GEODETIC, Status
from tests.core.flights import between, flight, without
from tests.engine.estimation import KNOWN, run, statuses

METRE = 1.0 / 6.367e6
"""Of latitude, rad."""
OUTAGE = (30.0, 60.0)


def is_fix(events: Events) -> np.ndarray:
    return events.kind == Kind.GNSS


def dead_reckoning(events: Events, speed: float) -> Events:
    """Return the autopilot's own position beside each fix; in the outage it drifts north."""
    fixes = events.take(np.flatnonzero(is_fix(events)))
    values = fixes.values.copy()
    t = (fixes.t_ns - events.t_ns[0]) * 1e-9
    values[:, 0] += speed * np.clip(t - OUTAGE[0], 0.0, OUTAGE[1] - OUTAGE[0]) * METRE
    values[:, FLAGS] = GnssFlag.DERIVED
    return Events(t_ns=fixes.t_ns + 1_000_000, kind=fixes.kind, values=values)


def test_an_outage_is_dead_reckoning_whatever_position_the_autopilot_reports():
    """PX4 drifts by 79 m in 30 s, and its position says nothing of it."""
    events, _ = flight("figure-eight", duration=80.0)
    ours = events.take(~(between(events, *OUTAGE) & is_fix(events)))
    alone, _ = run(ours)
    beside, pipeline = run(merge(ours, dead_reckoning(events, 79.0 / 30.0)))
    # an event that is not used still divides the interval over which the covariance is carried on
    for name in ("pos_n", "pos_e", "pos_d"):
        apart = np.abs(beside.column(name) - alone.column(name)) / alone.column(f"sd_{name}")
        assert np.nanmax(apart) < 1e-3
    placed = [COLUMNS.index(name) - 1 for name in (*GEODETIC, "pos_n", "pos_e", "pos_d")]
    rest = [np.delete(table.values, placed, axis=1) for table in (beside, alone)]
    assert np.allclose(*rest, rtol=0.0, atol=1e-3, equal_nan=True)
    assert Status.DEAD_RECKONING in statuses(beside)
    assert not pipeline.health().is_position_autopilots


def test_without_a_receiver_it_is_used_and_called_degraded():
    events, _ = flight("figure-eight", duration=40.0)
    own = merge(without(events, Kind.GNSS), dead_reckoning(events, 0.0))
    table, pipeline = run(own)
    assert statuses(table)[-1] == Status.DEGRADED
    assert Status.OK not in statuses(table)
    assert pipeline.health().is_position_autopilots


def test_where_it_is_the_configured_source_the_status_is_degraded_at_best():
    events, _ = flight("figure-eight", duration=40.0)
    both = merge(events, dead_reckoning(events, 0.0))
    settings = FilterSettings(gnss=GnssSettings(source="global", delay=KNOWN.gnss.delay))
    assert Status.OK not in statuses(run(both, settings)[0])
    assert Status.OK in statuses(run(both)[0])
