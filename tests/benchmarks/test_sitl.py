"""The score of flights in the autopilots' simulators, and what is printed without one."""

import subprocess
import sys

import numpy as np
import pytest

from benchmarks.sitl.pilot import figure_eight, square
from benchmarks.sitl.score import pooled, right_after, score
from benchmarks.sitl.tracks import Track


def track(lead=0.0, offset=0.0, yaw=0.0):
    """Return a circle of 10 m at 5 m/s that is ahead of the truth, displaced and turned."""
    t = np.arange(0.0, 40.0, 0.02)
    a = 0.5 * (t + lead)
    pos_n = np.stack([10.0 * np.cos(a) + offset, 10.0 * np.sin(a), np.full(len(t), -12.0)], axis=1)
    vel_n = np.stack([-5.0 * np.sin(a), 5.0 * np.cos(a), np.zeros(len(t))], axis=1)
    euler = np.stack([np.zeros(len(t)), np.zeros(len(t)), np.full(len(t), yaw)], axis=1)
    return Track(t=t, pos_n=pos_n, vel_n=vel_n, att_t=t, euler=euler)


def test_a_constant_offset_of_the_frames_is_no_error():
    found = score(track(offset=3.0), track(), 5.0, 35.0)
    assert found.horizontal == pytest.approx(0.0, abs=1e-9)
    assert found.velocity == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lead", [-0.033, 0.0, 0.050])
def test_the_lead_is_found_and_counts_in_position_and_velocity(lead):
    found = score(track(lead=lead), track(), 5.0, 35.0)
    assert found.lead == pytest.approx(lead, abs=0.002)
    assert found.horizontal == pytest.approx(abs(lead) * 5.0, abs=0.02)
    assert found.velocity == pytest.approx(abs(lead) * 2.5, abs=0.02)


def test_a_heading_that_differs_by_whole_turns_is_no_error():
    found = score(track(yaw=2.0 * np.pi + np.deg2rad(3.0)), track(), 5.0, 35.0)
    assert found.yaw == pytest.approx(3.0, abs=1e-6)


def test_a_vehicle_that_stands_shows_no_lead():
    still = track()
    still = Track(
        t=still.t,
        pos_n=0.0 * still.pos_n,
        vel_n=0.0 * still.vel_n,
        att_t=still.att_t,
        euler=still.euler,
    )
    assert score(still, still, 5.0, 35.0).lead is None


def test_flights_pooled_are_as_one_long_flight():
    quiet, busy = track(lead=0.02, yaw=0.01), track(lead=-0.06, yaw=0.03)
    each = [score(one, track(), 5.0, 35.0) for one in (quiet, busy)]
    both = pooled(each)
    assert both.yaw == pytest.approx(np.rad2deg(np.sqrt((0.01**2 + 0.03**2) / 2.0)))
    assert both.lead == pytest.approx(-0.06, abs=0.002)
    assert both.horizontal_max == each[1].horizontal_max > each[0].horizontal_max


def test_a_place_is_right_again_after_its_last_large_error():
    wrong = track(offset=3.0)
    wrong.pos_n[(wrong.t >= 20.0) & (wrong.t < 24.5), 1] += 5.0
    assert right_after(wrong, track(), (5.0, 15.0), 22.0, 1.0) == pytest.approx(2.5, abs=0.03)
    assert right_after(wrong, track(), (5.0, 15.0), 25.0, 1.0) == 0.0
    wrong.pos_n[wrong.t >= 24.5, 1] += 5.0
    assert right_after(wrong, track(), (5.0, 15.0), 22.0, 1.0) == np.inf


@pytest.mark.parametrize("make", [square, figure_eight])
def test_the_paths_end_where_they_begin_and_their_velocities_are_their_slopes(make):
    path, seconds = make()
    assert path(0.0)[:2] == pytest.approx(path(seconds)[:2], abs=1e-9)
    for t in np.arange(0.37, seconds - 0.3, 0.83):
        before, after = path(t - 1e-4), path(t + 1e-4)
        slope = [(b - a) / 2e-4 for a, b in zip(before[:2], after[:2], strict=True)]
        assert path(t)[2:] == pytest.approx(slope, abs=1e-3)


def test_without_a_simulator_a_sentence_says_so():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.sitl"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        "PX4: left out; give the path of its simulator: make sitl PX4=PATH",
        "ArduCopter: left out; give the path of its simulator: make sitl ARDUPILOT=PATH",
    ]
