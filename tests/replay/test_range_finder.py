"""The range finder: from every format, what it is good for, and what its faults cost."""

import csv
import gzip
import struct

import numpy as np
import pytest

from ekf_companion import estimate
from ekf_companion.config.config import load_config
from ekf_companion.core.settings.settings import FilterSettings, RangeFinderSettings
from ekf_companion.errors import ConfigError, DataError
from ekf_companion.logs import dataflash, ulog
from ekf_companion.logs.recording import Recording
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.replay.filters_by_name import run_filter
from ekf_companion.review.convert import convert as to_file
from tests.core.flights import flight
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_dataflash import of_kind
from tests.paths import DATA
from tests.rows import Rows, convert
from tests.rows import write as write_rows

WITHOUT = FilterSettings(range_finder=RangeFinderSettings(use=False))
LAST_FIX = 300.0
"""Of the real flight, s."""
FORMATS = ("csv", "bin", "ulg", "HIGHRES_IMU", "RAW_IMU")


class Ranged:
    """A flight, its truth, and the ranges of a sensor over ground by its place north."""

    def __init__(self, name, seed, ground=lambda north: np.zeros_like(north)):
        self.events, self.truth = flight(name, 60.0, seed)
        self.t_ns = np.arange(self.events.t_ns.min(), self.events.t_ns.max(), 100_000_000)
        self.t = (self.t_ns - self.t_ns[0]) * 1e-9
        at = np.clip(np.searchsorted(self.truth.att_t_ns, self.t_ns), 0, len(self.truth.q_nb) - 1)
        self.upright = so3.to_matrix(self.truth.q_nb[at])[:, 2, 2]
        lat, alt = (
            np.interp(self.t_ns, self.truth.pos_t_ns, one)
            for one in (self.truth.lat, self.truth.alt)
        )
        height = alt - self.truth.alt.min() + 0.1 - ground((lat - lat[0]) * 6.37e6)
        self.rng = np.random.default_rng(seed)
        noise = self.rng.normal(0.0, 0.05, len(height))
        self.ranges = np.maximum(height / self.upright + noise, 0.02)

    def fly(self, ranges, settings=None, keep=None):
        """Return the errors of height and of climb, each with its sigma, after the first 10 s."""
        events = self.events if keep is None else self.events.take(keep(self.events))
        std = np.full(len(self.t_ns), np.nan)
        events = merge(events, Events.from_columns(self.t_ns, Kind.RANGE, ranges, std))
        recording = Recording(family="px4", events=events)
        table = run_filter(recording, "eskf", settings or FilterSettings()).table
        alt = np.interp(table.stamp_ns, self.truth.pos_t_ns, self.truth.alt)
        down = np.interp(table.stamp_ns, self.truth.vel_t_ns, self.truth.vel_n[:, 2])
        late = table.stamp_ns > table.stamp_ns[0] + 10e9
        return [
            (table.column(name)[late] - true[late], table.column(std)[late])
            for name, true, std in (("alt_m", alt, "sd_pos_d"), ("vel_d", down, "sd_vel_d"))
        ]


def bounces(one):
    return np.where(one.rng.random(len(one.t)) < 0.5, one.rng.uniform(0.3, 40.0, len(one.t)), 0.0)


FAULTS = {
    "bounces": lambda one: np.where((b := bounces(one)) > 0.0, b, one.ranges),
    "noise alone": lambda one: one.rng.uniform(0.3, 40.0, len(one.t)),
    "stuck": lambda one: np.where(one.t > 15.0, one.ranges[150], one.ranges),
    "too long by a tenth": lambda one: 1.1 * one.ranges,
    "a roof of 3 m": lambda one: np.where(
        (one.t > 20.0) & (one.t < 30.0), np.maximum(one.ranges - 3.0, 0.1), one.ranges
    ),
    "a curb of half a metre": lambda one: np.where(one.t > 20.0, one.ranges + 0.5, one.ranges),
    "a deck that heaves": lambda one: np.maximum(
        one.ranges + 2.0 * np.sin(one.t / 12.0 * 2.0 * np.pi) * (one.t > 15.0), 0.1
    ),
    "a lift that sinks": lambda one: one.ranges + 0.5 * np.maximum(one.t - 15.0, 0.0),
    "late by 0.3 s": lambda one: np.interp(one.t - 0.3, one.t, one.ranges),
}


@pytest.mark.parametrize("name", ["hover", "figure-eight"])
@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_with_it_is_within_the_sigma(name, fault):
    one = Ranged(name, 2)
    for error, std in one.fly(FAULTS[fault](one)):
        assert np.max(np.abs(error) / std) < 5.0


@pytest.mark.parametrize("ground", ["level", "slope", "waves"])
def test_over_any_ground_the_height_is_as_good_as_without(ground):
    shape = {
        "level": lambda north: 0.0 * north,
        "slope": lambda north: 0.15 * north,
        "waves": lambda north: np.sin(north / 20.0 * 2.0 * np.pi),
    }
    one = Ranged("figure-eight", 3, shape[ground])
    found, without = (
        np.sqrt(np.mean(one.fly(one.ranges, settings)[0][0] ** 2)) for settings in (None, WITHOUT)
    )
    assert found < 1.1 * without


