"""A PX4 that takes off on its receiver, and is switched to our ODOMETRY in flight, in truth."""

import math

import numpy as np
import pytest

from ekf_companion.mavlink.codec import Sender, unpack
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.mavlink.messages import IDS
from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.personality import Kind
from tests.sim.board import EARLY, QUIET, Board, land

MOST = 0.5
"""m in any axis, in truth."""
ON_RECEIVER = {"EKF2_EV_CTRL": 0.0, "EKF2_GPS_CTRL": 7.0, "EKF2_HGT_REF": 1.0}
ON_OURS = {"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0}
LONG = pytest.mark.campaign


class Between:
    """What lies between PX4 and a companion: it may lose frames, or hold them back."""

    def __init__(self, loop, peer, is_lost=lambda t, message: False):
        self.loop, self.peer, self.is_lost = loop, peer, is_lost
        self.data_to_send = peer.data_to_send
        self._splitter = Splitter()

    def receive(self, data, now_ns):
        for frame in self._splitter.feed(data):
            if not self.is_lost(self.loop.t, unpack(frame)):
                self.peer.receive(frame.raw, now_ns)

    def tick(self, now_ns):
        self.peer.tick(now_ns)


def is_origin(message):
    return type(message).__name__ == "GPS_GLOBAL_ORIGIN"


class Wire(Board):
    """A board whose link loses what :class:`Between` is told to lose."""

    def __init__(self, loop, is_lost):
        super().__init__(loop)
        connect = loop.connect
        loop.connect = lambda peer, **ways: connect(Between(loop, peer, is_lost), **ways)


def away(distance, board=Board, **options):
    """Return a PX4 on its receiver, so far from home, and a board that was started there."""
    loop = ClosedLoop(Kind.PX4, QUIET, parameters=ON_RECEIVER, **options)
    board = board(loop)
    loop.run(13.0)
    loop.pilot.arm()
    loop.pilot.speed = 10.0
    loop.pilot.go(0.8 * distance, 0.6 * distance, 10.0)
    loop.run(8.0 + distance / 6.0)
    board.start()
    loop.run(12.0)
    return loop, board


def switched(loop, parameters=ON_OURS, seconds=8.0):
    """Switch what PX4 fuses, and return how far the vehicle then moves, by axis."""
    begin = loop.t
    loop.autopilot.parameters.update(parameters)
    loop.run(seconds)
    return loop.moved(begin)


def counters(loop, begin):
    return {message.reset_counter for t, message in loop.sent if t > begin}


@pytest.mark.parametrize("distance", [40.0, pytest.param(60.0, marks=LONG)])
def test_a_daemon_that_is_started_far_from_home_moves_nothing_at_the_switch(distance):
    loop, board = away(distance)
    assert np.hypot(*loop.vehicle.pos_n[:2]) == pytest.approx(distance, abs=1.0)
    assert switched(loop).max() < MOST
    # Killed and started again it goes on in that frame
    for age in (0.0, 0.9):
        begin = loop.t
        board.restart(1.0, age)
        loop.run(6.0)
        assert loop.moved(begin).max() < MOST
        assert board.companion.session.stream_state.is_streaming
    assert land(loop) < 1.0


@LONG
def test_a_request_that_is_lost_is_repeated():
    def is_lost(t, message):
        return is_origin(message) and t < board.begin + 3.0

    board = None

    def made(loop):
        nonlocal board
        board = Wire(loop, is_lost)
        board.begin = loop.t + 13.0 + 8.0 + 40.0 / 6.0
        return board

    loop, _ = away(40.0, made)
    assert switched(loop).max() < MOST


@LONG
def test_an_origin_that_is_told_after_the_switch_moves_nothing_any_more():
    switch = []

    def is_lost(t, message):
        return is_origin(message) and not (switch and t > switch[0] + 3.0)

    loop, board = away(40.0, lambda loop: Wire(loop, is_lost))
    switch.append(loop.t)
    loop.autopilot.parameters.update(ON_OURS)
    loop.run(2.9)
    begin, sent = loop.t, counters(loop, loop.t - 1.0)
    loop.run(8.0)
    assert board.companion.session.origin.theirs is not None
    assert counters(loop, begin) == sent
    # What it is off, it is off; back on its receiver it is right, and again on ours now
    switched(loop, ON_RECEIVER, 20.0)
    assert switched(loop).max() < MOST


@LONG
def test_a_receiver_that_is_cold_when_the_daemon_starts_moves_nothing_at_the_switch():
    loop = ClosedLoop(Kind.PX4, QUIET, parameters=ON_RECEIVER, cold=EARLY)
    board = Board(loop)
    board.start()
    loop.run(25.0)
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, 10.0)
    loop.run(9.0)
    assert switched(loop).max() < MOST


@LONG
def test_a_filter_of_px4_that_began_anew_is_counted_from_unless_it_flies_on_ours():
    loop, _ = away(40.0)
    was = loop.navigator.origin
    begin, sent = loop.t, counters(loop, loop.t - 1.0)
    assert switched(loop, seconds=4.0).max() < MOST
    # Its ground station moves the origin: the frame of what it fuses stays
    place = was.to_geodetic(np.array([20.0, 0.0, 0.0]))
    loop.navigator.set_origin(*place)
    loop.run(4.0)
    assert counters(loop, begin) == sent
    # On its receiver the new one is counted from
    switched(loop, ON_RECEIVER, 20.0)
    assert switched(loop).max() < MOST


@LONG
@pytest.mark.parametrize("is_before", [True, False])
def test_a_checkpoint_from_before_px4_had_an_origin_settles_nothing(is_before):
    loop = ClosedLoop(Kind.PX4, QUIET, parameters=ON_RECEIVER, cold=EARLY)
    board = Board(loop)
    board.start()
    loop.run(8.0 if is_before else 14.0)
    assert (loop.navigator.origin is None) is is_before
    board.restart(1.0)
    loop.run(17.0)
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, 10.0)
    loop.run(9.0)
    assert switched(loop).max() < MOST


@LONG
@pytest.mark.parametrize("after", [0.0, 5.0])
def test_an_origin_that_a_ground_station_gave_to_a_px4_without_a_receiver_counts(after):
    """Ours is not given then, and where it is said to be is where it is."""
    loop = ClosedLoop(Kind.PX4, QUIET)
    loop.run(1.0)
    board = Board(loop)
    lat, lon, alt = loop._earth.to_geodetic(np.array([30.0, 0.0, 0.0]))
    if after:
        board.start()
    loop.run(0.5)
    loop.navigator.set_origin(lat, lon, alt)
    if not after:
        loop.run(1.0)
        board.start()
    loop.run(15.0)
    assert loop.navigator.misplaced == 0
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, 8.0)
    loop.run(8.0)
    assert np.abs(loop.said_error(loop.t - 2.0)).max() < MOST
    assert land(loop) < 1.0


@pytest.mark.parametrize("ids", [(2, 1), (1, 190), (255, 190)])
def test_an_origin_of_somebody_else_is_not_px4s(ids):
    loop = ClosedLoop(Kind.PX4, QUIET, parameters=ON_RECEIVER)
    board = Board(loop)
    board.start()
    loop.run(1.0)
    place = {"latitude": round(math.degrees(loop._earth.lat) * 1e7) + 5000, "longitude": 85455940}
    said = Sender(*ids).message("GPS_GLOBAL_ORIGIN", altitude=488000, **place)
    board.companion.receive(said, loop.now_ns)
    assert board.companion.session.origin.theirs is None
    assert IDS["GPS_GLOBAL_ORIGIN"] not in board.companion.session.received
