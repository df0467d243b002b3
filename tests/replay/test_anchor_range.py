"""Ranges to anchors: the position by them alone, and what is wrong with one of them."""

from functools import cache

import numpy as np
import pytest

from ekf_companion.core.settings.anchors import Anchors
from ekf_companion.core.settings.settings import (
    AnchorRangeSettings,
    FilterSettings,
    GnssSettings,
    OpticalFlowSettings,
    RangeFinderSettings,
)
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.logs import dataflash
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import AnchorSample, Events, Kind, make_row, merge
from tests.core.flights import flight
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_dataflash import of_kind
from tests.paths import DATA

LAST_FIX = 15.0
"""s: from then on there is no receiver."""
PLACES = np.array([[n, e, d] for n in (-30.0, 30.0) for e in (-30.0, 30.0) for d in (-1.0, -15.0)])
"""Of eight anchors about the first true position, m."""
BIAS = 0.2
EXACT = {"frame_std": 0.0, "frame_yaw_std": 0.0}
SURVEYED = {"frame_std": 2.0, "frame_yaw_std": 0.05}


class Ranged:
    """A flight among anchors, each of which is ranged five times a second."""

    def __init__(self, name, seed=2):
        self.events, truth = flight(name, 60.0, seed)
        self.frame = LocalFrame(float(truth.lat[0]), float(truth.lon[0]), float(truth.alt.min()))
        self.truth_ns, self.pos = truth.pos_t_ns, self.frame.to_ned(truth.lat, truth.lon, truth.alt)
        self.first_ns = int(self.events.t_ns.min())
        self.t_ns = np.arange(self.first_ns, int(self.events.t_ns.max()), 25_000_000)
        self.t = (self.t_ns - self.first_ns) * 1e-9
        self.anchor = np.arange(len(self.t_ns)) % len(PLACES)
        self.rng = np.random.default_rng(seed)
        self.ranges = self.ranged(0.0)

    def ranged(self, late):
        """Return the ranges of so long ago, s."""
        then_ns = self.t_ns - round(late * 1e9)
        tag = np.stack([np.interp(then_ns, self.truth_ns, one) for one in self.pos.T], axis=1)
        exact = np.linalg.norm(tag - PLACES[self.anchor], axis=1)
        return exact + BIAS + self.rng.normal(0.0, 0.07, len(exact))

    def fly(self, ranges, places=PLACES, settings=None, last_fix=LAST_FIX, **known):
        """Return the pipeline and, from 20 s on, the errors and their sigmas.

        Their frame is exactly where it is said to be, unless ``known`` says otherwise.
        """
        lat, lon, alt = self.frame.to_geodetic(places)
        anchors = tuple(
            (float(number), *map(float, np.degrees(place)), float(height))
            for number, (place, height) in enumerate(
                zip(np.stack([lat, lon], axis=1), alt, strict=True)
            )
        )
        own = AnchorRangeSettings(anchors=anchors, places="geodetic", **(known or EXACT))
        unknown = np.full(len(ranges), np.nan)
        measured = Events.from_columns(self.t_ns, Kind.ANCHOR, ranges, self.anchor, *[unknown] * 5)
        t = (self.events.t_ns - self.first_ns) * 1e-9
        is_gone = (t > last_fix) & np.isin(self.events.kind, (Kind.GNSS, Kind.BARO))
        pipeline = Pipeline(settings or FilterSettings(anchor_range=own), "px4")
        table = pipeline.run(merge(self.events.take(~is_gone), measured))
        place = (np.radians(table.column("lat_deg")), np.radians(table.column("lon_deg")))
        found = self.frame.to_ned(*place, table.column("alt_m"))
        true = np.stack([np.interp(table.stamp_ns, self.truth_ns, one) for one in self.pos.T], 1)
        late = (table.stamp_ns - self.first_ns) * 1e-9 > LAST_FIX + 5.0
        std = np.stack([table.column(f"sd_pos_{axis}") for axis in "ned"], axis=1)
        return pipeline, (found - true)[late], std[late]


