import functools
import math

import numpy as np
import pytest

from ekf_companion.nav.earth import LocalFrame
from sim_autopilot.config import (
    AirspeedConfig,
    FlowConfig,
    RangeFinderConfig,
    SimConfig,
    WheelConfig,
)
from sim_autopilot.faults.fault import KINDS, Layer, parse
from sim_autopilot.faults.sensors import SensorFaults
from sim_autopilot.flight import Flight

WHEN = "start=2,duration=3"
INSIDE = range(499, 1249)
"""Cycles of the fault: those whose time is in [2, 5) s."""


@functools.cache
def flight():
    config = SimConfig(
        range_finder=RangeFinderConfig(fitted=True),
        airspeed=AirspeedConfig(fitted=True),
        wheel=WheelConfig(fitted=True),
        flow=FlowConfig(fitted=True),
    )
    return Flight.plan("figure-eight", config, duration=8.0, skip=15.0)


@functools.cache
def right():
    return list(flight().cycles())


@functools.cache
def faulty(*texts):
    faults = SensorFaults([parse(text) for text in texts], flight().first_ns - flight().period_ns)
    return [faults.apply(cycle) for cycle in right()]


def offsets(text):
    """Return time and shift (north, east, down) of each fix."""
    home = SimConfig().home
    frame = LocalFrame(math.radians(home.lat), math.radians(home.lon), home.alt)
    rows = []
    for was, now in zip(right(), faulty(text), strict=True):
        if was.fix is not None and now.fix is not None:
            ned = [
                frame.to_ned(*(np.array([value]) for value in (fix.lat, fix.lon, fix.alt)))[0]
                for fix in (was.fix, now.fix)
            ]
            rows.append(((was.number + 1) * 0.004, *(ned[1] - ned[0])))
    return np.array(rows)


@pytest.mark.parametrize("kind", [k for k, v in KINDS.items() if v.layer is Layer.SENSOR])
def test_a_fault_leaves_alone_what_is_before_and_after_it_and_changes_what_is_inside(kind):
    differing = [
        was.number for was, now in zip(right(), faulty(f"{kind}:{WHEN}"), strict=True) if was != now
    ]
    assert differing
    assert set(differing) <= set(INSIDE)


def test_an_outage_is_silent_or_says_so():
    assert all(faulty(f"gnss-outage:{WHEN}")[k].fix is None for k in INSIDE)
    lost = [faulty(f"gnss-outage:{WHEN},how=nofix")[k].fix for k in INSIDE]
    were = [right()[k].fix for k in INSIDE]
    for fix, was in zip(lost, were, strict=True):
        assert fix == (None if was is None else was._replace(fix_type=0))


def test_a_jump_moves_the_fixes_by_metres():
    rows = offsets(f"gnss-jump:{WHEN},north=-3,east=50,down=2")
    moved = rows[(rows[:, 0] >= 2) & (rows[:, 0] < 5)]
    np.testing.assert_allclose(moved[:, 1:], [[-3, 50, 2]] * len(moved), atol=0.01)


def test_a_drag_grows_with_time_and_its_velocity_agrees():
    text = f"gnss-drag:{WHEN},speed=2,course=180"
    rows = offsets(text)
    moved = rows[(rows[:, 0] >= 2) & (rows[:, 0] < 5)]
    np.testing.assert_allclose(moved[:, 1], -2 * (moved[:, 0] - 2), atol=0.01)
    for k in INSIDE:
        was, now = right()[k].fix, faulty(text)[k].fix
        if was is not None and now is not None:
            assert now.vel_n == pytest.approx((was.vel_n[0] - 2, was.vel_n[1], was.vel_n[2]))


def test_a_frozen_fix_goes_on_in_time_or_not():
    last = [c.fix for c in right()[:499] if c.fix is not None][-1]
    for time in ("advancing", "same"):
        text = f"gnss-frozen:{WHEN},time={time}"
        fixes = [faulty(text)[k].fix for k in INSIDE if right()[k].fix is not None]
        assert len(fixes) == 15
        assert {fix._replace(t_ns=0) for fix in fixes} == {last._replace(t_ns=0)}
        assert len({fix.t_ns for fix in fixes}) == (15 if time == "advancing" else 1)