@pytest.mark.parametrize("unit", [0.1, 3.28, 100.0, 1000.0], ids=["dm", "feet", "cm", "mm"])
def test_a_unit_that_is_wrong_turns_no_attitude_over(unit):
    one = Ranged("figure-eight", 2)
    std = np.full(len(one.t_ns), np.nan)
    tilts = []
    for ranges in (one.ranges, np.minimum(unit * one.ranges, 9e3)):
        events = merge(one.events, Events.from_columns(one.t_ns, Kind.RANGE, ranges, std))
        table = run_filter(Recording(family="px4", events=events), "eskf", FilterSettings()).table
        q_nb = np.stack([table.column(f"q_{name}") for name in "wxyz"], axis=1)
        known = np.isfinite(q_nb).all(axis=1)
        at = np.searchsorted(one.truth.att_t_ns, table.stamp_ns[known])
        at = np.minimum(at, len(one.truth.q_nb) - 1)
        down, true = (so3.to_matrix(q)[:, 2] for q in (q_nb[known], one.truth.q_nb[at]))
        cosine = np.clip((down * true).sum(axis=1), -1.0, 1.0)
        tilts.append(np.degrees(np.arccos(cosine))[1000:].max())
    assert tilts[1] < tilts[0] + 0.5


def test_without_fixes_and_barometer_it_holds_the_height():
    one = Ranged("hover", 1)

    def cut(events):
        t = (events.t_ns - events.t_ns[0]) * 1e-9
        return ~((events.kind == Kind.GNSS) & (t > 25.0)) & (events.kind != Kind.BARO)

    held, free = (
        np.abs(one.fly(one.ranges, settings, cut)[0][0]).max() for settings in (None, WITHOUT)
    )
    assert free > 3.0
    assert held < 1.0


@pytest.fixture(scope="module")
def rows():
    found = Rows.plan("hover", duration=40.0)
    found.baro_ns, found.baro = found.baro_ns[:0], found.baro[:0]
    found.arrivals_ns[Kind.BARO] = found.baro_ns
    found.add_ranges(float(found.alt.min()) - 0.1)
    return found


@pytest.mark.parametrize("kind", FORMATS)
def test_it_is_read_from_every_format(rows, kind, tmp_path):
    found = convert(rows, kind, tmp_path)
    assert found.report.counts[Kind.RANGE] == pytest.approx(len(rows.ranges), abs=10)
    fused = found.report.health.verdicts
    (aid,) = [one for one in fused if one.name == "RANGE_FINDER"]
    assert found.report.health.fused(aid) > 0.8 * len(rows.ranges)


def test_arrays_take_it_by_name():
    one = Ranged("hover", 1)
    imu, fixes = (one.events.take(one.events.kind == kind) for kind in (Kind.IMU, Kind.GNSS))
    given = {"time": imu.t_ns, "gyro": imu.values[:, :3], "accel": imu.values[:, 3:6]}
    names = ("lat_rad", "lon_rad", "alt")
    given["gnss"] = {
        "time": fixes.t_ns,
        **dict(zip(names, fixes.values[:, :3].T, strict=True)),
        "vel_n": fixes.values[:, 3:6],
    }
    ranges = {"time": one.t_ns, "range": one.ranges}
    given["aids"] = {"range_finder": ranges}
    found, without = estimate(**given), estimate(**{**given, "aids": ()})
    assert not np.array_equal(found.pos_n, without.pos_n)
    with pytest.raises(ConfigError, match="aids: sonar: there is none of this name; known are "):
        estimate(**{**given, "aids": {"sonar": ranges}})
    nothing = {"time": one.t_ns, "std": one.ranges}
    with pytest.raises(DataError, match="range_finder: needs range"):
        estimate(**{**given, "aids": {"range_finder": nothing}})


def test_without_a_position_it_claims_no_height():
    """In a steady turn nothing shows the tilt before there are fixes, and a range is no height."""
    one = Ranged("loiter", 1)
    kept = one.events.take(np.isin(one.events.kind, (Kind.IMU, Kind.MAG)))
    std = np.full(len(one.t_ns), np.nan)
    events = merge(kept, Events.from_columns(one.t_ns, Kind.RANGE, one.ranges, std))
    table = run_filter(Recording(family="px4", events=events), "eskf", FilterSettings()).table
    assert np.isfinite(table.column("q_w")).any()
    assert not np.isfinite(table.column("pos_d")).any()


