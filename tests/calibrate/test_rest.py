import numpy as np
import pytest

from ekf_companion.calibrate import rest
from ekf_companion.core.settings.settings import AlignSettings
from ekf_companion.nav.measurements import Events, Kind
from tests.calibrate.recordings import fly, joined, without

LIMITS = AlignSettings()


def changed(events, start, end, column, by):
    """Add to a column of the inertial samples from start to end, s after the first event."""
    values = events.values.copy()
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    values[(events.kind == Kind.IMU) & (t >= start) & (t < end), column] += by
    return Events(t_ns=events.t_ns, kind=events.kind, values=values)


def test_a_vehicle_that_stands_is_at_rest_all_the_time():
    stretches = rest.find(fly("static", 60.0).events, LIMITS, 10.0)
    assert sum(stretch.seconds for stretch in stretches) == pytest.approx(60.0, abs=1.5)
    assert np.all(np.diff(stretches[0].t_ns) > 0)


@pytest.mark.parametrize("name", ["hover", "figure-eight", "loiter", "walk"])
def test_nothing_that_moves_is_at_rest(name):
    # all begin with 5 s of rest, a loiter with 11 s
    events = fly(name, 60.0).events
    later = events.take(events.t_ns > events.t_ns[0] + 12_000_000_000)
    assert rest.find(later, LIMITS, 5.0) == []


def test_an_autopilot_that_says_it_flies_is_believed():
    recording = fly("static", 60.0)
    start = recording.events.t_ns[0]
    armed = Events.from_columns(start + np.array([0, 30_000_000_000]), Kind.VEHICLE, [1, 0], [0, 1])
    stretches = rest.find(joined(recording, armed).events, LIMITS, 10.0)
    assert sum(stretch.seconds for stretch in stretches) == pytest.approx(29.5, abs=1.5)


def test_a_receiver_that_says_it_moves_is_believed():
    events = fly("static", 40.0).events
    values = events.values.copy()
    values[events.kind == Kind.GNSS, 3] = 12.0
    moving = Events(t_ns=events.t_ns, kind=events.kind, values=values)
    assert rest.find(moving, LIMITS, 5.0) == []


def test_a_touch_and_a_slow_turn_are_cut_out():
    events = fly("static", 60.0).events
    touched = changed(events, 20.0, 20.2, 3, 0.5)
    assert [round(one.seconds) for one in rest.find(touched, LIMITS, 10.0)] == [20, 39]
    turned = changed(events, 30.0, 40.0, 2, 0.03)
    assert [round(one.seconds) for one in rest.find(turned, LIMITS, 10.0)] == [30, 20]


def test_lost_samples_are_bridged_and_a_gap_is_not():
    events = fly("static", 40.0).events
    t = (events.t_ns - events.t_ns[0]) * 1e-9
    kept = np.ones(len(events), dtype=bool)
    imu = np.flatnonzero(events.kind == Kind.IMU)
    kept[imu[500:502]] = False
    bridged = rest.find(events.take(kept), LIMITS, 10.0)
    assert len(bridged) == 1
    assert np.ptp(np.diff(bridged[0].t_ns)) == 0
    cut = (t > 15.0) & (t < 15.5)
    assert len(rest.find(events.take(~cut), LIMITS, 10.0)) == 2


def test_without_samples_there_is_no_rest_and_no_rate():
    events = without(fly("static", 40.0), Kind.IMU).events
    assert rest.find(events, LIMITS, 5.0) == []
    assert rest.rate(events) == 0.0
    assert rest.rate(fly("static", 40.0).events) == pytest.approx(50.0)
