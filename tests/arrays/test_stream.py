"""The estimator fed by hand, sample by sample."""

import numpy as np
import pytest

from ekf_companion import Stream, estimate
from ekf_companion.arrays.stream import CHECKED, TIMES_CHECKED
from ekf_companion.errors import ConfigError, DataError
from ekf_companion.nav.state import Status
from tests.arrays.test_run import Flown


def test_a_flight_sample_by_sample_is_the_same_as_at_once():
    flown = Flown()
    at_once = estimate(flown.time, flown.gyro, flown.accel, gnss=flown.gnss, mag=flown.mag)
    stream, found = Stream(), []
    fixes = [(t, "fix", k) for k, t in enumerate(flown.gnss["time"])]
    fields = [(t, "field", k) for k, t in enumerate(flown.mag["time"])]
    samples = [(t, "imu", k) for k, t in enumerate(flown.time)]
    order = {"fix": 0, "field": 1, "imu": 2}
    for t, kind, k in sorted(fixes + fields + samples, key=lambda one: (one[0], order[one[1]])):
        if kind == "fix":
            g = flown.gnss
            place = {name: float(g[name][k]) for name in ("lat_deg", "lon_deg", "alt")}
            stds = {name: float(g[name][k]) for name in ("std_h", "std_v", "std_vel")}
            stream.gnss(t, **place, **stds, vel_n=g["vel_n"][k])
        elif kind == "field":
            stream.mag(t, flown.mag["field"][k])
        elif (now := stream.imu(t, flown.gyro[k], flown.accel[k])) is not None:
            found.append(now)
    assert [one.t_ns for one in found] == at_once.t_ns.tolist()
    last = found[-1]
    assert last.status is Status.OK
    assert last.pos_n == pytest.approx(at_once.pos_n[-1], abs=1e-9)
    assert last.euler == pytest.approx(at_once.euler[-1], abs=1e-9)
    place = (last.lat_deg, last.lon_deg, last.alt)
    at_once_place = (at_once.lat_deg[-1], at_once.lon_deg[-1], at_once.alt[-1])
    assert place == pytest.approx(at_once_place, abs=1e-9)
    assert stream.origin == pytest.approx(at_once.origin, abs=1e-9)
    assert last.sigma == pytest.approx(at_once.sigma[-1], abs=1e-9)


def test_a_declared_aid_is_taken_by_its_name():
    flown = Flown()
    by_method, by_name = Stream(), Stream()
    for t, alt in zip(flown.baro["time"].tolist(), flown.baro["alt"].tolist(), strict=True):
        by_method.baro(t, alt)
        by_name.aid("baro", t, alt=alt)
    for t, gyro, accel in zip(flown.time, flown.gyro, flown.accel, strict=True):
        last = [stream.imu(t, gyro, accel) for stream in (by_method, by_name)]
    assert np.isfinite(last[0].pos_n[2])
    assert np.array_equal(last[0].pos_n, last[1].pos_n, equal_nan=True)
    by_name.aid("range_finder", flown.time[-1], range=2.5)
    by_name.aid("anchor_range", flown.time[-1], range=2.5, anchor=3)
    by_name.aid("optical_flow", flown.time[-1], flow_x=0.1, flow_y=0.2)
    with pytest.raises(ConfigError, match="aids: sonar: there is none of this name; known are "):
        by_name.aid("sonar", 1.0, range=1.0)
    with pytest.raises(ConfigError, match="range_finder: height: known are range, std"):
        by_name.aid("range_finder", 1.0, height=1.0)
    with pytest.raises(DataError, match=r"range_finder: needs range \(m\)"):
        by_name.aid("range_finder", 1.0, std=1.0)


def test_the_first_samples_must_be_plausible():
    still = np.zeros(3)
    for accel in ((0.0, 0.0, 9.81), (0.0, 0.0, -1.0)):
        stream = Stream()
        for k in range(CHECKED - 1):
            stream.imu(0.01 * k, still, accel)
        with pytest.raises(DataError, match="accel: "):
            stream.imu(0.01 * CHECKED, still, accel)
        for k in range(300):
            Stream(check=False).imu(0.01 * k, still, accel)