@cache
def ranged(name="hover"):
    return Ranged(name)


@pytest.mark.parametrize("name", ["hover", "figure-eight"])
def test_it_is_the_position_when_the_receiver_is_gone(name):
    one = ranged(name)
    pipeline, error, std = one.fly(one.ranges)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.15
    assert (np.abs(error) / std).max() < 4.5
    counts = pipeline.health().verdicts[Aid.ANCHOR_RANGE]
    assert counts[Verdict.FUSED] > 0.9 * sum(counts.values())


def detours(one):
    """One of eight is behind a wall, half of the time."""
    is_long = (one.anchor == 3) & (one.t % 6.0 < 3.0)
    return np.where(is_long, one.ranges + 1.0, one.ranges)


FAULTS = {
    "detours": detours,
    "bounces": lambda one: np.where(
        one.rng.random(len(one.t)) < 0.2, one.ranges + one.rng.uniform(0.0, 30.0), one.ranges
    ),
    "frozen anchor": lambda one: np.where(
        (one.anchor == 2) & (one.t > 20.0), one.ranges[(one.anchor == 2)][100], one.ranges
    ),
    "all too long by 2 %": lambda one: 1.02 * one.ranges,
    "three of them behind a wall": lambda one: np.where(
        (one.anchor % 3 == 0) & (one.t > 20.0), one.ranges + 2.0, one.ranges
    ),
    "frozen": lambda one: np.where((one.t > 25.0) & (one.t < 35.0), one.ranges[1000], one.ranges),
    "only three of them": lambda one: np.where(one.anchor < 3, one.ranges, np.nan),
    "in feet": lambda one: 3.28 * one.ranges,
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_with_them_is_within_the_sigma(name):
    one = ranged("figure-eight")
    _, error, std = one.fly(FAULTS[name](one))
    assert (np.abs(error) / std).max() < 6.0


@pytest.mark.parametrize("off_n", [(4.0, -3.0, 0.0), (0.0, 0.0, 5.0)], ids=["level", "height"])
def test_a_frame_that_is_off_is_found_beside_the_receiver_and_named(off_n):
    one = ranged("figure-eight")
    pipeline, error, std = one.fly(one.ranges, PLACES + off_n, last_fix=np.inf, **SURVEYED)
    assert (np.abs(error) / std).max() < 4.0
    (said,) = pipeline.health().oddities
    assert said.startswith("anchors: all of them are ")
    x = pipeline.filter_state
    frame = x.anchor_range_frame_north, x.anchor_range_frame_east, x.anchor_range_frame_down
    assert frame == pytest.approx(-np.array(off_n), abs=1.0)


def test_a_frame_that_is_turned_is_found_beside_the_receiver_and_named():
    one = ranged("figure-eight")
    c, s = np.cos(0.1), np.sin(0.1)
    turned = PLACES @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    pipeline, error, std = one.fly(one.ranges, turned, last_fix=np.inf, **SURVEYED)
    assert (np.abs(error) / std).max() < 4.0
    (said,) = pipeline.health().oddities
    assert said.startswith("anchors: all of them are turned by -6 deg")


@pytest.mark.parametrize("last_fix", [LAST_FIX, np.inf], ids=["gone", "with a receiver"])
@pytest.mark.parametrize("late", [0.1, 0.3])
def test_a_delay_is_found(late, last_fix):
    one = ranged("figure-eight")
    moved = PLACES + np.array([4.0, -3.0, 0.0])
    pipeline, error, std = one.fly(one.ranged(late), moved, last_fix=last_fix, **SURVEYED)
    assert pipeline.filter_state.anchor_range_delay == pytest.approx(late, abs=0.02)
    assert (np.abs(error) / std).max() < 4.0


def test_a_frame_that_is_right_is_not_named_and_the_sigma_is_that_of_the_receiver():
    one = ranged("figure-eight")
    pipeline, error, std = one.fly(one.ranges, last_fix=np.inf, **SURVEYED)
    assert pipeline.health().oddities == ()
    assert (np.abs(error) / std).max() < 4.0
    gone, error, lost = one.fly(one.ranges, **SURVEYED)
    assert gone.health().oddities == ()
    assert (np.abs(error) / lost).max() < 4.0
    # it stays what it was when the receiver went
    assert lost[-1, :2].max() < 1.5 * lost[0, :2].max()
    assert (lost[:, :2] > one.fly(one.ranges)[2][:, :2]).all()


def test_one_whose_place_is_wrong_by_a_metre_is_named_and_no_other():
    one = ranged("figure-eight")
    assert one.fly(one.ranges)[0].health().oddities == ()
    for number in (0, 5):
        for axis in range(2):
            places = PLACES.copy()
            places[number, axis] += 1.0
            pipeline, _, _ = one.fly(one.ranges, places)
            (said,) = pipeline.health().oddities
            assert said.startswith(f"anchor {number}: its ranges are ")


def test_one_without_a_place_is_named_and_not_used():
    one = ranged()
    pipeline, _, _ = one.fly(one.ranges, PLACES[:7])
    (said,) = pipeline.health().oddities
    assert said.startswith("anchor 7 has no place")
    counts = pipeline.health().verdicts[Aid.ANCHOR_RANGE]
    assert counts[Verdict.SUPERSEDED] > len(one.t) // 8 - 50


def test_places_from_the_origin_and_on_the_earth_are_the_same():
    """The origin of the filter is the first fix: an anchor is given from there, or anywhere."""
    row = AnchorSample(t_ns=1, range=4.0, anchor=2).row()
    local = Anchors(AnchorRangeSettings(anchors=((2.0, 1.0, -2.0, 3.0),)))
    assert local.complete(row)[2][:6] == (4.0, 2.0, 1.0, -2.0, 3.0, 0.0)
    geodetic = Anchors(AnchorRangeSettings(anchors=((2.0, 47.0, 8.0, 500.0),), places="geodetic"))
    values = geodetic.complete(row)[2][:6]
    assert values == pytest.approx((4.0, 2.0, np.radians(47.0), np.radians(8.0), 500.0, 1.0))
    own = make_row(1, Kind.ANCHOR, 4.0, 2.0, 9.0, 9.0, 9.0, 0.0, 0.1)
    assert local.complete(own) == own
    calibrated = Anchors(AnchorRangeSettings(biases=((2.0, -0.25), (3.0, 1.0))))
    assert calibrated.complete(own)[2][:3] == (4.25, 2.0, 9.0)


def test_beacons_of_a_log_are_ranges_without_a_place(tmp_path):
    log = DataFlashWriter()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "BCN", "QBBfffffff", "TimeUS,Health,Cnt,D0,D1,D2,D3,PosX,PosY,PosZ")
    for t_us in range(0, 1_000_000, 10_000):
        log.row("IMU", t_us, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.8 + 1e-9 * t_us)
        if t_us % 100_000 == 0:
            log.row("BCN", t_us, t_us != 500_000, 3, 1.5, 0.0, 2.5, 3.5, 0.0, 0.0, 0.0)
    path = tmp_path / "beacons.bin"
    path.write_bytes(log.data)
    found = of_kind(dataflash.read(path), Kind.ANCHOR).values
    assert sorted(map(tuple, found[:, :2].tolist())) == [(1.5, 0.0)] * 9 + [(2.5, 2.0)] * 9
    assert np.isnan(found[:, 2:7]).all()


