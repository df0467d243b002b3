"""Our own state that is lost: a blow, a gyro that turns by itself, and what only looks like one."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import Fault
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, flight
from tests.engine.estimation import errors, rms

ACT = FilterSettings(gnss=GnssSettings(delay=0.12, delay_std=0.05), weigh_faults="act")
BLOW = 30.0
"""When it comes, s."""
METRE = 1.0 / 6.367e6
"""rad."""


def turned(events: Events, axis: int, rate: float, length: float) -> Events:
    """Let a gyro turn by itself, by a rate (rad/s) that never was."""
    return added(events, Kind.IMU, axis, rate, length)


def struck(events: Events, axis: int, gained: float) -> Events:
    """Let a blow change the velocity (m/s) as no accelerometer says, by a sample that it misses."""
    return added(events, Kind.IMU, 3 + axis, gained / 0.02, 0.02)


def added(events: Events, kind: Kind, column: int, size: float, length: float) -> Events:
    values = events.values.copy()
    hit = (events.kind == kind) & between(events, BLOW, BLOW + length)
    values[hit, column] += size
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


UPSETS = {
    "half a turn in roll": lambda events: turned(events, 0, 6.0, 0.5),
    "a quarter in pitch": lambda events: turned(events, 1, -8.0, 0.2),
    "a turn about both": lambda events: turned(turned(events, 0, 4.0, 0.4), 1, 4.0, 0.4),
    "a blow from below": lambda events: struck(events, 2, -9.0),
    "a blow that turns": lambda events: struck(turned(events, 0, 20.0, 0.1), 0, 8.0),
    "accelerometer off for a second": lambda events: added(events, Kind.IMU, 5, -30.0, 1.0),
}


@pytest.mark.parametrize("upset", UPSETS)
@pytest.mark.parametrize("name", ["figure-eight", "loiter"])
def test_after_an_upset_the_state_is_found_again_by_the_fixes(name, upset):
    events, truth = flight(name, duration=60.0, rate=100.0)
    pipeline = Pipeline(ACT)
    table = pipeline.run(UPSETS[upset](events))
    late = errors(table, truth, BLOW + 15.0)
    assert np.degrees(rms(late["euler"][:, :2])) < 3.0
    assert rms(late["vel"]) < 0.5
    assert rms(late["pos"]) < 3.0
    assert table.column("status")[-1] == Status.OK
    # nor is it called good by what is wrong, for longer than the fixes take to show it
    every = errors(table, truth, BLOW)
    t = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    status = table.column("status")[-len(every["vel"]) :]
    wrong = (np.abs(every["vel"]) > 5.0 * every["sd_vel"] + 0.5).any(axis=1)
    assert np.count_nonzero(wrong & (status == Status.OK)) * np.median(np.diff(t)) < 0.7


@pytest.mark.parametrize(
    ("column", "size"),
    [(0, 60.0 * METRE), (1, 25.0 * METRE), (2, 30.0), (3, 8.0), (5, 6.0)],
    ids=["60 m north", "25 m east", "30 m up", "8 m/s north", "6 m/s down"],
)
@pytest.mark.parametrize("name", ["hover", "figure-eight"])
def test_a_receiver_that_jumps_is_not_our_own_state(name, column, size):
    events, _ = flight(name, duration=60.0, rate=100.0)
    pipeline = Pipeline(ACT)
    pipeline.run(added(events, Kind.GNSS, column, size, 99.0))
    assert Fault.STATE_WILD not in [found.kind for found in pipeline.found_faults()]
    assert pipeline.health().resets == 0
