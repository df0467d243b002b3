"""Long silences of the inertial sensor, and starts in a turn: the attitude is found in motion."""

import numpy as np
import pytest

from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, flight
from tests.engine.estimation import deviations, run


@pytest.mark.parametrize("gap", [1.5, 2.5, 5.0, 10.0])
@pytest.mark.parametrize("name", ["figure-eight", "loiter", "square-spiral"])
def test_a_long_gap_in_a_turn_is_survived_and_its_doubt_is_true(name, gap):
    for seed, start in ((1, 20.0), (2, 21.7), (1, 23.3), (2, 25.0)):
        events, truth = flight(name, duration=60.0, seed=seed)
        table, pipeline = run(events.take(~between(events, start, start + gap)))
        error, sigma = deviations(table, truth)
        t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
        after = (t >= start + gap - 1e-6) & (t < start + gap + 10.0)
        inside = np.abs(error[after]) < 3.0 * sigma[after]
        assert inside[0].all(), (seed, start)
        assert inside.mean() > 0.9, (seed, start)
        found = (t > start + gap + 2.5) & after
        assert np.degrees(np.abs(error[found, 3:5])).max() < 8.0, (seed, start)
        assert np.abs(error[found, :3]).max() < 1.0, (seed, start)
        health = pipeline.health()
        assert (health.resets, health.reset_reason) == (1, "inertial gap")
        # the fix that was true in the gap and came after it
        assert sum(health.verdicts[aid][Verdict.GATED] for aid in Aid) <= 3


def test_without_a_heading_after_a_gap_the_filter_goes_on_by_itself():
    events, truth = flight("hover", duration=40.0, yaw=True)
    gap = between(events, 20.0, 22.5)
    headless = between(events, 20.0, 99.0) & np.isin(events.kind, [Kind.MAG, Kind.HEADING])
    table, pipeline = run(events.take(~(gap | headless)))
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    assert (table.column("status")[(t > 23.5) & (t < 25.0)] == Status.DEGRADED).all()
    assert pipeline.health().verdicts[Aid.POSITION][Verdict.FUSED] > 80
    error, sigma = deviations(table, truth)
    late = t > 35.0
    assert np.abs(error[late, :3]).max() < 1.0
    assert np.degrees(np.abs(error[late, 3:5])).max() < 5.0
    assert np.degrees(sigma[t > 27.0, 3:5]).max() < 6.0  # it learns again


@pytest.mark.parametrize("name", ["figure-eight", "loiter"])
def test_a_start_in_a_turn_finds_north_by_the_whole_field(name):
    """A field that is steep and a force that leans leave no azimuth to turn to."""
    for skip in np.arange(14.0, 40.0, 3.7):
        events, truth = flight(name, duration=4.0, skip=float(skip))
        table, _ = run(events)
        error, _ = deviations(table, truth)
        first = np.flatnonzero(table.column("status") >= Status.OK)[5]
        assert np.degrees(np.abs(error[first, 3:5])).max() < 5.0, skip
        assert np.degrees(np.abs(error[first, 5])) < 12.0, skip
