"""Another computer's poses over the link, with their faults, as an aid of the companion."""

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.core.memory.enums import Aid
from ekf_companion.core.settings.settings import VisualOdometrySettings, VisualVelocitySettings
from ekf_companion.nav.measurements import Kind as Measured
from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.personality import Kind
from sim_autopilot.vision import VisionFaults, VisionSource
from tests.sim.board import QUIET, Board

USED = Config(
    visual_odometry=VisualOdometrySettings(use=True, scale_std=0.1),
    visual_velocity=VisualVelocitySettings(use=True),
)


def flown(message="ODOMETRY", seconds=30.0, **faults):
    """Fly a square beside a source with faults; return the flight, the board and the source."""
    loop = ClosedLoop(Kind.ARDUPILOT, QUIET)
    board = Board(loop, USED)
    source = VisionSource(loop.vehicle.motion, message=message, faults=VisionFaults(**faults))
    board.start()
    loop.connect(source)
    loop.run(20.0)
    loop.pilot.arm()
    loop.pilot.speed = 4.0
    loop.pilot.go(0.0, 0.0, 10.0)
    loop.run(8.0)
    corners = [(10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0)]
    for k in range(round(seconds)):
        loop.pilot.go(*corners[k // 5 % 4], 10.0)
        loop.run(1.0)
    return loop, board, source


def off(loop, board):
    """Return how far the estimate is from the truth, m."""
    values = board.companion.pipeline.values()
    return np.linalg.norm(np.array(values[3:6]) - np.array(loop.vehicle.motion().pos_n))


@pytest.mark.parametrize(
    ("message", "kind"),
    [
        ("ODOMETRY", Measured.POSE),
        ("VISION_POSITION_ESTIMATE", Measured.POSE),
        ("VISION_SPEED_ESTIMATE", Measured.VELOCITY),
        ("VISION_POSITION_DELTA", Measured.VELOCITY),
    ],
)
def test_each_message_is_used_and_named(message, kind):
    _, board, _ = flown(message, seconds=5.0)
    session = board.companion.session
    assert session.decoder.external.used[kind] == f"1/197 {message}"
    aid = Aid.VISUAL_ODOMETRY if kind is Measured.POSE else Aid.VISUAL_VELOCITY
    x = board.companion.pipeline.filter_state
    assert x.used_t[aid] > x.t - 0.2e9


def test_scale_and_yaw_of_its_frame_are_found():
    x = flown(scale=1.1, yaw=0.8)[1].companion.pipeline.filter_state
    assert (1.0 + x.visual_odometry_scale) * 1.1 == pytest.approx(1.0, abs=0.01)
    assert x.visual_odometry_frame_yaw == pytest.approx(-0.8, abs=0.03)


@pytest.mark.parametrize(
    "faults",
    [
        {"noise": 0.2},
        {"jitter": 0.02},
        {"burst": 8},
        {"yaw_slip": 0.02},
        {"walk": 0.1},
        {"frozen": (25.0, 35.0)},
        {"is_enu": True},
        {"delay": 0.2},
    ],
    ids=lambda faults: next(iter(faults)),
)
def test_beside_a_receiver_no_fault_of_it_leads_away(faults):
    loop, board, _ = flown(seconds=15.0, **faults)
    assert off(loop, board) < 0.6


@pytest.mark.parametrize("counts", [True, False])
def test_a_new_frame_moves_nothing(counts):
    loop, board, source = flown(seconds=10.0)
    source.reset((3.0, 0.0, 0.0), 0.7, counts=counts)
    before = board.companion.resets
    loop.run(3.0)
    assert off(loop, board) < 0.4
    assert board.companion.resets == before
