"""Drift without GNSS: samples of docs/accuracy/outages.md."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.accuracy import outages
from benchmarks.accuracy.consistency import KINDS
from benchmarks.campaign import SCENARIOS, fly
from benchmarks.recorded import TRUTH
from ekf_companion.nav.measurements import Kind
from tests.paths import DATA

pytestmark = pytest.mark.campaign

SURE = 0.999


@cache
def simulated():
    jobs = [(name, 20 * i + luck) for i, name in enumerate(SCENARIOS) for luck in range(4)]
    return [outages.simulated(job) for job in jobs]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("length", outages.LENGTHS)
def test_the_drift_of_an_outage_is_covered(kind, length):
    found = [one[kind, length] for one in simulated()]
    least = binom.ppf(1.0 - SURE, len(found), outages.COVERED)
    assert sum(one[2] for one in found) >= least
    assert sum(one[3] for one in found) >= least


def test_an_outage_of_ten_seconds_costs_metres():
    assert max(one["default", 10.0][0] for one in simulated()) < 6.0
    assert max(one["default", 60.0][1] for one in simulated()) < 2.0


def test_an_outage_takes_the_fixes_and_nothing_else():
    flown = fly("hover", 1, duration=20.0)
    start_ns = flown.flight.first_ns + 5_000_000_000
    left = outages.cut(flown.events, start_ns, 10.0)
    assert len(flown.events) - len(left) == 50
    during = (left.t_ns >= start_ns) & (left.t_ns < start_ns + 10_000_000_000)
    assert Kind.GNSS not in left.kind[during]


@pytest.mark.parametrize("case", TRUTH, ids=lambda case: case.title)
def test_the_drift_of_an_outage_in_a_recorded_flight_is_covered(case, monkeypatch):
    if not (DATA / case.log).is_file():
        pytest.skip("the recorded flights are not here")
    monkeypatch.setattr(outages, "LENGTHS", (10.0,))
    found = outages.in_recorded(DATA / case.log)[10.0]
    # the outages of one flight depend on each other: four of five is enough
    assert np.mean([one[2] for one in found]) >= 0.8
    assert np.mean([one[3] for one in found]) >= 0.8
