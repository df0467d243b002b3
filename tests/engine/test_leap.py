"""An azimuth that leaps while the gyro says nothing does not win by waiting."""

import numpy as np
import pytest

from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status
from tests.core.flights import between, changed, flight
from tests.engine.estimation import errors, run

LEAP = 40.0
"""s after the first sample."""


def turned(events: Events, angle) -> Events:
    """Turn the magnetic field about down by an angle (deg) at each time (s)."""
    values = events.values.copy()
    rows = events.kind == Kind.MAG
    a = np.radians(angle((events.t_ns[rows] - events.t_ns[0]) * 1e-9))
    x, y = values[rows, 0].copy(), values[rows, 1].copy()
    values[rows, 0] = np.cos(a) * x + np.sin(a) * y
    values[rows, 1] = np.cos(a) * y - np.sin(a) * x
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def leap(size: float, end: float = np.inf):
    return lambda t: np.where((t >= LEAP) & (t < end), size, 0.0)


def flown(change, name="hover"):
    """Return the yaw's error (deg), where it is called good and is not, and the pipeline."""
    events, truth = flight(name, duration=90.0, noise=(0.3, 0.3))
    table, pipeline = run(change(events))
    found = errors(table, truth, 0.0)
    yaw, sigma = (np.degrees(found[key][:, 2]) for key in ("euler", "sd_euler"))
    is_ok = table.column("status")[-len(yaw) :] == Status.OK
    return yaw, is_ok & (np.abs(yaw) > np.maximum(5.0 * sigma, 5.0)), pipeline


@pytest.mark.parametrize("size", [128.0, -40.0, 180.0])
@pytest.mark.parametrize("end", [np.inf, 65.0])
def test_in_a_hover_the_yaw_stays_whether_the_compass_comes_back_or_not(size, end):
    yaw, lies, pipeline = flown(lambda events: turned(events, leap(size, end)))
    assert np.abs(yaw[3000:]).max() < 5.0
    assert not lies.any()
    assert pipeline.resets == 0


def test_a_leap_behind_a_field_that_was_not_the_earths_is_one_too():
    def change(events):
        strong = events.values.copy()
        rows = between(events, LEAP, LEAP + 15.0) & (events.kind == Kind.MAG)
        strong[rows, :3] *= 2.0
        return turned(Events(t_ns=events.t_ns, kind=events.kind, values=strong), leap(128.0))

    yaw, lies, _ = flown(change)
    assert np.abs(yaw[3000:]).max() < 5.0
    assert not lies.any()


def test_a_gyro_that_turns_by_itself_does_not_win_against_the_compass():
    def change(events):
        rows = between(events, LEAP, LEAP + 20.0) & (events.kind == Kind.IMU)
        return changed(events, rows, 2, np.radians(3.0))

    yaw, lies, _ = flown(change)
    assert np.abs(yaw[3000:]).max() < 10.0
    assert not lies.any()


@pytest.mark.parametrize("size", [128.0, -40.0])
def test_in_motion_the_receiver_shows_which_of_the_two_is_right(size):
    yaw, lies, _ = flown(lambda events: turned(events, leap(size)), "figure-eight")
    assert np.abs(yaw[3000:]).max() < 5.0
    assert not lies.any()
