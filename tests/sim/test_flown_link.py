"""A slow, uneven or narrow link to the autopilot, and a second source on it, in closed loop."""

import numpy as np
import pytest

from sim_autopilot.closed_loop import ClosedLoop
from sim_autopilot.line import Way
from sim_autopilot.personality import Kind
from sim_autopilot.vision import VisionSource
from tests.sim.board import QUIET, Board

LINES = {
    "udp-200": Way(delay=0.2),
    "udp-400": Way(delay=0.4),
    "udp-200-jitter": Way(delay=0.2, jitter=0.05),
    "loss": Way(loss=0.1),
    "stalls": Way(stall_every=5.0, stall=0.5),
    "tcp-57600": Way(rate=5760.0),
    "tcp-38400": Way(rate=3840.0),
}
MOST = 1.0
"""m off, while ODOMETRY is sent."""
OFTEN = 0.5
"""s; ODOMETRY that comes more seldom is a silence."""


def flown(way, seconds=20.0, speed=4.0, **parameters):
    """Fly a square on ours over a link; a pilot who reads that none is sent switches back.

    Return the flight, and when it was switched to ours.
    """
    loop = ClosedLoop(Kind.ARDUPILOT, QUIET, parameters=parameters)
    board = Board(loop, up=way)
    board.start()
    loop.run(20.0)
    loop.pilot.arm()
    loop.pilot.speed = speed
    loop.pilot.go(0.0, 0.0, 10.0)
    loop.run(8.0)
    begin = loop.t
    if not warned(loop, 0.0):
        loop.switch(2)
    corners = [(10.0, 0.0), (10.0, 10.0), (0.0, 10.0), (0.0, 0.0)]
    for k in range(round(seconds)):
        loop.pilot.go(*corners[k // 5 % 4], 10.0)
        loop.run(1.0)
        if warned(loop, begin):
            loop.switch(1)
    return loop, begin


def warned(loop, begin):
    """Whether the companion has said since a time that it sends none."""
    said = [x.text for x in loop.texts if x.t >= begin and x.component_id != 1]
    return any("no ODOMETRY" in text for text in said)


def judge(loop, begin):
    """Assert that nothing of ours led it astray, or that silence was told within 2 s."""
    sent = np.array([t for t, _ in loop.sent])
    rows = [row for row in loop.rows if row.t > begin]
    error = np.abs(loop.said_error(begin)[1:]).max(axis=1)
    for row, off in zip(rows, error, strict=False):
        is_sent = ((row.t - OFTEN < sent) & (sent <= row.t)).any()
        assert off < MOST or not is_sent, f"{off:.1f} m at {row.t:.1f} s"
    gaps = np.diff(np.concatenate([sent[sent > begin], [loop.t]]))
    if (gaps > 2.0).any():
        assert warned(loop, 0.0)
    ends = [x.text for x in loop.texts if x.component_id == 1 and x.severity <= 4]
    assert ends == []


@pytest.mark.campaign
@pytest.mark.parametrize("name", list(LINES))
def test_over_no_link_it_is_led_astray(name):
    judge(*flown(LINES[name]))


def test_a_line_of_38400_baud_leads_nobody_astray():
    judge(*flown(LINES["tcp-38400"], seconds=10.0))


@pytest.mark.campaign
def test_a_delay_that_the_autopilot_was_told_does_no_harm():
    loop, begin = flown(LINES["udp-200"], seconds=10.0, VISO_DELAY_MS=210.0)
    assert np.abs(loop.said_error(begin)).max() < 0.6
    assert not warned(loop, begin)


def second(message, offset_n=(2.8, 0.0, 0.0)):
    """Return a flight in which another component begins to say where the vehicle is."""
    loop = ClosedLoop(Kind.ARDUPILOT, QUIET)
    board = Board(loop)
    board.start()
    loop.run(20.0)
    loop.pilot.arm()
    loop.pilot.go(0.0, 0.0, 10.0)
    loop.run(8.0)
    loop.switch(2)
    loop.run(3.0 + 0.024)
    begin = loop.t
    loop.connect(VisionSource(loop.vehicle.motion, message=message, offset_n=offset_n))
    loop.run(6.0)
    return loop, begin


@pytest.mark.parametrize(
    "message",
    ["VISION_POSITION_ESTIMATE", pytest.param("ODOMETRY", marks=pytest.mark.campaign)],
)
def test_a_second_source_is_named_to_the_pilot_within_three_seconds(message):
    loop, begin = second(message)
    said = [x for x in loop.texts if begin < x.t < begin + 3.0 and x.component_id not in (1, 197)]
    assert any("197" in heard.text for heard in said), said
