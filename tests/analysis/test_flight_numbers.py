"""Errors, way, speed, vibration and clipping of a flight, against what is known of it."""

import numpy as np
import pytest

from ekf_companion.analysis.flight_numbers import motion, numbers, vibration
from ekf_companion.nav.event_columns import EventColumns, MergedEvents, sources_of
from ekf_companion.nav.measurements import Kind
from ekf_companion.nav.state import COLUMNS, Status, Table, Trajectory

METRE = 1.0 / 6_371_000.0


def table(t_s, north, east, status=Status.OK, resets=0.0):
    """Return estimates of a level flight about 47.4, 8.5 deg."""
    values = np.full((len(t_s), len(COLUMNS) - 1), np.nan)
    columns = {
        "lat_deg": 47.4 + np.rad2deg(north * METRE),
        "lon_deg": 8.5 + np.rad2deg(east * METRE / np.cos(np.deg2rad(47.4))),
        "alt_m": 500.0 + 0.0 * t_s,
        "vel_n": np.gradient(north, t_s),
        "vel_e": np.gradient(east, t_s),
        "vel_d": 0.0 * t_s,
        **{"q_w": 1.0 + 0.0 * t_s, "q_x": 0.0 * t_s, "q_y": 0.0 * t_s, "q_z": 0.0 * t_s},
        "status": status + 0.0 * t_s,
        "reset_count": resets + 0.0 * t_s,
    }
    for name, column in columns.items():
        values[:, COLUMNS.index(name) - 1] = column
    return Table(stamp_ns=np.rint(t_s * 1e9).astype(np.int64), values=values)


def samples(t_s, accel, gyro=None):
    """Return inertial samples, shapes (n, 3)."""
    gyro = np.zeros_like(accel) if gyro is None else gyro
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    columns = EventColumns(t_ns, Kind.IMU, *gyro.T, *accel.T)
    merged = MergedEvents(sources_of([(columns, np.arange(len(t_s)))]))
    return merged.take(np.arange(len(t_s)))


def test_a_circle_is_as_long_as_it_is_and_who_stands_goes_nowhere():
    t_s = np.arange(0.0, 100.0, 0.1)
    turn = 2.0 * np.pi * t_s / 100.0
    found = motion(table(t_s, 50.0 * np.sin(turn), 50.0 * np.cos(turn)))
    assert found.way == pytest.approx(2.0 * np.pi * 50.0, rel=0.01)
    assert found.top_speed == pytest.approx(np.pi, rel=0.01)
    assert found.height == 0.0
    rng = np.random.default_rng(1)
    still = motion(table(t_s, *(0.1 * rng.standard_normal((2, len(t_s))))))
    assert still.way < 2.0


def test_a_jump_and_a_gap_are_no_way():
    t_s = np.concatenate([np.arange(0.0, 50.0, 0.1), np.arange(80.0, 130.0, 0.1)])
    north = 2.0 * t_s + np.where(t_s > 100.0, 500.0, 0.0)
    found = motion(table(t_s, north, 0.0 * t_s, resets=np.where(t_s > 100.0, 1.0, 0.0)))
    assert found.way == pytest.approx(200.0, abs=5.0)


def test_who_has_no_position_has_no_way():
    t_s = np.arange(0.0, 10.0, 0.1)
    found = motion(table(t_s, 0.0 * t_s, 0.0 * t_s, status=Status.ATTITUDE))
    assert np.isnan([found.way, found.top_speed, found.height]).all()


