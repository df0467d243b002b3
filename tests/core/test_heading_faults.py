"""A heading that is off is held until it ends, and what no sample has shown is no fault."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault
from ekf_companion.nav.measurements import Events, HeadingSample, HeadingSource, Kind, merge
from ekf_companion.nav.state import Trajectory
from tests.core.flights import between, flight, without
from tests.core.interpreted import load
from tests.core.states import array
from tests.core.test_hypotheses import pipeline
from tests.core.test_interval import begun

STD = np.radians(5.0)
WHITE = np.radians(0.3)
"""Slow error that the source states, and its white one, rad."""


def yaw_of(truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps, ns, and true yaw, rad, without leaps."""
    w, x, y, z = truth.q_nb.T
    return truth.att_t_ns, np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def headed(events: Events, truth: Trajectory, off, seed: int) -> Events:
    """Put an autopilot's heading, off by deg(t), in the place of the magnetometer."""
    first, last = int(events.t_ns[0]), int(events.t_ns[-1])
    stamps = np.arange(first, last, 100_000_000)
    rng = np.random.default_rng(seed)
    yaw = np.interp(stamps, *yaw_of(truth)) + WHITE * rng.standard_normal(len(stamps))
    yaw += np.radians([off(1e-9 * (t - first)) for t in stamps.tolist()])
    rows = [
        HeadingSample(
            t_ns=int(t),
            heading=float((a + np.pi) % (2 * np.pi) - np.pi),
            std=STD,
            source=HeadingSource.AUTOPILOT,
        ).row()
        for t, a in zip(stamps, yaw, strict=True)
    ]
    return merge(without(events, Kind.MAG), Events.from_rows(rows))


def error(table, truth: Trajectory, after: float) -> float:
    """Return the RMS of yaw's error from a time on, deg."""
    t = table.stamp_ns
    apart = table.column("yaw") - np.interp(t, *yaw_of(truth))
    apart = (apart + np.pi) % (2 * np.pi) - np.pi
    late = (t - t[0]) * 1e-9 > after
    return float(np.degrees(np.sqrt(np.mean(apart[late] ** 2))))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_heading_that_was_off_until_take_off_is_right_from_then_on(seed):
    events, truth = flight("figure-eight", 60.0, seed=seed)
    one = pipeline("act")
    table = one.run(headed(events, truth, lambda t: 25.0 if t < 4.0 else 0.0, seed))
    assert Fault.RECOVERY_HEADING in [f.kind for f in one.found_faults()]
    assert error(table, truth, 30.0) < 3.0


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_a_heading_that_comes_back_takes_us_nowhere(rate):
    """As an autopilot's yaw that was reset wrongly, and that its own motion corrects."""
    events, truth = flight("hover", 60.0, seed=4)

    def off(t: float) -> float:
        return 0.0 if t < 25.0 else -20.0 * (1.0 if t < 35.0 else np.exp(-rate * (t - 35.0)))

    one, usual = pipeline("act"), pipeline("off")
    events = headed(events, truth, off, 4)
    found = error(one.run(events), truth, 40.0)
    assert found < error(usual.run(events), truth, 40.0)
    if rate == 1.0:  # slower, it may be a heading that was off before; faster, a step back
        end = one.found_faults()[-1]
        assert end.kind == Fault.RECOVERY_HEADING
        assert abs(1e-9 * (end.onset_ns - int(events.t_ns[0])) - 35.0) < 2.0


def test_a_turn_that_no_sample_has_shown_is_no_fault_of_the_heading():
    events, truth = flight("figure-eight", 60.0, seed=5)
    events = headed(events, truth, lambda t: 0.0, 5)
    holes = np.zeros(len(events), dtype=bool)
    for begin in range(20, 55, 5):
        holes |= between(events, begin, begin + 0.9)
    events = events.take(~(holes & (events.kind == Kind.IMU)))
    one = pipeline("act")
    table = one.run(events)
    assert not one.found_faults()
    assert error(table, truth, 20.0) < 5.0


def test_a_gap_adds_the_same_whatever_is_read_in_it():
    whole, parts = begun(), begun()
    interval = load().interval
    interval.add_lost(whole, 0.8, 0.7, 1.0)
    done = 0.0
    for now in (0.1, 0.1, 0.35, 0.6, 0.8):
        done = interval.inflate_within_gap(parts, 0.7, done, now)
    assert done == 0.8
    np.testing.assert_allclose(array(parts.P), array(whole.P), rtol=1e-12, atol=1e-15)
