"""Optical flow: what it is good for without a receiver, and what its faults cost."""

import gzip
from functools import cache

import numpy as np
import pytest

from ekf_companion.core.settings.settings import (
    FilterSettings,
    GnssSettings,
    HeadingSettings,
    OpticalFlowSettings,
)
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs import csv, dataflash, ulog
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.replay.filters_by_name import run_filter
from ekf_companion.replay.read import read
from sim_autopilot import events as wire
from sim_autopilot.config import FlowConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_dataflash import of_kind
from tests.logs.test_ulog import Writer as ULogWriter
from tests.paths import DATA

WITHOUT = FilterSettings(optical_flow=OpticalFlowSettings(use=False))
LAST_FIX, END = 25.0, 60.0
"""s: between them there is no receiver."""


class Flown:
    """A flight over level ground with an optical flow sensor and a range finder."""

    def __init__(self, name="figure-eight", seed=2, **flow):
        config = SimConfig(flow=FlowConfig(fitted=True, **flow))
        flight = Flight.plan(name, config, seed=seed, duration=END)
        events, self.truth = wire.events(flight, has_vel_down=True), wire.truth(flight)
        rng = np.random.default_rng(seed)
        t_ns = np.arange(events.t_ns.min(), events.t_ns.max(), 100_000_000)
        at = np.clip(np.searchsorted(self.truth.att_t_ns, t_ns), 0, len(self.truth.q_nb) - 1)
        upright = so3.to_matrix(self.truth.q_nb[at])[:, 2, 2]
        height = np.interp(t_ns, self.truth.pos_t_ns, self.truth.alt) - config.home.alt
        ranges = np.maximum((height + 0.15) / upright + rng.normal(0.0, 0.05, len(at)), 0.02)
        self.ranges = Events.from_columns(t_ns, Kind.RANGE, ranges, np.full(len(at), np.nan))
        self.first_ns = int(events.t_ns.min())
        is_flow = events.kind == Kind.FLOW
        self.flow, self.others = events.take(is_flow), events.take(~is_flow)

    def fly(self, change=None, settings=None, *, has_range=True):
        """Return the pipeline and, after the last fix, the horizontal errors and their sigmas.

        ``change`` makes other rates of times, s, and rates, shape (n, 2).
        """
        flow = self.flow
        if change is not None:
            values = flow.values.copy()
            t = (flow.t_ns - self.first_ns) * 1e-9
            values[:, :2] = change(t, flow.values[:, :2].copy())
            flow = Events(t_ns=flow.t_ns, kind=flow.kind, values=values)
        t = (self.others.t_ns - self.first_ns) * 1e-9
        kept = self.others.take(~((self.others.kind == Kind.GNSS) & (t > LAST_FIX)))
        parts = [self.ranges] if has_range else []
        recording = merge(kept, flow, *parts)
        pipeline = Pipeline(settings or FilterSettings(), "px4")
        table = pipeline.run(recording)
        lat, lon = (
            np.interp(table.stamp_ns, self.truth.pos_t_ns, one)
            for one in (self.truth.lat, self.truth.lon)
        )
        frame = LocalFrame(float(lat[0]), float(lon[0]), 0.0)
        nothing = np.zeros(len(lat))
        own = (np.radians(table.column(name)) for name in ("lat_deg", "lon_deg"))
        error = frame.to_ned(*own, nothing)[:, :2] - frame.to_ned(lat, lon, nothing)[:, :2]
        late = (table.stamp_ns - self.first_ns) * 1e-9 > LAST_FIX
        std = np.stack([table.column(f"sd_pos_{axis}") for axis in "ne"], axis=1)
        return pipeline, error[late], std[late]


@cache
def flown():
    return Flown()


def test_it_holds_the_position_when_the_receiver_is_gone():
    one = flown()
    _, error, std = one.fly()
    _, without, _ = one.fly(settings=WITHOUT)
    way = 9.0 * (END - LAST_FIX)
    assert np.abs(without).max() > 5.0 * np.abs(error).max()
    assert np.hypot(*error.T).max() < 0.03 * way
    assert (np.abs(error) / std).max() < 4.0