RFND = {
    "3.4": ("QCC", "TimeUS,Dist1,Dist2", (250, 300), None),
    "3.5": ("QCBCB", "TimeUS,Dist1,Orient1,Dist2,Orient2", (300, 0, 250, 25), 2.5),
    "status": ("QCBBCBB", "TimeUS,Dist1,Stat1,Orient1,Dist2,Stat2,Orient2", (250, 4, 25) * 2, 2.5),
    "far": ("QCBBCBB", "TimeUS,Dist1,Stat1,Orient1,Dist2,Stat2,Orient2", (4000, 3, 25) * 2, None),
    "4.0": ("QBCBB", "TimeUS,Instance,Dist,Stat,Orient", (1, 250, 4, 25), 2.5),
    "4.6": ("QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality", (0, 2.5, 4, 25, 80), 2.5),
    "forward": ("QBfBBb", "TimeUS,Instance,Dist,Stat,Orient,Quality", (0, 2.5, 4, 0, 80), None),
}


@pytest.mark.parametrize("layout", RFND)
def test_every_layout_of_rfnd_is_read_or_left_out(layout, tmp_path):
    characters, columns, values, expected = RFND[layout]
    log = DataFlashWriter()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "RFND", characters, columns)
    for n in range(100):
        log.row("IMU", 1_000_000 + 10_000 * n, 0, 0.0, 0.0, 0.0, 0.1 * (n % 2), 0.0, -9.8)
        log.row("RFND", 1_000_000 + 10_000 * n, *values)
    path = tmp_path / "range.bin"
    path.write_bytes(log.data)
    ranges = of_kind(dataflash.read(path), Kind.RANGE).values[:, 0]
    if expected is None:
        assert not len(ranges)
    else:
        assert ranges == pytest.approx(np.full(100, expected))


def test_of_a_ulog_a_sensor_that_looks_elsewhere_counts_not(rows, tmp_path):
    path = write_rows(rows, "ulg", tmp_path)
    looking = path.read_bytes()
    down = struct.pack("<bB", -1, 25)
    assert len(of_kind(ulog.read(path), Kind.RANGE)) == len(rows.ranges)
    path.write_bytes(looking.replace(down, struct.pack("<bB", -1, 0)))
    assert not len(of_kind(ulog.read(path), Kind.RANGE))


def test_on_a_real_flight_it_holds_the_height_when_fixes_and_barometer_are_gone(tmp_path):
    """A park, 1 to 4 m up, in 2014: for nine minutes nothing but the range says how high it is."""
    folder = DATA / "flow-sonar-gps-quad-2014"
    if not folder.exists():
        pytest.skip("needs ../shared/data")
    tables = {one.name.partition(".")[0]: load(one) for one in folder.glob("*.txt.gz")}
    log, out = tmp_path / "quad.csv", tmp_path / "out.csv"
    write(tables, log)
    config = tmp_path / "config.yaml"
    found = {}
    for use in ("true", "false"):
        config.write_text(f"range_finder: {{use: {use}}}\n")
        to_file(log, out, load_config(config))
        found[use] = np.abs(over_ground(out, tables["DIST"])).max()
    assert found["true"] < 1.5
    assert found["false"] > 20.0


def load(path):
    with gzip.open(path) as file:
        return np.loadtxt(file)


def write(tables, path):
    names = [f"{a}_{b}_{u}" for a, u in (("gyro", "rps"), ("accel", "mps2")) for b in "xyz"]
    names += ["gps_lat_deg", "gps_lon_deg", "gps_alt_m", "gps_vn_mps", "gps_ve_mps", "gps_vd_mps"]
    names += [f"mag_{one}_mG" for one in "xyz"] + ["range_m"]
    cells = {}

    def add(t_ms, first, values):
        row = cells.setdefault(round(t_ms * 1000.0), [""] * len(names))
        at = names.index(first)
        row[at : at + len(values)] = [repr(float(one)) for one in values]

    for row in tables["IMU"]:
        add(row[0], "gyro_x_rps", row[2:8])
    for row in tables["MAG"]:
        add(row[0], "mag_x_mG", row[2:5] - row[5:8])
    for row in tables["GPS"][tables["GPS"][:, 0] < LAST_FIX * 1e3]:
        course = np.radians(row[11])
        velocity = (row[10] * np.cos(course), row[10] * np.sin(course), row[12])
        add(row[0], "gps_lat_deg", (*row[6:9], *velocity))
    for row in tables["DIST"][tables["DIST"][:, 2] > 0]:
        add(row[0], "range_m", row[1:2])
    lines = [",".join(["time_us", *names])]
    lines += [",".join([str(t_us), *cells[t_us]]) for t_us in sorted(cells)]
    path.write_text("\n".join(lines) + "\n")


def over_ground(path, distances):
    """Return by how much the height over the ground wanders after the last fix, m."""
    with path.open(newline="") as file:
        found = [row for row in csv.DictReader(file) if row["alt_m"]]
    names = ("time_us", "alt_m", "roll", "pitch")
    t_us, alt, roll, pitch = (np.array([float(row[name]) for row in found]) for name in names)
    t, at = t_us * 1e-6, distances[:, 0] * 1e-3
    good = (distances[:, 2] > 0) & (distances[:, 1] > 0.4) & (at > LAST_FIX) & (at < t[-1])
    tilt = np.cos(np.interp(at, t, roll)) * np.cos(np.interp(at, t, pitch))
    wander = (np.interp(at, t, alt) - distances[:, 1] * tilt)[good]
    return wander - np.mean(wander)
