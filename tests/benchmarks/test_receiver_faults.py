"""A receiver that is wrong: samples of docs/accuracy/faults.md."""

from functools import cache

import numpy as np
import pytest

from benchmarks.accuracy.receiver_faults import BEGIN, DURATION, FAULTS, falsified, outcome
from benchmarks.campaign import fly
from ekf_companion.nav.measurements import Kind

pytestmark = pytest.mark.campaign


@cache
def flown(name):
    return fly(name, 7, duration=DURATION)


def outcome_of(name, title):
    return outcome(flown(name), next(fault for fault in FAULTS if fault.title == title))


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_single_wild_fixes_move_nothing(name):
    wild = outcome_of(name, "one wild fix every 3 s, 60 s")
    assert wild.largest < 3.0
    assert wild.resets == 0
    assert wild.refused <= 0.4


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_a_receiver_that_says_it_is_spoofed_is_not_followed(name):
    spoofed = outcome_of(name, "jump of 300 m, flagged as spoofed, 20 s")
    assert spoofed.largest < 25.0
    assert spoofed.warned < 3.0
    assert spoofed.resets == 0
    assert spoofed.recovered < 5.0


@pytest.mark.parametrize("name", ["hover", "loiter"])
def test_a_jump_is_noticed_at_once_and_left_when_it_is_over(name):
    jump = outcome_of(name, "jump of 300 m, back after 20 s")
    assert jump.refused <= 0.4
    assert jump.warned < 3.0
    assert jump.recovered < 10.0


def test_a_frozen_receiver_is_not_followed():
    frozen = outcome_of("loiter", "fixes frozen for 20 s")
    assert frozen.largest < 30.0
    assert frozen.recovered < 10.0


def test_a_fault_changes_fixes_from_its_begin_to_its_end_only():
    before = fly("hover", 2, duration=120.0)
    for fault in FAULTS:
        if fault.length > 40.0 or "no velocity" in fault.title:
            continue
        after = falsified(before, fault)
        changed = (after.values != before.events.values) & ~np.isnan(after.values)
        rows = np.flatnonzero(changed.any(axis=1))
        t = (after.t_ns[rows] - before.flight.first_ns) * 1e-9 - BEGIN
        assert (after.kind[rows] == Kind.GNSS).all(), fault.title
        assert 0.0 <= t.min() < 0.5, fault.title
        assert fault.length - 0.5 < t.max() < fault.length, fault.title