def test_saturation_ends_the_scale():
    clipped = [faulty(f"imu-saturation:{WHEN},gyro=0.2,accel=9")[k] for k in INSIDE]
    gyro, accel = (np.array([getattr(c, n) for c in clipped]) for n in ("gyro_b", "accel_b"))
    assert np.abs(gyro).max() == 0.2
    assert np.abs(accel).max() == 9.0


def test_stuck_samples_repeat_the_last_right_one():
    found = {(c.gyro_b, c.accel_b) for c in (faulty(f"imu-stuck:{WHEN}")[k] for k in INSIDE)}
    assert found == {(right()[498].gyro_b, right()[498].accel_b)}


def test_samples_can_be_no_numbers_or_none_at_all():
    for k in INSIDE:
        assert all(map(math.isnan, faulty(f"imu-nan:{WHEN}")[k].gyro_b))
        assert all(map(math.isnan, faulty(f"imu-nan:{WHEN}")[k].accel_b))
        assert not faulty(f"imu-gap:{WHEN}")[k].has_imu


def test_the_field_and_the_pressure_are_shifted():
    fields = [(right()[k].mag_b, faulty(f"mag-disturbance:{WHEN}")[k].mag_b) for k in INSIDE]
    for was, now in fields:
        if was is not None:
            assert now == pytest.approx((was[0] + 0.3, was[1], was[2]))
    steps = [(right()[k].baro, faulty(f"baro-step:{WHEN}")[k].baro) for k in INSIDE]
    for was, now in steps:
        if was is not None:
            assert now[1] == was[1] + 20.0
            assert was[0] - now[0] == pytest.approx(2.25, abs=0.1)  # hPa in 20 m at 500 m


def test_a_frozen_pitot_tube_or_wheel_repeats_its_last_reading():
    for kind, field in (("pitot-frozen", "airspeed"), ("wheel-frozen", "wheel_m")):
        found = {getattr(faulty(f"{kind}:{WHEN}")[k], field) for k in INSIDE}
        assert found == {getattr(right()[INSIDE[0]], field)}


def test_a_pitot_tube_that_is_shut_reads_more_the_higher_the_vehicle_is():
    shut = [faulty(f"pitot-blocked:{WHEN}")[k] for k in INSIDE]
    begin = shut[0]
    for one in shut[::50]:
        # hydrostatic, of air of 1.17 kg/m^3
        more = 2.0 * 9.81 * 1.17 / 1.225 * (one.truth.alt - begin.truth.alt)
        assert one.airspeed == pytest.approx(np.sqrt(begin.airspeed**2 + more), abs=0.5)
    noise = np.diff([one.airspeed for one in shut])
    assert 0.0 < np.std(noise) < 0.2


def test_wheels_that_slip_turn_further_and_a_scale_is_a_factor():
    slip = f"wheel-slip:{WHEN},speed=2"
    gained = [faulty(slip)[k].wheel_m - right()[k].wheel_m for k in (INSIDE[0], INSIDE[-1])]
    assert gained == pytest.approx([0.0, 6.0], abs=0.01)
    k = INSIDE[100]
    assert faulty(f"pitot-scale:{WHEN},factor=-1")[k].airspeed == -right()[k].airspeed


def test_what_comes_late_is_what_was_read_before():
    for name, field in (("range", "range_m"), ("pitot", "airspeed"), ("wheel", "wheel_m")):
        late = faulty(f"{name}-late:{WHEN},delay=0.2")
        found = [getattr(late[k], field) for k in INSIDE]
        assert found == [getattr(right()[k - 50], field) for k in INSIDE]
    late = [faulty(f"flow-late:{WHEN},delay=0.2")[k].flow for k in INSIDE]
    were = [right()[k - 50].flow for k in INSIDE]
    assert [one and one.rate for one in late] == [one and one.rate for one in were]
    assert {
        one.t_ns - was.t_ns for one, was in zip(late, were, strict=True) if was is not None
    } == {200_000_000}


