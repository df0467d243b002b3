"""The autopilot's own position (GLOBAL_POSITION_INT), beside a receiver and without one."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.nav.measurements import GNSS_FLAGS, Events, GnssFlag, Kind, merge
from ekf_companion.nav.state import COLUMNS, GEODETIC, Status
from tests.core.flights import between, flight, without
from tests.engine.estimation import KNOWN, errors, run, statuses

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
    values[:, GNSS_FLAGS] = GnssFlag.DERIVED
    return Events(t_ns=fixes.t_ns + 1_000_000, kind=fixes.kind, values=values)


@pytest.mark.parametrize(("weigh", "settled"), [("off", 0.0), ("act", 20.0)])
def test_an_outage_is_dead_reckoning_whatever_position_the_autopilot_reports(weigh, settled):
    """PX4 drifts by 79 m in 30 s, and its position says nothing of it.

    While the hypotheses know little, what divides an interval moves their odds by millimetres.
    """
    settings = replace(KNOWN, weigh_faults=weigh)
    events, _ = flight("figure-eight", duration=80.0)
    ours = events.take(~(between(events, *OUTAGE) & is_fix(events)))
    alone, _ = run(ours, settings)
    beside, pipeline = run(merge(ours, dead_reckoning(events, 79.0 / 30.0)), settings)
    # an event that is not used still divides the interval over which the covariance is carried on
    for name in ("pos_n", "pos_e", "pos_d"):
        apart = np.abs(beside.column(name) - alone.column(name)) / alone.column(f"sd_{name}")
        assert np.nanmax(apart) < 1e-3
    placed = [COLUMNS.index(name) - 1 for name in (*GEODETIC, "pos_n", "pos_e", "pos_d")]
    late = alone.stamp_ns >= alone.stamp_ns[0] + settled * 1e9
    rest = [np.delete(table.values, placed, axis=1)[late] for table in (beside, alone)]
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


def derived_until(events: Events, end: float, north: float = 0.0, place=None) -> Events:
    """Return a flight without fixes until a time, and the autopilot's own position instead."""
    fixes = events.take(np.flatnonzero(is_fix(events) & between(events, 0.0, end)))
    values = fixes.values.copy()
    values[:, 0] += north * METRE
    if place is not None:
        values[:, :2] = np.radians(place)
    values[:, GNSS_FLAGS] = GnssFlag.DERIVED
    values[:, 6:8] = 4.0
    early = Events(t_ns=fixes.t_ns, kind=fixes.kind, values=values)
    return merge(events.take(~(is_fix(events) & between(events, 0.0, end))), early)


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.001, -0.002), (-0.4, 0.7)])
def test_a_position_near_where_none_is_is_none(place):
    """ArduPilot's fallback begins at 0, 0 and is moved by the wind that it assumes."""
    events, _ = flight("figure-eight", duration=30.0)
    table, pipeline = run(derived_until(events, 15.0, place=place))
    assert np.degrees(pipeline.origin[0]) == pytest.approx(47.4, abs=0.1)
    assert pipeline.resets == 0
    assert np.hypot(table.column("pos_n"), table.column("pos_e"))[-1] < 200.0


def test_a_receiver_may_be_near_there_but_not_just_there():
    events, _ = flight("figure-eight", duration=20.0)
    for shift, is_placed in ((1e-5, True), (0.0, False)):
        values = events.values.copy()
        rows = is_fix(events)
        values[rows, :2] = values[rows, :2] - values[rows, :2][0] + shift if is_placed else 0.0
        _, pipeline = run(Events(t_ns=events.t_ns, kind=events.kind, values=values))
        assert (pipeline.origin is not None) == is_placed


@pytest.mark.parametrize("north", [5e3, 3e6])
def test_the_first_fix_far_from_the_autopilots_position_begins_a_new_origin_at_once(north):
    events, truth = flight("figure-eight", duration=40.0)
    table, pipeline = run(derived_until(events, 20.0, north=north))
    health = pipeline.health()
    assert (health.resets, health.reset_reason) == (1, "new origin")
    assert health.reset_delta[0] == pytest.approx(-north, rel=0.02)
    assert np.degrees(pipeline.origin[0]) == pytest.approx(47.4, abs=0.1)
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    late = errors(table, truth, 0.0)["pos"][t > 21.0]
    assert np.abs(late[:, :2]).max() < 4.0


def test_the_first_fix_nearby_resets_the_position_and_keeps_the_origin():
    events, _ = flight("figure-eight", duration=40.0)
    _, pipeline = run(derived_until(events, 20.0, north=200.0))
    assert pipeline.health().reset_reason == "position"
    assert pipeline.resets == 1
    _, right = run(derived_until(events, 20.0))
    assert right.resets == 0