def test_over_where_it_took_off_it_needs_no_range_finder():
    _, error, std = flown().fly(has_range=False)
    _, without, _ = flown().fly(settings=WITHOUT, has_range=False)
    assert np.abs(error).max() < 0.5 * np.abs(without).max()
    assert (np.abs(error) / std).max() < 4.0


def turned(angle):
    c, s = np.cos(angle), np.sin(angle)
    return lambda t, rates: rates @ np.array([[c, s], [-s, c]])


def bursts(t, rates):
    rng = np.random.default_rng(3)
    wild = rng.uniform(-3.0, 3.0, rates.shape)
    return np.where((t % 5.0 < 1.0)[:, None], wild, rates)


FAULTS = {
    "frozen": lambda t, rates: np.where(
        (t > 30.0)[:, None], rates[np.searchsorted(t, 30.0)], rates
    ),
    "wrong sign": lambda t, rates: -rates,
    "x and y exchanged": lambda t, rates: rates[:, ::-1],
    "turned by 90 deg": turned(np.pi / 2.0),
    "turned by 180 deg after 20 s": lambda t, rates: np.where((t > 20.0)[:, None], -rates, rates),
    "in degrees": lambda t, rates: np.degrees(rates),
    "too fast by a half": lambda t, rates: 1.5 * rates,
    "noise alone": lambda t, rates: np.random.default_rng(1).normal(0.0, 1.0, rates.shape),
    "bursts": bursts,
    "late by 0.3 s": lambda t, rates: np.stack(
        [np.interp(t - 0.3, t, one) for one in rates.T], axis=1
    ),
    "zero": lambda t, rates: np.zeros_like(rates),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_with_it_is_within_the_sigma_or_refused(name):
    """While there is a receiver it is refused or learnt, and so counts for nothing without."""
    _, error, std = flown().fly(FAULTS[name])
    assert (np.abs(error) / std).max() < 5.0


@pytest.mark.parametrize("name", ["wrong sign", "turned by 90 deg", "in degrees", "zero"])
def test_what_cannot_be_meant_is_refused_and_counted(name):
    pipeline, _, _ = flown().fly(FAULTS[name])
    counts = pipeline.health().verdicts[Aid.OPTICAL_FLOW]
    used = counts[Verdict.FUSED] + counts[Verdict.DEWEIGHTED]
    assert counts[Verdict.GATED] > 50
    assert used < 0.4 * sum(counts.values())


def test_a_mounting_that_is_declared_is_turned_back():
    one = flown()
    settings = FilterSettings(optical_flow=OpticalFlowSettings(turn=np.pi / 2.0))
    gyro = one.flow.values.copy()
    gyro[:, 2], gyro[:, 3] = one.flow.values[:, 3], -one.flow.values[:, 2]
    before, one.flow = one.flow, Events(t_ns=one.flow.t_ns, kind=one.flow.kind, values=gyro)
    try:
        _, error, std = one.fly(turned(-np.pi / 2.0), settings)
    finally:
        one.flow = before
    assert np.hypot(*error.T).max() < 0.03 * 9.0 * (END - LAST_FIX)
    assert (np.abs(error) / std).max() < 4.0


CUTS = ((60.0, 120.0), (140.0, 200.0), (220.0, 280.0), (300.0, 360.0), (380.0, 440.0))
"""Of the real flight, s: a minute each without a receiver."""


def load(path):
    with gzip.open(path) as file:
        return np.loadtxt(file)


@cache
def park():
    folder = DATA / "flow-sonar-gps-quad-2014"
    if not folder.exists():
        pytest.skip("needs ../shared/data")
    return {one.name.partition(".")[0]: load(one) for one in folder.glob("*.txt.gz")}


def recording(cuts, *, has_flow, has_gyro=True):
    """Return the real flight without the fixes of some stretches.

    Its flow is that of the image, not of the sensor: the other sign. It is a mean of 105 ms.
    """
    tables = park()
    imu, mag, ranges, flow = (tables[name] for name in ("IMU", "MAG", "DIST", "FLOW"))
    fixes, flow = tables["GPS"], flow[flow[:, 4] > 0]
    for begin, end in cuts:
        fixes = fixes[(fixes[:, 0] < begin * 1e3) | (fixes[:, 0] > end * 1e3)]
    ranges = ranges[(ranges[:, 2] > 0) & (ranges[:, 1] > 0.1)]

    def at(ms):
        return np.rint(ms * 1e6).astype(np.int64) + 1_000_000_000

    def nothing(table):
        return np.full(len(table), np.nan)

    course = np.radians(fixes[:, 11])
    velocity = (fixes[:, 10] * np.cos(course), fixes[:, 10] * np.sin(course), fixes[:, 12])
    stds = np.broadcast_to([[2.0], [3.0], [0.3]], (3, len(fixes)))
    place = (*np.radians(fixes[:, 6:8]).T, fixes[:, 8])
    gyro = flow[:, 6:8].T if has_gyro else (nothing(flow), nothing(flow))
    rates = (*-flow[:, 1:3].T, *gyro, flow[:, 4] / 255.0, nothing(flow))
    seen = [Events.from_columns(at(flow[:, 0] - 52.5), Kind.FLOW, *rates)] if has_flow else []
    events = merge(
        Events.from_columns(at(ranges[:, 0]), Kind.RANGE, ranges[:, 1], nothing(ranges)),
        *seen,
        Events.from_columns(at(mag[:, 0]), Kind.MAG, *(1e-3 * (mag[:, 2:5] - mag[:, 5:8])).T),
        Events.from_columns(at(fixes[:, 0]), Kind.GNSS, *place, *velocity, *stds, nothing(fixes)),
        Events.from_columns(at(imu[:, 0]), Kind.IMU, *imu[:, 2:8].T),
    )
    return Recording(family="unknown", events=events)


def positions(*args, **kwargs):
    settings = FilterSettings(
        gnss=GnssSettings(delay=0.21), heading=HeadingSettings(magnetometer_delay=0.03)
    )
    table = run_filter(recording(*args, **kwargs), "eskf", settings).table
    t = (table.stamp_ns - 1_000_000_000) * 1e-9
    pos, std = (
        np.stack([table.column(f"{name}_{axis}") for axis in "ne"], axis=1)
        for name in ("pos", "sd_pos")
    )
    return t, pos, std


@pytest.mark.parametrize("has_gyro", [True, False], ids=["its own gyro", "ours"])
def test_on_a_real_flight_it_carries_over_five_minutes_without_fixes(has_gyro):
    """A park, 2.8 m/s, 3 m up, in 2014; the reference is the same flight with its receiver."""
    t, reference, _ = positions((), has_flow=False)
    _, pos, std = positions(CUTS, has_flow=True, has_gyro=has_gyro)
    _, free, _ = positions(CUTS, has_flow=False)
    for begin, end in CUTS:
        cut = (t > begin) & (t < end)
        way = np.hypot(*np.diff(reference[cut], axis=0).T).sum()
        error = (pos - reference)[cut]
        assert np.hypot(*error.T).max() < 0.03 * way
        assert (np.abs(error) / std[cut]).max() < 3.0
        assert np.hypot(*(free - reference)[cut].T).max() > 0.2 * way


def test_of_every_format_the_flow_is_the_same(tmp_path):
    """At 0.5 s it is seen, at 0.6 s it is not; the .ulg alone says over which interval."""
    expected = (0.3, -0.2, 0.05, 0.1, 0.8)
    found = {
        "csv": of_csv(tmp_path),
        "bin": of_bin(tmp_path),
        "ulg": of_ulg(tmp_path, "vehicle_optical_flow"),
        "ulg of 1.13": of_ulg(tmp_path, "optical_flow"),
    }
    for name, events in found.items():
        assert len(events) == 1, name
        assert events.values[0, :5] == pytest.approx(expected, rel=1e-6), name
        late_ns = 25_000_000 if "ulg" in name else 0
        assert events.t_ns[0] == 500_000_000 - late_ns, name


IMU = (0.0, 0.0, 0.0, 0.0, 0.0, -9.8)


def of_csv(folder):
    path = folder / "flow.csv"
    names = [f"{a}_{b}_{u}" for a, u in (("gyro", "rps"), ("accel", "mps2")) for b in "xyz"]
    names += ["flow_x_rps", "flow_y_rps", "flow_gyro_x_rps", "flow_gyro_y_rps", "flow_quality"]
    lines = [",".join(["time_us", *names])]
    for t_us in range(0, 1_000_000, 10_000):
        seen = (0.3, -0.2, 0.05, 0.1, 0.8) if t_us == 500_000 else ("",) * 5
        lines.append(",".join(map(str, (t_us, *IMU[:5], -9.8 + 1e-9 * t_us, *seen))))
    path.write_text("\n".join(lines) + "\n")
    return of_kind(csv.read(path), Kind.FLOW)


def of_bin(folder):
    log = DataFlashWriter()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "OF", "QBffff", "TimeUS,Qual,flowX,flowY,bodyX,bodyY")
    for t_us in range(0, 1_000_000, 10_000):
        log.row("IMU", t_us, 0, *IMU[:5], -9.8 + 1e-9 * t_us)
        if t_us in (500_000, 600_000):
            log.row("OF", t_us, 204 * (t_us == 500_000), 0.3, -0.2, 0.05, 0.1)
    path = folder / "flow.bin"
    path.write_bytes(log.data)
    return of_kind(dataflash.read(path), Kind.FLOW)


