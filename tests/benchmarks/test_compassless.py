"""Flight without a compass, or with a wrong one: samples of docs/accuracy/faults.md."""

from functools import cache

import numpy as np
import pytest

from benchmarks.accuracy import compassless
from benchmarks.campaign import fly
from ekf_companion.nav.measurements import Kind

pytestmark = pytest.mark.campaign

MOVING = ["figure-eight", "loiter", "square-spiral"]
flown = cache(lambda name: fly(name, 4))


@pytest.mark.parametrize("name", MOVING)
def test_without_a_compass_the_yaw_is_found_in_flight(name):
    """In the slow turns of the spiral 0.07 s of delay look like 10 deg of yaw, for half a minute:
    its sigma, 15 deg, says so."""
    found = compassless.outcome(flown(name), compassless.silent(flown(name)))
    assert found.coarse < (60.0 if name == "square-spiral" else 30.0)
    assert found.position < 30.0


@pytest.mark.parametrize("name", MOVING)
def test_a_compass_that_is_the_wrong_way_round_is_found_out(name):
    found = compassless.outcome(flown(name), compassless.reversed_always(flown(name)))
    assert found.coarse < 60.0
    assert found.position < 60.0


def test_a_compass_that_falls_silent_leaves_the_yaw_to_the_fixes():
    found = compassless.outcome(
        flown("figure-eight"), compassless.silent_later(flown("figure-eight"))
    )
    assert found.fine < 5.0
    assert found.resets == 0


def test_a_compass_that_was_wrong_at_first_is_corrected():
    before = flown("figure-eight")
    events = compassless.reversed_at_first(before)
    is_mag = events.kind == Kind.MAG
    turned = (events.values != before.events.values)[is_mag].any(axis=1)
    assert np.flatnonzero(turned).tolist() == list(range(1500))  # 30 s of 50 Hz
    found = compassless.outcome(before, events)
    assert found.coarse < 20.0
    assert found.resets == 1