@cache
def room():
    """Return the tables of a real flight in a room, and the truth about its first position."""
    folder = DATA / "uwb-twr-flow-crazyflie"
    if not folder.exists():
        pytest.skip("needs ../shared/data")
    names = ("imu", "flow", "range", "tof", "truth_pose")
    tables = {name: table(folder / f"{name}.csv.gz") for name in names}
    pose = tables["truth_pose"]
    pose = pose[np.unique(pose[:, 0], return_index=True)[1]]
    t, turn = pose[:, 0] - 0.01, pose[:, 4:8] * [1.0, -1.0, -1.0, 1.0]
    yaw = so3.to_euler(turn[:, [3, 0, 1, 2]])[:, 2]
    anchors = table(folder / "anchors.csv")[:, 1:] * [1.0, -1.0, -1.0]
    return tables, t, pose[:, 1:4] * [1.0, -1.0, -1.0], yaw, anchors


def table(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1)


PLACE = LocalFrame(np.radians(47.0), np.radians(8.0), 100.0)
"""Where the room is: its frame is turned to forward, right, down."""
PIXEL = 1.0 / 488.0
"""rad: 4.2 deg by 35 pixels of ten counts."""


def biases(until):
    """Return by how much each anchor's ranges are too long up to a time, s: a calibration."""
    tables, t, pos, _, anchors = room()
    pose = tables["truth_pose"]
    when = np.interp(tables["range"][:, 0], pose[:, 0] - 0.01, np.arange(len(pose)))
    turn = so3.to_matrix(pose[np.rint(when).astype(int)][:, [7, 4, 5, 6]])
    tag = turn @ [-0.012, 0.001, 0.091] * [1.0, -1.0, -1.0]
    tag += np.stack([np.interp(tables["range"][:, 0], t, one) for one in pos.T], axis=1)
    number, now = tables["range"][:, 1].astype(int), tables["range"][:, 0]
    off = tables["range"][:, 2] - np.linalg.norm(tag - anchors[number], axis=1)
    early = (now > 9.5) & (now < until)
    return tuple((float(i), float(np.median(off[early & (number == i)]))) for i in range(8))


