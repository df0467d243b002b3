"""A short piece of the hour with every fault (``make soak`` flies all of it)."""

import logging
import math

import numpy as np
import pytest

from benchmarks.reliability import soak, soak_score
from benchmarks.reliability.soak_flight import Errors, containers, fly
from sim_autopilot.faults.fault import parse

pytestmark = pytest.mark.campaign

KINDS = ("imu-stuck", "clock-jump:by=-0.5", "imu-saturation", "cut:duration=3", "gnss-jump")
"""One of each way back: a gap, a clock, a gap of some axes, a silence, a receiver's proof."""


@pytest.fixture(autouse=True)
def _quiet():
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize(("personality", "seed"), [("px4", 4)])
def test_all_is_right_again_ten_seconds_after_each_fault_and_nothing_grows(personality, seed):
    quiet = fly(personality, seed, duration=75.0)
    hour = soak.hour(personality, seed, duration=150.0, quiet=quiet, kinds=KINDS, gap=18.0)
    assert len(hour.found) == len(KINDS)
    assert not [str(one.fault) for one in hour.late]
    assert max(one.largest for one in hour.looks) <= soak.LONGEST_QUEUE
    assert max(one.waiting for one in hour.looks) < 100


def errors(t, position):
    size = np.zeros((len(t), 4))
    size[:, 0] = position
    return Errors(t=t, size=size, resets=np.zeros(len(t), dtype=np.int64))


def test_recovery_is_when_the_errors_stay_small():
    t = np.arange(0.0, 30.0, 0.1)
    faults = [parse("cut:start=10,duration=2")]
    wrong = ((t >= 10.0) & (t < 14.0)) | ((t >= 15.0) & (t < 15.5))
    (one,) = soak_score.episodes(errors(t, np.where(wrong, 7.0, 0.5)), faults, np.ones(4), seed=1)
    assert one.recovery == pytest.approx(3.5, abs=0.11)
    assert one.largest[0] == 7.0
    (never,) = soak_score.episodes(
        errors(t, np.where(t > 10.0, 7.0, 0.5)), faults, np.ones(4), seed=1
    )
    assert math.isinf(never.recovery)
    (silent,) = soak_score.episodes(errors(t[t < 10.0], 0.5), faults, np.ones(4), seed=1)
    assert math.isinf(silent.recovery)


def test_a_fault_during_which_errors_stay_normal_needs_no_row():
    t = np.arange(0.0, 60.0, 0.1)
    faults = [parse("cut:start=10,duration=2"), parse("jitter:start=30,duration=2")]
    found = soak_score.episodes(errors(t, np.where(t < 13.0, 7.0, 0.5)), faults, np.ones(4), seed=1)
    assert soak_score.unnoticed(found, np.ones(4)) == ["jitter"]
    told = {"personality": "px4", "seed": 1, "limits": np.ones(4), "cpu": 1.0}
    looks = [soak.Look(t=0.0, resident=100.0, largest=9, where="", waiting=0)]
    page = list(soak.page([soak.Hour(found=found, looks=looks, **told)], None))
    assert "Errors stay normal during `jitter`." in page
    assert [line.split(" | ")[0] for line in page if line.startswith("| `")] == ["| `cut`"]


def test_growth_and_queues_that_are_too_long_are_not_good():
    looks = [
        soak.Look(t=300.0 + 10.0 * n, resident=100.0 + 0.1 * n, largest=9, where="", waiting=0)
        for n in range(100)
    ]
    assert soak.growth(looks) == pytest.approx(9.0)
    told = {"personality": "px4", "seed": 1, "limits": np.ones(4), "found": [], "cpu": 1.0}
    assert not soak.Hour(looks=looks, **told).is_good
    assert soak.Hour(looks=looks[:30], **told).is_good


def test_every_container_is_found():
    class Slotted:
        __slots__ = ("queue",)

    class Holder:
        def __init__(self):
            self.inner = Slotted()
            self.inner.queue = [b"12345", {"a": [1, 2, 3]}]

    assert dict(containers(Holder())) == {
        ".inner.queue": 2,
        ".inner.queue[0]": 5,
        ".inner.queue[1]": 1,
        ".inner.queue[1]['a']": 3,
    }


def test_memory_and_queues_are_looked_at_through_the_flight():
    looks = fly("px4", 1, 25.0).looks
    assert [one.t for one in looks] == pytest.approx([0.0, 10.0, 20.0], abs=0.1)
    assert all(one.resident > 10.0 and 0 < one.largest < soak.LONGEST_QUEUE for one in looks)
