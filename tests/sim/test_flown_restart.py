"""The companion's daemon dies and comes back while a vehicle flies by its ODOMETRY."""

import numpy as np
import pytest

from tests.sim.board import lifted

MOST = 0.5
"""m in any axis, in truth."""


def on_ours(**options):
    loop, board = lifted(**options)
    loop.switch(2)
    loop.run(4.0)
    return loop, board


def texts(loop, begin):
    return [heard.text for heard in loop.texts if heard.t > begin]


LONG = pytest.mark.campaign


@pytest.mark.parametrize(
    ("gap", "age"),
    [(0.94, 0.0), pytest.param(3.0, 0.0, marks=LONG), pytest.param(1.0, 6.0, marks=LONG)],
)
def test_it_stands_while_the_daemon_is_restarted(gap, age):
    loop, board = on_ours()
    begin = loop.t
    board.restart(gap, age)
    loop.run(10.0)
    assert loop.moved(begin).max() < MOST
    assert np.abs(loop.said_error(loop.t - 2.0)).max() < MOST
    said = texts(loop, begin)
    assert not [text for text in said if "EKF" in text]
    assert [t for t, _ in loop.sent if t > loop.t - 0.5]


@pytest.mark.campaign
def test_with_a_checkpoint_that_is_too_old_it_goes_on_in_the_same_frame():
    loop, board = on_ours()
    board.save()
    board.kill()
    # A pilot goes on by the autopilot's own sensors meanwhile
    loop.switch(1)
    board.limit = 4.0
    loop.run(6.0)
    board.start()
    loop.run(10.0)
    assert board.companion.pipeline.start.startswith("cold")
    begin = loop.t
    loop.switch(2)
    loop.run(10.0)
    assert loop.moved(begin).max() < MOST
    assert loop.vehicle.pos_n[2] == pytest.approx(-10.0, abs=MOST)
    assert np.abs(loop.said_error(begin)).max() < MOST


@pytest.mark.campaign
def test_without_any_checkpoint_it_goes_on_in_the_same_frame():
    loop, board = on_ours()
    loop.switch(1)
    board.kill()
    board.data = None
    loop.run(2.0)
    board.start()
    loop.run(15.0)
    begin = loop.t
    loop.switch(2)
    loop.run(10.0)
    assert loop.moved(begin).max() < MOST
    assert np.abs(loop.said_error(begin)).max() < MOST


@pytest.mark.campaign
def test_ten_kills_move_nothing_and_it_comes_home():
    loop, board = on_ours()
    rng = np.random.default_rng(1)
    for _ in range(10):
        begin = loop.t
        board.restart(float(rng.uniform(0.3, 3.0)), float(rng.uniform(0.0, 1.0)))
        loop.run(6.0)
        assert loop.moved(begin).max() < MOST
    loop.pilot.return_home()
    assert loop.run_until(lambda: loop.pilot.mode == "DISARMED", 60.0)
    assert np.hypot(*loop.vehicle.pos_n[:2]) < 1.0