def in_the_room(*sensors, moved=(), calibrated=(), begin=10.0):
    """Return the errors from a time on, s, and the pipeline; fixes and headings end at 3 s."""
    tables, t, pos, yaw, anchors = room()
    imu, flow, ranges, tof = (tables[name] for name in ("imu", "flow", "range", "tof"))

    def at(seconds):
        return np.rint(np.asarray(seconds) * 1e9).astype(np.int64) + 1_000_000_000

    def nothing(n):
        return np.full(n, np.nan)

    first = np.flatnonzero(t < 3.0)[::20]
    n, still = len(first), np.zeros(len(first))
    place = PLACE.to_geodetic(pos[first])
    stds = (np.full(n, 0.1), np.full(n, 0.1), np.full(n, 0.05))
    rates = np.radians(imu[:, 1:4]) * [1.0, -1.0, -1.0]
    forces = imu[:, 4:7] * 9.80665 * [1.0, -1.0, -1.0]
    events = [
        Events.from_columns(
            at(t[first]), Kind.GNSS, *place, still, still, still, *stds, nothing(n)
        ),
        Events.from_columns(at(t[first]), Kind.HEADING, yaw[first], np.full(n, 0.02), still),
        Events.from_columns(at(imu[:, 0]), Kind.IMU, *rates.T, *forces.T),
    ]
    if "ranges" in sensors:
        values = (ranges[:, 2], ranges[:, 1], *[nothing(len(ranges))] * 5)
        events.append(Events.from_columns(at(ranges[:, 0]), Kind.ANCHOR, *values))
    if "flow" in sensors:
        span = np.diff(flow[:, 0], prepend=flow[0, 0] - 0.01)
        seen = span < 0.05  # rows without motion were not written
        xy = (-flow[:, 1:3] * PIXEL / span[:, None])[seen]
        when = at(flow[:, 0] - 0.5 * span)[seen]
        events.append(Events.from_columns(when, Kind.FLOW, *xy.T, *[nothing(len(xy))] * 4))
    if "laser" in sensors:
        columns = (np.maximum(tof[:, 1], 1e-3), nothing(len(tof)))
        events.append(Events.from_columns(at(tof[:, 0]), Kind.RANGE, *columns))
    places = anchors.copy()
    for number, axis in moved:
        places[number, axis] += 1.0
    lat, lon, alt = PLACE.to_geodetic(places)
    known = np.column_stack([np.arange(8.0), np.degrees(lat), np.degrees(lon), alt]).tolist()
    settings = FilterSettings(
        gnss=GnssSettings(
            delay=0.0, delay_std=0.0, lever_arm_std=0.0, position_std=0.02, height_std=0.02
        ),
        range_finder=RangeFinderSettings(std=0.03, walk=0.01, speed_walk=0.01),
        optical_flow=OpticalFlowSettings(std=0.4, scale_std=0.2),
        anchor_range=AnchorRangeSettings(
            anchors=tuple(map(tuple, known)),
            places="geodetic",
            lever_arm=(-0.012, -0.001, -0.091),
            # the motion capture that is the truth has measured them, the board itself ranges
            frame_std=0.0,
            frame_yaw_std=0.0,
            delay_std=0.0,
            biases=calibrated,
            **({"bias_std": 0.03, "spread_std": 0.01} if calibrated else {}),
        ),
    )
    pipeline = Pipeline(settings)
    found = pipeline.run(merge(*events))
    seconds = (found.stamp_ns - 1_000_000_000) * 1e-9
    late = (seconds > begin) & (seconds < 59.0)
    degrees = (np.radians(found.column(name)[late]) for name in ("lat_deg", "lon_deg"))
    own = PLACE.to_ned(*degrees, found.column("alt_m")[late])
    true = np.stack([np.interp(seconds[late], t, one) for one in pos.T], axis=1)
    std = np.stack([found.column(f"sd_pos_{axis}")[late] for axis in "ned"], axis=1)
    return own - true, std, pipeline


