"""ODOMETRY in the local frame of the autopilot that follows it."""

import math

import numpy as np
import pytest

from ekf_companion.core.output.follower import NUMBERS, Follower
from ekf_companion.engine.autopilot_frame import AutopilotFrame, Height
from ekf_companion.mavlink.decode import Family
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.projection import ARDUPILOT, PX4

OURS = math.radians(47.397743), math.radians(8.545594), 493.5
THEIRS = math.radians(47.397800), math.radians(8.545500), 489.4
OTHER = math.radians(47.398100), math.radians(8.545900), 490.0
SECOND_NS = 1_000_000_000


def sent(frame, *pos_n):
    """Return a position as it is sent in a frame."""
    follower = Follower()
    follower.place = frame.place(OURS)
    follower.look(SECOND_NS, NUMBERS.pack(*pos_n, 1.0, *[0.0] * 51), (0.0, 0.0, 0.0))
    return NUMBERS.unpack(follower.express(1.0, 1.0, False))[:3]


def place(*pos_n):
    lat, lon, alt = LocalFrame(*OURS).to_geodetic(np.array(pos_n))
    return float(lat), float(lon), float(alt)


@pytest.mark.parametrize("pos_n", [(0.0, 0.0, 0.0), (600.0, -250.0, -12.0), (-2900.0, 1500.0, 3.0)])
def test_ardupilot_finds_the_vehicle_where_it_is(pos_n):
    """It turns what is sent into latitude and longitude by its own origin and sphere."""
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    x, y, z = sent(frame, *pos_n)
    lat, lon, alt = place(*pos_n)
    found = ARDUPILOT.to_geodetic(x, y, *THEIRS[:2])
    assert found == pytest.approx((lat, lon), abs=1e-3 / 6.4e6)
    assert THEIRS[2] - z == pytest.approx(alt, abs=1e-3)


def test_px4_is_sent_metres_of_its_sphere_about_its_own_origin_and_our_own_height():
    frame = AutopilotFrame(Family.PX4)
    lat, lon, _ = place(600.0, 400.0, -12.0)
    x, y, z = sent(frame, 600.0, 400.0, -12.0)
    assert (x, y) == pytest.approx(PX4.to_metres(lat, lon, *OURS[:2]), abs=1e-3)
    assert math.hypot(x - 600.0, y - 400.0) > 0.5
    frame.set_origin(THEIRS)
    x, y, z = sent(frame, 600.0, 400.0, -12.0)
    assert (x, y) == pytest.approx(PX4.to_metres(lat, lon, *THEIRS[:2]), abs=1e-3)
    assert z == pytest.approx(-12.0)
    assert frame.counts_from(OURS) == (*THEIRS[:2], OURS[2])
    # One that was given ours says so without an altitude: that is no other place
    frame.set_origin((*OURS[:2], 0.0))
    assert frame.distance(OURS) == pytest.approx(0.0, abs=1e-6)


def test_px4s_origin_is_taken_until_it_may_fuse_what_counts_from_the_one_before():
    frame = AutopilotFrame(Family.PX4)
    frame.set_origin(THEIRS)
    frame.fix(OURS, is_fused=False)
    frame.set_origin(OTHER)
    assert frame.origin[:2] == OTHER[:2]
    frame.fix(OURS, is_fused=True)
    frame.set_origin(THEIRS)
    assert frame.origin[:2] == OTHER[:2]
    # It flies on its receiver again: what it has told meanwhile counts from now on
    frame.fix(OURS, is_fused=False)
    assert frame.origin[:2] == THEIRS[:2]
    frame.forget()
    assert frame.origin is None


def test_what_px4_was_sent_about_our_origin_stays_about_that_in_the_next_run_too():
    frame = AutopilotFrame(Family.PX4)
    frame.fix(OURS, is_fused=False)
    assert not frame.sent.has_origin
    frame.fix(OURS, is_fused=True)
    again = AutopilotFrame(Family.PX4)
    again.set_origin(THEIRS)
    again.keep(frame.sent)
    again.set_origin(THEIRS)
    assert again.counts_from(OTHER) == (*OURS[:2], OTHER[2])
    other = AutopilotFrame(Family.ARDUPILOT)
    other.keep(frame.sent)
    assert other.origin is None


def test_others_are_sent_the_same_bytes():
    frame = AutopilotFrame(Family.UNKNOWN)
    frame.set_origin(THEIRS)
    assert frame.place(OURS) is None
    assert sent(frame, 600.0, 400.0, -12.0) == (600.0, 400.0, -12.0)


def test_before_there_is_an_origin_of_ours_nothing_can_be_put_in_theirs():
    assert AutopilotFrame(Family.PX4).place(None) is None


def heights(frame, begin, end, theirs, ours, *, climb=0.0, may_follow=True, may_choose=True):
    for k in range(round(5 * (end - begin))):
        height = Height(round((begin + 0.2 * k) * SECOND_NS), theirs, ours, climb)
        frame.take_height(height, may_follow=may_follow, may_choose=may_choose)


def test_at_first_what_is_sent_is_as_high_as_the_autopilot_takes_the_vehicle_to_be():
    """Its receiver said 4 m too much when its origin was set: it must not climb at the switch."""
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    heights(frame, 0.0, 0.2, theirs=493.5, ours=489.5)
    assert frame.datum == pytest.approx(4.0)
    _x, _y, z = sent(frame, 0.0, 0.0, 4.0)  # we are at 489.5 m
    assert THEIRS[2] - z == pytest.approx(493.5)
    # and who reads GPS_GLOBAL_ORIGIN beside it finds the truth
    assert frame.counts_from(OURS)[2] - z == pytest.approx(489.5)


def test_a_datum_stays_while_the_autopilots_height_is_ours():
    """Else its lag in a climb, and its noise, would lead what it is sent away."""
    for may_choose in (False, True):
        frame = AutopilotFrame(Family.ARDUPILOT)
        frame.set_origin(THEIRS)
        heights(frame, 0.0, 0.2, 493.5, 489.5)
        heights(frame, 0.2, 60.0, 493.7, 489.5, may_choose=may_choose)
        heights(frame, 60.0, 90.0, 498.0, 495.5, climb=3.0, may_choose=may_choose)
        assert frame.datum == pytest.approx(4.0)


def test_one_that_is_on_its_own_barometer_is_followed_before_it_is_switched_to_ours():
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    heights(frame, 0.0, 0.2, 493.5, 493.5)
    heights(frame, 0.2, 12.0, 505.5, 501.5)
    assert frame.datum == pytest.approx(4.0, abs=0.06)


def test_one_that_has_no_choice_and_does_not_follow_is_not_met_half_way():
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    heights(frame, 0.0, 0.2, 493.5, 493.5)
    heights(frame, 0.2, 12.0, 505.5, 501.5, may_choose=False)
    assert frame.datum == 0.0


def test_what_it_drifted_by_on_its_barometer_while_nothing_was_sent_is_kept():
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    heights(frame, 0.0, 0.2, 493.5, 493.5, may_choose=False)
    heights(frame, 0.2, 10.0, 494.5, 493.5, may_choose=False, may_follow=False)
    assert frame.datum == pytest.approx(1.0, abs=0.01)


def test_after_a_reboot_it_counts_from_ours_until_it_tells_its_own():
    frame = AutopilotFrame(Family.ARDUPILOT)
    frame.set_origin(THEIRS)
    heights(frame, 0.0, 0.2, 493.5, 489.5)
    frame.forget()
    assert frame.counts_from(OURS) == OURS
    assert sent(frame, 3.0, 4.0, -5.0)[2] == pytest.approx(-5.0)
