"""A simulated radio that ranges anchors, over the link, with its faults."""

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.core.memory.enums import Aid
from ekf_companion.nav.measurements import Kind as Measured
from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.personality import Kind
from sim_autopilot.ranging import PLACES, RangingFaults, RangingRadio
from tests.sim.board import QUIET, Board


def flown(seconds=12.0, config=None, kind=Kind.ARDUPILOT, **faults):
    """Fly a square beside a radio with faults; return the flight and the board."""
    loop = ClosedLoop(kind, QUIET)
    board = Board(loop, config or Config())
    radio = RangingRadio(loop.vehicle.motion, faults=RangingFaults(**faults))
    board.start()
    loop.connect(radio)
    loop.run(20.0)
    loop.pilot.arm()
    loop.pilot.speed = 4.0
    loop.pilot.go(0.0, 0.0, 8.0)
    loop.run(8.0)
    corners = [(10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0)]
    for k in range(round(seconds)):
        loop.pilot.go(*corners[k // 5 % 4], 8.0)
        loop.run(1.0)
    return loop, board


def off(loop, board):
    """Return how far the estimate is from the truth, m."""
    values = board.companion.pipeline.values()
    return np.linalg.norm(np.array(values[3:6]) - np.array(loop.vehicle.motion().pos_n))


@pytest.mark.parametrize("kind", [Kind.ARDUPILOT, Kind.PX4])
def test_its_ranges_are_used_and_it_is_named(kind):
    loop, board = flown(seconds=5.0, kind=kind)
    session = board.companion.session
    assert session.decoder.external.used[Measured.ANCHOR] == "1/25 RANGING_BEACON"
    x = board.companion.pipeline.filter_state
    assert x.used_t[Aid.ANCHOR_RANGE] > x.t - 0.2e9
    assert off(loop, board) < 0.4


def test_a_frame_that_is_off_is_found_beside_the_receiver():
    loop, board = flown(frame_n=(4.0, -3.0, 1.0))
    x = board.companion.pipeline.filter_state
    frame = x.anchor_range_frame_north, x.anchor_range_frame_east, x.anchor_range_frame_down
    assert frame == pytest.approx((-4.0, 3.0, -1.0), abs=0.5)
    assert off(loop, board) < 0.6


@pytest.mark.parametrize(
    "faults",
    [
        {"yaw": 0.1},
        {"misplaced": {3: (3.0, 0.0, 0.0)}},
        {"scale": 1.02},
        {"drift": 0.05},
        {"hidden": dict.fromkeys(range(0, len(PLACES), 2), 2.0)},
        {"detours": 0.3},
        {"delay": 1.0},
        {"jitter": 0.05},
        {"burst": 16},
        {"frozen": (25.0, 40.0)},
    ],
    ids=lambda faults: next(iter(faults)),
)
def test_beside_a_receiver_no_fault_of_it_leads_away(faults):
    loop, board = flown(**faults)
    assert off(loop, board) < 0.8