_TOPICS = {
    "vehicle_optical_flow": [
        ("uint64_t", "timestamp"),
        ("uint64_t", "timestamp_sample"),
        ("float[2]", "pixel_flow"),
        ("float[3]", "delta_angle"),
        ("uint32_t", "integration_timespan_us"),
        ("uint8_t", "quality"),
    ],
    "optical_flow": [
        ("uint64_t", "timestamp"),
        *(("float", f"pixel_flow_{axis}_integral") for axis in "xy"),
        *(("float", f"gyro_{axis}_rate_integral") for axis in "xyz"),
        ("uint32_t", "integration_timespan"),
        ("uint8_t", "quality"),
    ],
}


def of_ulg(folder, topic):
    imu = [("uint64_t", "timestamp"), ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")]
    log = ULogWriter([("sensor_combined", imu), (topic, _TOPICS[topic])])
    for t_us in range(0, 1_000_000, 10_000):
        log.row(0, t_us, *IMU[:5], -9.8 + 1e-9 * t_us)
        if t_us in (500_000, 600_000):
            sample = [t_us] if "vehicle" in topic else []
            turn = (0.0025, 0.005, 0.0)
            quality = 204 * (t_us == 500_000)
            log.row(1, t_us, *sample, 0.015, -0.01, *turn, 50_000, quality)
    path = folder / f"{topic}.ulg"
    path.write_bytes(log.data)
    return of_kind(ulog.read(path), Kind.FLOW)


def test_against_a_simulator_s_truth_it_carries_over_a_minute_without_fixes():
    """ArduCopter's own flow, 12 m up, up to 9 m/s in gusts, as it came over MAVLink."""
    folder = DATA / "sitl-ap-copter-flow-rangefinder"
    if not folder.exists():
        pytest.skip("needs ../shared/data")
    log = read(folder / "flight.tlog")
    truth = np.genfromtxt(folder / "truth.csv", delimiter=",", skip_header=1)
    t = log.events.t_ns * 1e-9
    is_cut = (t > 75.0) & (t < 135.0) & (log.events.kind == Kind.GNSS)
    found = {}
    for has_flow in (True, False):
        kept = ~is_cut & (has_flow | (log.events.kind != Kind.FLOW))
        pipeline = Pipeline(FilterSettings(), log.family, log.gnss_delay)
        table = pipeline.run(log.events.take(kept))
        place = (np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg")))
        frame = LocalFrame(np.radians(-35.363262), np.radians(149.165237), 584.09)
        own = frame.to_ned(*place, table.column("alt_m"))[:, :2]
        true = np.stack([np.interp(table.stamp_ns, truth[:, 0] * 1e3, truth[:, i]) for i in (4, 5)])
        cut = (table.stamp_ns * 1e-9 > 75.0) & (table.stamp_ns * 1e-9 < 135.0)
        error = own[cut] - true.T[cut]
        way = np.hypot(*np.diff(true.T[cut], axis=0).T).sum()
        std = np.stack([table.column(f"sd_pos_{axis}")[cut] for axis in "ne"], axis=1)
        assert (np.abs(error) / std).max() < 3.0
        found[has_flow] = np.hypot(*error.T).max() / way
    assert found[True] < 0.01
    assert found[False] > 0.04