@pytest.mark.parametrize(
    ("gyro", "accel", "sentence"),
    [
        ((np.nan,) * 3, (0.0, 0.0, -9.81), "gyro: all 200 rows are NaN or infinity"),
        ((0.0,) * 3, (0.0, 0.0, np.inf), "in each row one of the two holds NaN"),
        ((0.0, 300.0, 0.0), (0.0, 0.0, -9.81), r"it looks like deg/s; give np\.deg2rad\(gyro\)"),
        ((0.0,) * 3, (0.0, 0.0, -1.0), r"looks like g; give np\.multiply\(accel, 9\.80665\)"),
        ((0.0,) * 3, (0.0, 0.0, 9.81), r"hang upside down, Stream\(check=False\)"),
    ],
)
def test_mistakes_in_the_first_samples_are_said_with_what_a_stream_takes(gyro, accel, sentence):
    with pytest.raises(DataError, match=sentence):
        feed(Stream(), [0.01 * k for k in range(CHECKED)], gyro, accel)


def test_what_was_not_used_is_counted():
    stream = Stream()
    feed(stream, [0.01 * k for k in range(300)])
    assert stream.dropped == {}
    assert stream.imu(3.0, (np.nan, 0.0, 0.0), (0.0, 0.0, -9.81)) is None
    assert stream.imu(3.01, (0.0, 0.0, 500.0), (0.0, 0.0, -9.81)) is None
    assert stream.imu(2.99, np.zeros(3), (0.0, 0.0, -9.81)) is None
    stream.baro(0.1, 5.0)
    assert stream.dropped == {"imu": 3, "baro": 1}


def test_fixes_of_long_before_are_refused_also_if_they_came_first():
    place = {"lat_deg": 47.4, "lon_deg": 8.5, "alt": 488.0}
    stream, insisted = Stream(), Stream(check=False)
    for one in (stream, insisted):
        for k in range(5):
            one.gnss(4000.0 + k, **place)
    times = [7600.0 + 0.01 * k for k in range(TIMES_CHECKED)]
    with pytest.raises(DataError, match=r"gnss: its time, 4004\.000 s, is far from that of the"):
        feed(stream, times)
    feed(insisted, times)


def test_mistakes_are_said():
    stream = Stream()
    with pytest.raises(DataError, match="no place on the Earth, in degrees"):
        stream.gnss(0.0, lat_deg=473977420.0, lon_deg=8.5, alt=488.0)
    with pytest.raises(DataError, match=r"give np\.deg2rad"):
        stream.heading(0.0, 90.0)
    with pytest.raises(DataError, match="gyro: must be three numbers"):
        stream.imu(0.0, [1.0], [0.0, 0.0, -9.81])


@pytest.mark.parametrize(
    ("taken", "sentence"),
    [
        (lambda t: t * 1e3, r"taken as s, inertial samples come at 0\.1 Hz.*looks like ms"),
        (lambda t: t * 1e6, "it looks like us"),
        (lambda t: (t + 1.7e9) * 1e3, "is beyond every clock; floats are s and whole numbers ns"),
        (lambda t: round(t * 1e3), "taken as ns, .*it looks like ms"),
        (lambda t: round(t * 1e6), "it looks like us"),
        (lambda t: float("nan"), "time: nan is no time"),
    ],
)
def test_times_in_another_unit_are_refused_after_ten_samples(taken, sentence):
    with pytest.raises(DataError, match=sentence):
        feed(Stream(), [taken(500.0 + 0.01 * k) for k in range(TIMES_CHECKED)])


def feed(stream, times, gyro=(0.0, 0.0, 0.0), accel=(0.0, 0.0, -9.81)):
    for t in times:
        stream.imu(t, gyro, accel)


def test_times_since_1970_and_late_measurements_are_no_mistake():
    stream = Stream()
    for k in range(300):
        t_ns = round((1.7e9 + 0.01 * k) * 1e9)
        feed(stream, [t_ns])
        stream.baro(t_ns - 1_000_000_000, 5.0)
    assert stream.pipeline.health().samples == 300


@pytest.mark.parametrize("late", [lambda t: t * 1e3, lambda t: round(t * 1e3)])
def test_fixes_on_another_clock_are_refused(late):
    stream = Stream()
    place = {"lat_deg": 47.4, "lon_deg": 8.5, "alt": 488.0}
    for k in range(TIMES_CHECKED):
        stream.imu(100.0 + 0.01 * k, np.zeros(3), (0.0, 0.0, -9.81))
    stream.gnss(99.0, **place)
    with pytest.raises(DataError, match=r"gnss: its time, .* is far from that of the inertial"):
        stream.gnss(late(100.1), **place)
