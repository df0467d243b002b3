"""The autopilot's position beside ours: one that it only repeats is no height of its own."""

import math

import numpy as np
import pytest

from ekf_companion.engine.autopilot_frame import AutopilotFrame
from ekf_companion.engine.comparison import Comparison
from ekf_companion.mavlink.autopilot_estimate import AutopilotEstimate
from ekf_companion.mavlink.codec import Sender
from ekf_companion.mavlink.decode import Family
from ekf_companion.mavlink.frame import Splitter
from ekf_companion.nav.state import COLUMNS

LAT, LON, ALT = 47.0, 8.0, 400.0
ORIGIN = math.radians(LAT), math.radians(LON), ALT
CLIMB = 0.5
"""m/s."""


class Clock:
    def from_boot_ms(self, ms):
        return ms * 1_000_000


class Estimate:
    """Ours at a time (s) and a height above home (m)."""

    def __init__(self, t, height):
        self.t_ns = round(t * 1e9)
        self.values = np.zeros(len(COLUMNS) - 1)
        for name, value in (("lat_deg", LAT), ("lon_deg", LON), ("alt_m", ALT + height)):
            self.values[COLUMNS.index(name) - 1] = value


def datum(theirs, ours, seconds=20.0):
    """Return the datum that is learnt while nothing is sent.

    Args:
        theirs: Returns altitude and height above home of the autopilot at a time (s), m.
        ours: Returns our height above home, m.
        seconds: For so long.
    """
    comparison, said, frame = Comparison(), AutopilotEstimate(), AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(ORIGIN)
    sender = Sender(1, 1)
    for k in range(1, round(50 * seconds)):
        t = 0.02 * k
        comparison.keep(Estimate(t, ours(t)))
        if k % 10:
            continue
        alt, relative = theirs(t - 0.02)
        (one,) = Splitter().feed(
            sender.message(
                "GLOBAL_POSITION_INT",
                time_boot_ms=round(1e3 * (t - 0.02)),
                lat=round(LAT * 1e7),
                lon=round(LON * 1e7),
                alt=round(100 * alt) * 10,
                relative_alt=round(1e3 * relative),
            )
        )
        said.keep(one, round(t * 1e9))
        if (found := comparison.compare(said, Clock(), frame)) is not None:
            height, separation = found
            assert math.isfinite(separation.pos_n[2])
            if height is not None:
                frame.take_height(height, may_follow=False, may_choose=False)
    return frame.datum


def sinking(t):
    return 12.0 - CLIMB * max(t - 5.0, 0.0)


def test_a_place_that_is_only_repeated_shows_no_height():
    """An ArduPilot that has lost its position sinks, and repeats the altitude of its last place."""
    assert datum(lambda t: (ALT + 12.0, sinking(t)), sinking) == pytest.approx(0.0, abs=0.05)


def test_it_counts_again_once_it_moves():
    def theirs(t):
        return (ALT + (12.0 if t < 20.0 else sinking(t) + 1.5), sinking(t))

    assert datum(theirs, sinking, 30.0) == pytest.approx(1.5, abs=0.05)


def test_a_height_of_its_own_is_followed_though_it_lies_still():
    """On the ground the same centimetre comes again and again, and ours drifts."""
    at_rest = datum(lambda t: (ALT, 0.004 * math.sin(9.0 * t)), lambda t: -1.0)
    assert at_rest == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("climb", [0.02, 0.3, 4.0])
def test_a_height_that_climbs_with_ours_is_followed_at_any_speed(climb):
    found = datum(lambda t: (ALT + climb * t + 2.0, climb * t), lambda t: climb * t)
    assert found == pytest.approx(2.0, abs=0.05)


def test_a_home_that_is_set_anew_in_flight_costs_no_more_than_it_lasts():
    """The height above home leaps with it, and the altitude does not."""

    def theirs(t):
        return (ALT + 12.0 + 0.02 * math.sin(t), 12.0 + 0.02 * math.sin(t) - (3.0 if t > 8 else 0))

    assert datum(theirs, lambda t: 11.0) == pytest.approx(1.0, abs=0.06)