def test_ranges_and_airspeeds_step_drift_and_have_a_scale():
    last = INSIDE[-1]
    for text, field, expected in (
        ("range-step:by=-5", "range_m", lambda read: read - 5.0),
        ("range-drift:speed=0.4", "range_m", lambda read: read + 1.2),
        ("range-scale:factor=1.2", "range_m", lambda read: 1.2 * read),
        ("pitot-drift:speed=-0.2", "airspeed", lambda read: read - 0.6),
    ):
        kind, _, value = text.partition(":")
        found = getattr(faulty(f"{kind}:{WHEN},{value}")[last], field)
        assert found == pytest.approx(expected(getattr(right()[last], field)), abs=0.01)


def test_wheels_of_another_size_gain_way_in_proportion():
    found = faulty(f"wheel-scale:{WHEN},factor=1.5")
    begin, end = (right()[k].wheel_m for k in (INSIDE[0], INSIDE[-1]))
    assert found[INSIDE[0]].wheel_m == begin
    assert found[INSIDE[-1]].wheel_m == pytest.approx(begin + 1.5 * (end - begin))


def test_a_flow_sensor_that_is_turned_turns_its_gyro_too():
    turned = faulty(f"flow-turned:{WHEN},yaw=90")
    flows = [(right()[k].flow, turned[k].flow) for k in INSIDE if right()[k].flow is not None]
    for was, now in flows:
        for before, after in ((was.rate, now.rate), (was.gyro, now.gyro)):
            assert after == pytest.approx((before[1], -before[0]))


def test_stamps_of_the_flow_jitter_in_whole_microseconds():
    jittered = faulty(f"flow-jitter:{WHEN},std=0.02")
    offs = [
        jittered[k].flow.t_ns - right()[k].flow.t_ns for k in INSIDE if right()[k].flow is not None
    ]
    assert 0.01e9 < np.std(offs) < 0.03e9
    assert not np.any(np.array(offs) % 1000)


def test_faults_can_overlap():
    both = faulty(f"imu-nan:{WHEN}", f"gnss-outage:{WHEN}")
    assert all(math.isnan(both[k].gyro_b[0]) and both[k].fix is None for k in INSIDE)


def test_a_board_that_is_mounted_upside_down_measures_and_believes_so():
    for k in INSIDE[::100]:
        was, now = right()[k], faulty(f"mounting:{WHEN},roll=180")[k]
        forward, side, down = was.accel_b
        assert now.accel_b == pytest.approx((forward, -side, -down))
        assert now.truth == was.truth
        turned = was.estimate.euler[0] + math.pi - now.estimate.euler[0]
        assert math.remainder(turned, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_a_board_that_is_mounted_turned_feels_the_force_elsewhere():
    was, now = right()[800], faulty(f"mounting:{WHEN},roll=0,yaw=90")[800]
    forward, side, down = was.accel_b
    assert now.accel_b == pytest.approx((side, -forward, down))


def test_an_own_estimate_that_is_off_leaves_the_sensors_alone():
    was, now = right()[800], faulty(f"own-estimate:{WHEN},heading=34,north=100,down=-20")[800]
    assert now._replace(estimate=was.estimate) == was
    turned = math.degrees(now.estimate.euler[2] - was.estimate.euler[2])
    assert turned % 360.0 == pytest.approx(34.0)
    assert (now.estimate.lat - was.estimate.lat) * 6.37e6 == pytest.approx(100.0, rel=0.01)
    assert now.estimate.alt - was.estimate.alt == pytest.approx(20.0)


def test_accelerometers_that_drift_are_off_by_more_and_more():
    text = f"accel-drift:{WHEN},forward=0.1"
    offs = [faulty(text)[k].accel_b[0] - right()[k].accel_b[0] for k in (INSIDE[0], INSIDE[-1])]
    assert offs == pytest.approx([0.0, 0.3], abs=0.002)
