"""A vehicle that flies by our ODOMETRY, whose origin is not the autopilot's: scored in truth."""

import numpy as np
import pytest

from ekf_companion.config.config import Config
from ekf_companion.engine.companion import Companion
from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.personality import Kind
from tests.sim.board import EARLY, LATE, QUIET, Board, land, lifted

MOST = 0.5
"""m in any axis, in truth, at a switch and after a restart."""


def switched(loop, number, seconds=8.0):
    """Switch in a hover and return how far the vehicle then moves, by axis."""
    begin = loop.t
    loop.switch(number)
    loop.run(seconds)
    return loop.moved(begin)


LONG = pytest.mark.campaign


@pytest.mark.parametrize(
    "cold",
    [
        pytest.param(None, id="right", marks=LONG),
        pytest.param(EARLY, id="early", marks=LONG),
        pytest.param(LATE, id="late", marks=LONG),
    ],
)
def test_after_a_cold_start_of_the_receiver_a_switch_moves_nothing_and_it_comes_home(cold):
    loop, _ = lifted(cold=cold)
    start_n = loop.vehicle.pos_n
    assert switched(loop, 2).max() < MOST
    assert switched(loop, 1).max() < MOST
    assert switched(loop, 2).max() < MOST
    # Home is where it was armed by the autopilot: a position that it corrected later counts
    home_n = loop.true_n(24.0, 25.0)[0] + (0.0 if cold is not LATE else start_n * [1, 1, 0])
    loop.pilot.return_home()
    assert loop.run_until(lambda: loop.pilot.mode == "DISARMED", 60.0)
    assert np.hypot(*(loop.vehicle.pos_n - home_n)[:2]) < 1.0
    assert loop.sent


@LONG
@pytest.mark.parametrize("away", [40.0, 60.0])
def test_a_daemon_that_is_started_far_from_home_flies_on_from_there_and_comes_home(away):
    loop = ClosedLoop(Kind.ARDUPILOT, QUIET)
    board = Board(loop)
    loop.run(12.0)
    loop.pilot.arm()
    loop.pilot.speed = 10.0
    loop.pilot.go(0.8 * away, 0.6 * away, 10.0)
    loop.run(8.0 + away / 6.0)
    board.start()
    loop.run(12.0)
    assert np.hypot(*loop.vehicle.pos_n[:2]) == pytest.approx(away, abs=1.0)
    assert switched(loop, 2).max() < MOST
    assert land(loop) < 1.0
    assert np.abs(loop.said_error(20.0)).max() < 1.0


@pytest.mark.campaign
def test_one_that_flies_on_ours_from_its_start_is_given_an_origin_and_comes_home():
    from_start = {f"EK3_SRC1_{part}": 6.0 for part in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")}
    loop, _ = lifted(parameters=from_start, wait=20.0)
    assert loop.navigator.origin is not None
    assert abs(loop.vehicle.pos_n[2] + 10.0) < MOST
    loop.pilot.go(15.0, -8.0, 10.0)
    loop.run(8.0)
    assert land(loop) < 1.0


def test_px4_on_ours_alone_is_given_its_place_before_it_fuses_anything_and_comes_home():
    loop = ClosedLoop(Kind.PX4, QUIET, cold=EARLY)
    loop.connect(Companion(Config()))
    loop.run(15.0)
    assert loop.navigator.origin is not None
    assert loop.navigator.misplaced == 0
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, 8.0)
    loop.run(8.0)
    assert abs(loop.vehicle.pos_n[2] + 8.0) < MOST
    loop.pilot.go(12.0, 9.0, 8.0)
    loop.run(8.0)
    assert land(loop) < 1.0


@pytest.mark.campaign
def test_a_kilometre_away_its_metres_are_ours():
    loop, _ = lifted()
    assert switched(loop, 2, 3.0).max() < MOST
    loop.pilot.speed = 18.0
    begin = loop.t
    loop.pilot.go(600.0, 500.0, 10.0)
    loop.run(50.0)
    loop.pilot.speed = 5.0
    loop.run(5.0)
    # By WGS-84 it would be 0.8 m north and 1 m east
    assert np.abs(loop.said_error(loop.t - 2.0)).max() < 0.4
    assert switched(loop, 1, 5.0).max() < MOST
    assert np.abs(loop.said_error(begin)[:, 2]).max() < 1.0