def test_errors_have_the_sizes_that_they_have_and_the_start_does_not_count():
    t_s = np.arange(0.0, 60.0, 0.05)
    ours = table(t_s, 3.0 * t_s + np.where(t_s < 15.0, 40.0, 0.6), 0.0 * t_s)
    truth = table(t_s, 3.0 * t_s, 0.0 * t_s)
    lat, lon, alt = (truth.column(name) for name in ("lat_deg", "lon_deg", "alt_m"))
    other = Trajectory(
        name="simulator (SIM_STATE)",
        pos_t_ns=truth.stamp_ns,
        lat=np.deg2rad(lat),
        lon=np.deg2rad(lon),
        alt=alt + 2.0,
    )
    found = numbers(ours, [other], samples(t_s, np.zeros((len(t_s), 3))))
    (one,) = found.errors
    assert found.settled
    assert one.horizontal.rms == pytest.approx(0.6, abs=0.01)
    assert one.horizontal.largest == pytest.approx(0.6, abs=0.01)
    assert one.vertical.rms == pytest.approx(2.0, abs=0.01)
    assert one.vertical_about_mean.rms == pytest.approx(0.0, abs=0.01)
    # An estimate that says that it is invalid is never sent, and does not count
    is_bad = (t_s > 40.0) & (t_s < 45.0)
    wild = table(t_s, 3.0 * t_s + np.where(is_bad, 900.0, 0.6), 0.0 * t_s)
    wild.column("status")[is_bad] = Status.INVALID
    (one,) = numbers(wild, [other], samples(t_s, np.zeros((len(t_s), 3)))).errors
    assert one.horizontal.largest == pytest.approx(0.6, abs=0.01)
    short = numbers(
        table(t_s[:300], 3.0 * t_s[:300], 0.0 * t_s[:300]),
        [other],
        samples(t_s, np.zeros((len(t_s), 3))),
    )
    assert not short.settled
    assert short.errors[0].horizontal.count > 100


@pytest.mark.parametrize("rate", [50.0, 100.0, 250.0, 1000.0])
def test_a_shaking_is_as_large_as_it_is_and_motion_is_none(rate):
    t_s = np.arange(0.0, 30.0, 1.0 / rate)
    accel = np.zeros((len(t_s), 3))
    accel[:, 0] = 5.0 * np.sin(2.0 * np.pi * 0.2 * t_s)  # a manoeuvre
    size = np.where((t_s >= 20.0) & (t_s < 21.0), 8.0, 4.0)
    accel[:, 2] = -9.81 + size * np.sqrt(2.0) * np.sin(2.0 * np.pi * 17.0 * t_s)
    found = vibration(samples(t_s, accel))
    assert found.rate == pytest.approx(rate)
    assert found.accel[0] < 0.1
    assert found.accel[2] == pytest.approx(4.2, abs=0.3)
    assert found.worst == pytest.approx(8.0, abs=0.6)
    assert found.worst_ns == pytest.approx(20e9, abs=1e8)
    assert (found.accel_clipped, found.gyro_clipped) == (0, 0)


def test_the_end_of_a_range_is_clipping_and_the_top_of_a_smooth_motion_is_none():
    t_s = np.arange(0.0, 20.0, 0.004)
    rng = np.random.default_rng(2)
    accel = 60.0 * rng.standard_normal((len(t_s), 3))
    cut = np.clip(accel, -78.5, 78.5)
    found = vibration(samples(t_s, cut, np.round(3.0 * np.sin(t_s), 3)[:, None] * np.ones(3)))
    alone = np.abs(accel) > 78.5
    assert 0.5 * np.count_nonzero(alone) * 0.2 < found.accel_clipped < np.count_nonzero(alone)
    assert found.gyro_clipped == 0
    assert vibration(samples(t_s, accel)).accel_clipped == 0
    assert vibration(samples(t_s, np.tile([0.0, 0.0, -9.81], (len(t_s), 1)))).accel_clipped == 0


def test_a_gap_is_no_shaking_and_too_few_samples_tell_nothing():
    t_s = np.concatenate([np.arange(0.0, 10.0, 0.01), np.arange(30.0, 40.0, 0.01)])
    accel = np.zeros((len(t_s), 3))
    accel[t_s > 20.0] = 9.0  # another attitude after the gap
    found = vibration(samples(t_s, accel))
    assert max(found.accel) < 1e-9
    assert vibration(samples(t_s[:5], accel[:5])) is None
    assert vibration(samples(np.arange(0.0, 90.0, 0.2), np.zeros((450, 3)))) is None