def rms(error):
    return np.sqrt((error**2).sum(axis=1).mean())


def test_in_a_real_room_each_source_adds_to_the_others():
    """Motion capture is the truth: 28 m of way, 1.2 m/s, anchors hidden at times."""
    ranges, std, _ = in_the_room("ranges")
    assert rms(ranges[:, :2]) < 0.12
    assert rms(ranges) < 0.18
    assert (np.abs(ranges) / std).max() < 4.0
    flow, std, _ = in_the_room("flow", "laser")
    assert rms(flow[:, :2]) < 0.02 * 28.5
    assert (np.abs(flow) / std).max() < 3.0
    everything, std, _ = in_the_room("ranges", "flow", "laser")
    assert rms(everything) < min(rms(ranges), rms(flow))
    assert (np.abs(everything) / std).max() < 4.0


def test_in_a_real_room_a_calibration_of_a_quarter_of_a_minute_holds_for_the_rest():
    known = {"calibrated": biases(25.0), "begin": 25.0}
    plain, _, _ = in_the_room("ranges", begin=25.0)
    ranges, std, _ = in_the_room("ranges", **known)
    assert rms(ranges) < rms(plain)
    assert (np.abs(ranges) / std).max() < 4.0
    everything, std, _ = in_the_room("ranges", "flow", "laser", **known)
    assert rms(everything) < 0.1
    assert (np.abs(everything) / std).max() < 4.0


@pytest.mark.parametrize("number", [0, 3, 5, 7])
@pytest.mark.parametrize("axis", [0, 1], ids=["north", "east"])
def test_in_a_real_room_an_anchor_that_is_a_metre_off_is_named(number, axis):
    _, _, pipeline = in_the_room("ranges", moved=[(number, axis)])
    (said,) = pipeline.health().oddities
    assert said.startswith(f"anchor {number}: ")
