"""Arrays in, a trajectory out; mistakes are said."""

import re
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

import ekf_companion
from ekf_companion import OwnAid, estimate
from ekf_companion.arrays.run import to_events
from ekf_companion.core.memory.enums import Fault, Source
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.errors import ConfigError, DataError, LogError
from ekf_companion.filters import mahony
from ekf_companion.logs.estimate import is_estimate, read_estimate
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Kind
from sim_autopilot.config import SimConfig
from sim_autopilot.events import events, truth
from sim_autopilot.flight import Flight

COARSE = replace(SimConfig(), imu=replace(SimConfig().imu, rate=50.0))


class Flown:
    """A simulated flight as arrays, and its truth."""

    def __init__(self, duration=30.0):
        flight = Flight.plan("figure-eight", COARSE, duration=duration, seed=4)
        self.truth, self.events = truth(flight), events(flight)
        imu, gnss, mag, baro = (self.of(k) for k in (Kind.IMU, Kind.GNSS, Kind.MAG, Kind.BARO))
        self.time = imu.t_ns * 1e-9
        self.gyro, self.accel = imu.values[:, :3], imu.values[:, 3:6]
        self.gnss = {
            "time": gnss.t_ns * 1e-9,
            "lat_deg": np.rad2deg(gnss.values[:, 0]),
            "lon_deg": np.rad2deg(gnss.values[:, 1]),
            "alt": gnss.values[:, 2],
            "vel_n": gnss.values[:, 3:6],
            "std_h": gnss.values[:, 6],
            "std_v": gnss.values[:, 7],
            "std_vel": gnss.values[:, 8],
        }
        self.mag = {"time": mag.t_ns * 1e-9, "field": mag.values[:, :3]}
        at = np.searchsorted(self.truth.vel_t_ns, gnss.t_ns)
        self.velocity = self.truth.vel_n[np.minimum(at, len(self.truth.vel_n) - 1)]
        self.baro = {"time": baro.t_ns * 1e-9, "alt": baro.values[:, 0]}

    def of(self, kind):
        return self.events.take(self.events.kind == kind)

    def estimate(self, **changed):
        late = FilterSettings(gnss=GnssSettings(delay=0.12))  # as the simulator's receiver
        sensors = {"gnss": self.gnss, "mag": self.mag, "baro": self.baro}
        parts = {**sensors, "settings": late, **changed}
        sensors = {name: getattr(self, name) for name in ("time", "gyro", "accel")} | {
            name: parts.pop(name) for name in ("time", "gyro", "accel") if name in parts
        }
        return estimate(*sensors.values(), **parts)


@pytest.fixture(scope="module")
def flown():
    return Flown()


def error(flown, found):
    """Return the RMS of the horizontal position and of the yaw, m and deg, after 15 s."""
    truth = flown.truth
    at = np.searchsorted(truth.att_t_ns, found.t_ns)
    late = found.time - found.time[0] > 15.0
    lat, lon = np.rad2deg(truth.lat[at]), np.rad2deg(truth.lon[at])
    north = (found.lat_deg - lat)[late] * 111_200.0
    east = (found.lon_deg - lon)[late] * 111_200.0 * np.cos(truth.lat[0])
    yaw = so3.wrap(found.euler[:, 2] - so3.to_euler(truth.q_nb[at])[:, 2])[late]
    return np.sqrt(np.mean(north**2 + east**2)), np.degrees(np.sqrt(np.mean(yaw**2)))


@pytest.mark.parametrize("name", ["eskf", "iterated", "ukf", "euler"])
def test_a_flight_is_estimated_by_any_filter(flown, name):
    found = flown.estimate(filter=name)
    assert len(found) == pytest.approx(len(flown.time), abs=300)
    assert found.pos_n.shape == found.vel_n.shape == found.euler.shape == (len(found), 3)
    assert found.q_nb.shape == (len(found), 4)
    assert found.sigma.shape == (len(found), 9)
    position, yaw = error(flown, found)
    assert position < 1.5
    assert yaw < 4.0
    assert repr(found).startswith(f"<Estimates: {len(found)} in ")
    assert f"{found.shares['ok']:.0%}" in repr(found)


@pytest.mark.parametrize("changed", [{}, {"smooth": True}, {"filter": "ukf"}])
def test_the_origin_is_where_positions_count_from(flown, changed):
    """Without a compass the filters begin elsewhere: so did their origins, which nothing said."""
    heading = {"time": flown.time[::10], "heading": np.full(len(flown.time[::10]), 0.3)}
    given = {"mag": None, "heading": heading} if "filter" in changed else {"mag": None}
    found = flown.estimate(**given, **changed)
    origin = found.origin
    frame = LocalFrame(np.deg2rad(origin.lat_deg), np.deg2rad(origin.lon_deg), origin.alt)
    place = frame.to_ned(np.deg2rad(found.lat_deg), np.deg2rad(found.lon_deg), found.alt)
    known = found.status >= 3
    assert np.allclose(place[known], found.pos_n[known], atol=1e-6)
    first = [flown.gnss[name][0] for name in ("lat_deg", "lon_deg", "alt")]
    assert (np.abs(np.array(origin) - first).max() < 1e-9) == ("filter" in changed)
    assert flown.estimate(gnss=None).origin is None


def test_smoothing_is_a_keyword_and_better(flown):
    live, smoothed = flown.estimate(), flown.estimate(smooth=True)
    assert error(flown, smoothed)[0] < error(flown, live)[0]
    assert np.array_equal(live.t_ns, smoothed.t_ns)
    with pytest.raises(ConfigError, match="smooth: smooths eskf"):
        flown.estimate(smooth=True, filter="ukf")


@pytest.mark.parametrize("mode", ["off", "report", "act"])
@pytest.mark.parametrize("smooth", [False, True])
def test_faults_that_were_found_are_in_the_result(flown, mode, smooth):
    late = flown.baro["time"] > flown.time[0] + 25.0
    baro = {"time": flown.baro["time"], "alt": flown.baro["alt"] + np.where(late, 8.0, 0.0)}
    settings = FilterSettings(gnss=GnssSettings(delay=0.12), weigh_faults=mode)
    found = flown.estimate(baro=baro, settings=settings, smooth=smooth)
    said = [note for note in found.notes if note.startswith("fault: ")]
    assert len(said) == len(found.faults) == (0 if mode == "off" else 1)
    assert (len(found.evidence.t_ns) > 25) == (mode != "off")
    if mode != "off":
        assert found.faults[0].kind == Fault.BARO_STEP
        assert found.evidence.probability[:, Source.BARO].max() > 0.99
        assert said == [f"fault: {found.faults[0].words(int(found.t_ns[0]))}"]


@pytest.mark.parametrize("seconds", [0.45, -0.45])
def test_fixes_later_than_a_receivers_are_noted_by_the_filters_own_estimate(seconds):
    """Of fixes that are early it tells less: it cannot look ahead to judge them."""
    flown = Flown(duration=110.0)
    side = "later" if seconds > 0.0 else "earlier"
    fixes = flown.gnss | {"time": flown.gnss["time"] + seconds}
    for smooth in (False, True):
        notes = flown.estimate(gnss=fixes, smooth=smooth, check=False).notes
        (note,) = [note for note in notes if "than their times say" in note]
        found = re.match(r"the fixes are (0\.\d\d) s (\w+) than .* gnss.delay to (-?0\.\d\d)", note)
        assert float(found[1]) == pytest.approx(abs(seconds), abs=0.05 if seconds > 0.0 else 0.08)
        assert found[2] == side
        assert float(found[3]) == pytest.approx(0.12 + seconds, abs=0.05 if seconds > 0.0 else 0.08)


def test_smoothing_says_why_the_begin_has_no_position(flown):
    found = flown.estimate(mag=None, smooth=True)
    since = found.time[np.argmax(np.isfinite(found.lat_deg))] - found.time[0]
    (note,) = [note for note in found.notes if "no position" in note]
    assert note.startswith(f"the first {since:.1f} s have no position: before ")
    assert "smoothing does not reach back" in note
    assert not [note for note in flown.estimate(smooth=True).notes if "no position" in note]


def test_units_and_times_may_be_named_or_told_by_their_type(flown):
    expected = flown.estimate().pos_n
    whole = {
        "time": np.rint(flown.time * 1e9).astype(np.int64),
        "gnss": flown.gnss | {"time": np.rint(flown.gnss["time"] * 1e9).astype(np.int64)},
        "mag": flown.mag | {"time": np.rint(flown.mag["time"] * 1e9).astype(np.int64)},
        "baro": flown.baro | {"time": np.rint(flown.baro["time"] * 1e9).astype(np.int64)},
    }
    assert np.allclose(flown.estimate(**whole).pos_n, expected, atol=1e-6, equal_nan=True)
    dated = {
        name: table
        | {"time": whole[name]["time"].astype("datetime64[ns]").astype("datetime64[us]")}
        for name, table in (("gnss", flown.gnss), ("mag", flown.mag), ("baro", flown.baro))
    }
    dated["time"] = whole["time"].astype("datetime64[ns]")
    found = flown.estimate(**dated, units={"time": "s"})
    assert np.array_equal(found.t_ns, whole["time"])
    assert np.allclose(found.pos_n, expected, atol=1e-3, equal_nan=True)  # us
    other = flown.estimate(
        gyro=np.rad2deg(flown.gyro),
        accel=flown.accel / 9.80665,
        mag=flown.mag | {"field": flown.mag["field"] * 100.0},
        units={"gyro": "deg/s", "accel": "g", "mag": "uT"},
    )
    assert np.allclose(other.pos_n, expected, atol=1e-6, equal_nan=True)


DOWN = np.array([0.0, 0.0, 1.0])
AXES = np.array([1.0, -1.0, -1.0])
NAN = np.nan
SWAPPED = [1, 0, 2]


def radians(flown):
    return {name: np.deg2rad(flown.gnss[name]) for name in ("lat_deg", "lon_deg")}


def rows(flown, number):
    return np.full(len(flown.time), number)


def in_ms(flown):
    """Return the fixes with times in ms since the first sample, the first of them before it."""
    since = (flown.gnss["time"] - flown.gnss["time"][0]) * 1e3
    return flown.gnss | {"time": since + flown.time[0]}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda f: {"gyro": np.rad2deg(f.gyro)}, "it looks like deg/s; say units="),
        (lambda f: {"accel": f.accel / 9.81}, r"it looks like g; say units=\{'accel': 'g'\}"),
        (lambda f: {"accel": f.accel + DOWN * 9.81}, "gravity not removed"),
        (lambda f: {"accel": -f.accel}, r"gravity shows as \+1?\d\.\d m/s2 along z.*give -accel"),
        (lambda f: {"accel": f.accel * AXES, "gyro": f.gyro * AXES}, "axes are forward, left, up"),
        (lambda f: {"accel": f.accel[:, [2, 1, 0]]}, "along x, so that axis is not level"),
        (lambda f: {"accel": np.full_like(f.accel, NAN)}, r"accel: all \d+ rows are NaN"),
        (lambda f: {"accel": f.accel.T}, "must have the shape .*; transpose it"),
        (lambda f: {"time": f.time * 1e3}, r"it looks like ms: say units=\{'time': 'ms'\}"),
        (lambda f: {"time": np.rint(f.time * 1e6).astype(int)}, "it looks like us"),
        (lambda f: {"time": (f.time + 1.7e9) * 1e3}, "is beyond every clock; name its unit"),
        (lambda f: {"time": f.time[::-1]}, "goes back at row 1, from"),
        (
            lambda f: {"time": (f.time + 4260.0) % 4294.967296},
            r"32 bits of us has begun anew: add 4294\.967296 s to the times from there on",
        ),
        (
            lambda f: {"time": (np.rint(f.time * 1e3 + 4.29493e9) % 2**32) / 1e3},
            r"32 bits of ms has begun anew: add 4294967\.296000 s to the times",
        ),
        (lambda f: {"time": (f.time + 4260.0) % 4290.0}, "0000 s; sort the rows"),
        (lambda f: {"time": f.time * NAN}, "time: holds NaN"),
        (lambda f: {"gnss": f.gnss | {"time": f.gnss["time"] + 1e6}}, "have nothing in common"),
        (
            lambda f: {"gnss": f.gnss | {"lat_deg": f.gnss["lat_deg"] * 1e7}},
            "no place on the Earth",
        ),
        (lambda f: {"gnss": f.gnss | {"vel_n": f.velocity * AXES}}, "third column rises"),
        (
            lambda f: {"gnss": f.gnss | {"vel_n": f.velocity, "alt": -f.gnss["alt"]}},
            "and alt positive upwards",
        ),
        (
            lambda f: {"time": np.full(len(f.time), np.datetime64("NaT"))},
            "time: holds NaT; leave such rows out",
        ),
        (
            lambda f: {"time": np.array(["noon"] * len(f.time))},
            r"time: must be numbers or datetime64 in one row",
        ),
        (lambda f: {"gnss": {"time": f.gnss["time"]}}, "gnss: needs lat_rad"),
        (lambda f: {"gnss": f.gnss | {"height": 1.0}}, "gnss: height: known are time, lat_deg"),
        (lambda f: {"mag": f.mag | {"field": f.mag["field"] * 100.0}}, "mag: its median strength"),
        (lambda f: {"baro": {"time": f.time, "pressure": rows(f, 1013.0)}}, "1013 hPa are 101300"),
        (lambda f: {"heading": {"time": f.time, "heading": rows(f, 90.0)}}, "give np.deg2rad"),
        (lambda f: {"gnss": f.gnss | {"lat_deg": 47.0}}, "lat_deg: is one number for 150 rows; "),
        (lambda f: {"gyro": 0.0}, r"gyro: is one number for 1500 rows; give the shape \(1500, 3\)"),
        (
            lambda f: {"mag": f.mag["field"]},
            r"mag: must be a dict of arrays, \{'time': \.\.\., 'fi",
        ),
        (lambda f: {"gnss": f.gnss["lat_deg"]}, "gnss: must be a dict of arrays"),
        (lambda f: {"heading": {"time": f.time}}, "heading: needs heading"),
        (lambda f: {"baro": {"time": f.time}}, "baro: needs alt or pressure"),
        (lambda f: {"units": "deg/s"}, r"'deg/s': name the array too, as \{'gyro': 'deg/s'\}"),
        (
            lambda f: {"time": np.floor(f.time)},
            "time: 98% of the rows have the time of the row befo",
        ),
        (
            lambda f: {"gyro": -f.gyro},
            "does not turn in the vehicle as the gyro does: gyro has the",
        ),
        (lambda f: {"gyro": -f.gyro, "gnss": None}, "gyro has the other sign"),
        (lambda f: {"units": {"gyro": "dps"}}, "gyro looks like rad/s that is called deg/s"),
        (lambda f: {"gnss": f.gnss | radians(f)}, "look like radians; name them lat_rad"),
        (lambda f: {"gnss": f.gnss | {"vel_n": f.velocity[:, [1, 0, 2]]}}, "are exchanged"),
        (lambda f: {"gnss": f.gnss | {"vel_n": f.velocity * 3.6}}, "look like km/h; give m/s"),
        (lambda f: {"gyro": f.gyro[:, SWAPPED], "accel": f.accel[:, SWAPPED]}, "x and y of both"),
        (lambda f: {"gyro": f.gyro * AXES}, "gyro is forward, left, up and accel forward"),
        (lambda f: {"gnss": f.gnss | {"std_h": -1.0}}, "std_h: one sigma must be greater than 0"),
        (
            lambda f: {"gnss": f.gnss | {"time": f.gnss["time"] + 1.0}},
            r"gnss: its velocities show the motion of gyro and accel 1\.0 s too late: .* leap sec",
        ),
        (lambda f: {"gnss": in_ms(f)}, r"gnss: .* by a factor of 1e\+03: the"),
        (lambda f: {"units": {"gyro": "rpm"}}, "units: gyro: 'rpm': known are"),
        (lambda f: {"filter": "kalman"}, "unknown filter; known are eskf"),
        (lambda f: {"settings": {"std": 1.0}}, "settings: must be a FilterSettings, not dict"),
        (lambda f: {"baro": {"time": [], "alt": []}}, "baro.time: is empty"),
        (lambda f: own(f, Rangefinder), "aids: row 0: Rangefinder is a class; give one of its ob"),
        (lambda f: own(f) | {"aids": Rangefinder(1.0, 1.0)}, "aids: is Rangefinder .*; give a"),
        (lambda f: own(f, Answer(np.nan)), r"innovation\(\) returned nan"),
        (lambda f: own(f, Answer(1.0)), r"innovation\(\) returned the shape \(\), not \(m\) with"),
        (lambda f: own(f, Answer([1.0] * 5)), r"innovation\(\) returned the shape \(5,\), not \(m"),
    ],
)
def test_mistakes_are_said(flown, change, sentence):
    with pytest.raises((DataError, ConfigError), match=sentence):
        flown.estimate(**change(flown))


def test_what_is_meant_all_the_same_may_be_insisted_on(flown):
    with pytest.raises(ValueError, match="along x"):
        to_events(flown.time, flown.gyro, flown.accel[:, [2, 1, 0]])
    assert len(to_events(flown.time, flown.gyro, flown.accel[:, [2, 1, 0]], check=False))


def test_what_is_not_used_is_counted_by_array_and_reason(flown):
    accel, lat, vel_n = flown.accel.copy(), flown.gnss["lat_deg"].copy(), flown.gnss["vel_n"].copy()
    accel[1000:1030], lat[50:60], vel_n[70:74, 0] = NAN, NAN, NAN
    std_v = np.full(len(lat), 2.0)
    std_v[[3, 8]] = 0.0, NAN
    gnss = flown.gnss | {"lat_deg": lat, "vel_n": vel_n, "std_v": std_v}
    early = flown.baro | {"time": flown.baro["time"] - 10.0}
    found = flown.estimate(accel=accel, gnss=gnss, baro=early)
    outside = int(np.count_nonzero(early["time"] < flown.time[0] - 2.0))
    assert dict(found.dropped) == {
        "accel": 30,
        "gnss.lat_deg": 10,
        "gnss.vel_n": 4,
        "gnss.std_v": 2,
        "baro.time": outside,
    }
    assert len(found) <= len(flown.time) - 30
    notes = "\n".join(found.notes)
    assert "accel: 30 of 1500 rows hold NaN or infinity, the first is row 1000; they" in notes
    assert "gnss.lat_deg: 10 of 150 rows hold NaN" in notes
    assert "gnss.vel_n: 4 of 150 rows hold NaN or infinity north or east, the first is r" in notes
    assert "gnss.std_v: 2 of 150 rows are not greater than 0, the first is row 3" in notes
    assert f"baro.time: {outside} of 750 rows lie outside the time of the inertial" in notes
    assert "rows dropped accel 30, gnss.lat_deg 10" in repr(found)


@pytest.mark.parametrize(("name", "number"), [("accel", 1e6), ("gyro", 500.0), ("gyro", -300.0)])
def test_samples_that_no_sensor_measures_are_counted(flown, name, number):
    values = getattr(flown, name).copy()
    values[1000:1010, 1] = number
    found = flown.estimate(**{name: values})
    assert len(flown.time) - 11 <= len(found) <= len(flown.time) - 10
    assert dict(found.dropped) == {name: 10}
    note = found.notes[0]
    assert re.match(rf"{name}: 10 of 1500 rows hold more than 2000? \S+, which no sensor", note)
    assert "the first is row 1000; they were not used" in note


@pytest.mark.parametrize(("name", "number"), [("accel", 200.0), ("gyro", 30.0)])
def test_spikes_are_noted(flown, name, number):
    values = getattr(flown, name).copy()
    values[1000:1003] = number
    note = flown.estimate(**{name: values}).notes[0]
    assert note.startswith(f"{name}: 3 of 1500 rows are spikes: far larger than the others")
    assert "the first is row 1000; they were used" in note


def test_a_flight_without_mistakes_has_no_notes(flown):
    found = flown.estimate()
    assert found.notes == ()
    assert "; resets 0; rows dropped 0; notes 0>" in repr(found)
    assert " m by its own sigma; " in repr(found)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda f: {"gnss": None}, "no position: no fix was given"),
        (lambda f: {"gnss": at(f, slice(40, 41))}, "no position: there is a single fix"),
        (lambda f: {"mag": None, "gnss": at(f, slice(0, 30))}, "no manoeuvre changed the velocity"),
    ],
)
def test_why_there_is_no_position_is_said(flown, change, sentence):
    found = flown.estimate(**change(flown))
    assert found.notes[0].startswith("no position")
    assert sentence in found.notes[0]
    assert "; no position; " in repr(found)


def at(flown, rows):
    return {name: column[rows] for name, column in flown.gnss.items()}


def test_too_little_for_an_attitude_is_said(flown):
    few = slice(0, 50)
    with pytest.raises(LogError, match=r"down was not found in 1\.0 s with 50 inertial samples"):
        estimate(flown.time[few], flown.gyro[few], flown.accel[few])


def test_that_fixes_lack_a_velocity_is_said_where_down_is_not_found(flown):
    few = slice(0, 20)
    parts = {"time": flown.time[few], "gyro": flown.gyro[few], "accel": flown.accel[few]}
    fixes = at(flown, few) | {"time": flown.gnss["time"][few] * 1e-2 + flown.time[0]}
    with pytest.raises(LogError) as found:
        flown.estimate(**parts, gnss=fixes, mag=None, baro=None, check=False)
    assert "vel_n" not in str(found.value)
    del fixes["vel_n"]
    with pytest.raises(LogError, match=r"down was not found .*; gnss has no vel_n: with the vel"):
        flown.estimate(**parts, gnss=fixes, mag=None, baro=None, check=False)


def test_time_without_aid_and_resets_are_said(flown):
    accel = flown.accel.copy()
    accel[1000:1150] = NAN
    rows = np.abs(flown.gnss["time"] - flown.gnss["time"][110]) > 1.5
    found = flown.estimate(accel=accel, gnss=at(flown, rows))
    notes = "\n".join(found.notes)
    assert found.resets >= 1
    assert f"{found.resets} reset" in notes
    assert "dead reckoning: no fix was used for more than a second" in notes
    assert f"; resets {found.resets}; " in repr(found)
    assert "dead reckoning" in repr(found)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda f: {"gnss": f.gnss | {"lat_deg": np.deg2rad(f.gnss["lat_deg"])}},
            r"degraded: [^\n]*; position: (\d+) of (\d+) fixes refused \(look at lat_deg",
        ),
        (
            lambda f: {"gnss": f.gnss | dict.fromkeys(("lat_deg", "lon_deg"), 0.0 * f.gnss["alt"])},
            r"no position: (\d+) of (\d+) fixes are at latitude and longitude 0",
        ),
        (
            lambda f: {"mag": f.mag | {"field": np.tile([0.2, 0.0, 0.4], (len(f.mag["time"]), 1))}},
            r"degraded: [^\n]*; heading: (\d+) of (\d+) headings refused \(look at heading",
        ),
    ],
)
def test_which_aid_was_refused_is_said_with_counts(flown, change, sentence):
    given = {"mag": None, "baro": None, "check": False} | change(flown)
    for smooth in (False, True):
        notes = "\n".join(flown.estimate(smooth=smooth, **given).notes)
        refused, of = map(int, re.search(sentence, notes).groups())
        assert 0.3 * of < refused <= of


def test_a_start_that_is_not_confirmed_yet_is_no_lack_of_an_aid(flown):
    (note,) = flown.estimate(mag=None).notes
    assert re.search(r"degraded: new attitude, not proven yet \d\.\d s$", note)


@pytest.mark.parametrize("name", ["zupt", "mahony"])
def test_a_filter_that_takes_no_fixes_says_so(flown, name):
    found = flown.estimate(filter=name)
    assert f"{name}: takes no fixes, so positions and velocities of gnss were not used" in "".join(
        found.notes
    )
    without = flown.estimate(filter=name, gnss=None)
    assert not [note for note in without.notes if "takes no fixes" in note]


def test_the_heading_of_an_eskf_run_helps_a_filter_that_needs_one(flown):
    with pytest.raises(LogError, match=r"no heading: .* from Python, give mag or heading, such as"):
        flown.estimate(filter="ukf", mag=None)
    track = flown.estimate(mag=None)
    known = track.status >= 3
    heading = {"time": track.time[known], "heading": track.euler[known, 2], "std": 0.1}
    assert error(flown, flown.estimate(filter="ukf", mag=None, heading=heading))[0] < 2.0


def test_a_wing_whose_x_points_sideways_is_doubted():
    flight = Flight.plan("loiter", COARSE, duration=60.0, seed=4)
    found = events(flight)
    imu, gnss = (found.take(found.kind == kind) for kind in (Kind.IMU, Kind.GNSS))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    fixes = {
        "time": gnss.t_ns,
        "lat_rad": gnss.values[:, 0],
        "lon_rad": gnss.values[:, 1],
        "alt": gnss.values[:, 2],
        "vel_n": gnss.values[:, 3:6],
    }
    gyro, accel = imu.values[:, :3], imu.values[:, 3:6]
    right = estimate(imu.t_ns, gyro, accel, gnss=fixes)
    assert not [note for note in right.notes if "x axis" in note]
    turned = estimate(imu.t_ns, gyro @ turn.T, accel @ turn.T, gnss=fixes)
    assert "the vehicle goes +9" in turned.notes[-1]
    assert " deg from its x axis through all turns: if it has wings or wheels" in turned.notes[-1]


def test_degrees_at_rest_are_known_by_the_bias():
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 20.0, 0.01)
    accel = DOWN * -9.81 + rng.normal(0.0, 0.03, (len(time), 3))
    gyro = rng.normal(0.0, 0.002, (len(time), 3)) + 0.01
    to_events(time, gyro, accel)
    with pytest.raises(DataError, match="gravity stands still in the accelerometer: it looks"):
        to_events(time, np.rad2deg(gyro), accel)


@pytest.mark.parametrize(("bank", "rate"), [(0.0, 0.6), (0.45, 0.6)])
def test_a_steady_turn_is_no_rest(bank, rate):
    """A hover that turns on its spot, and a banked turn of a wing: the force stands still."""
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 30.0, 0.01)
    body = np.array([0.0, np.sin(bank), np.cos(bank)])
    accel = DOWN * (-9.81 / np.cos(bank)) + rng.normal(0.0, 0.03, (len(time), 3))
    to_events(time, body * rate + rng.normal(0.0, 0.002, (len(time), 3)), accel)


def test_a_trajectory_becomes_a_data_frame_and_a_file_of_tums_format(flown, tmp_path):
    found = flown.estimate()
    for library in ("pandas", "polars"):
        if find_spec(library) is None:
            continue
        frame = found.to_dataframe(library)
        assert len(frame) == len(found)
        assert np.array_equal(frame["pos_n"].to_numpy(), found.pos_n[:, 0], equal_nan=True)
    with pytest.raises(ConfigError, match="use 'pandas' or 'polars'"):
        found.to_dataframe("excel")
    found.to_tum(tmp_path / "flight.tum")
    rows = np.loadtxt(tmp_path / "flight.tum")
    known = found.status >= 3
    assert rows.shape == (np.count_nonzero(known), 8)
    assert np.allclose(rows[:, 1], found.pos_n[known, 1], atol=6e-7)  # six digits
    assert np.allclose(rows[:, 3], -found.pos_n[known, 2], atol=6e-7)
    # Body forward, left, up to east, north, up: forward of the last row by its yaw
    x, y, z, w = rows[-1, 4:]
    forward = so3.rotate(np.array([w, x, y, z]), np.array([1.0, 0.0, 0.0]))
    yaw, pitch = found.euler[known][-1, 2], found.euler[known][-1, 1]
    level = np.cos(pitch)
    assert forward == pytest.approx(
        [np.sin(yaw) * level, np.cos(yaw) * level, np.sin(pitch)], abs=1e-6
    )
    up = so3.rotate(np.array([w, x, y, z]), np.array([0.0, 0.0, 1.0]))
    assert up[2] > 0.7


def test_a_trajectory_is_written_as_convert_writes_it(flown, tmp_path):
    found = flown.estimate()
    found.to_csv(tmp_path / "track.csv")
    assert is_estimate(tmp_path / "track.csv")
    read = read_estimate(tmp_path / "track.csv")
    known = np.isfinite(found.lat_deg)
    assert np.array_equal(read.pos_t_ns, found.t_ns[known] // 1000 * 1000)
    assert read.alt == pytest.approx(found.alt[known])


class Answer(OwnAid):
    """Answers what it was told to."""

    def __init__(self, answer):
        self.answer = answer

    def innovation(self, state):
        return self.answer

    def covariance(self):
        return np.eye(1)


def own(flown, *aids):
    """Return an aid of one's own in the middle of a flight."""
    middle = float(flown.time[len(flown.time) // 2])
    return {"filter": "euler", "aids": [(middle, aid) for aid in aids]}


class Rangefinder(OwnAid):
    """Height above a level ground."""

    aid = "range"

    def __init__(self, height, std):
        self.height, self.std = height, std

    def innovation(self, state):
        return self.height + state.pos_n[..., 2:3]

    def covariance(self):
        return np.array([[self.std**2]])


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["iterated", "euler", "ukf"])
def test_an_aid_of_ones_own_is_fused(flown, name):
    baseless = {"filter": name, "baro": None}
    without = flown.estimate(**baseless)
    at_ns = without.t_ns[::100]
    place = np.searchsorted(flown.truth.att_t_ns, at_ns)
    # Of the frame's origin, the first fix
    heights = flown.truth.alt[place] - flown.gnss["alt"][0]
    aids = [(int(t), Rangefinder(h, 0.02)) for t, h in zip(at_ns, heights, strict=True)]
    aided = flown.estimate(**baseless, aids=aids)
    late = slice(len(aided) // 2, None)
    errors = [
        np.std((one.alt - flown.truth.alt[np.searchsorted(flown.truth.att_t_ns, one.t_ns)])[late])
        for one in (without, aided)
    ]
    assert errors[1] < 0.05 < errors[0]
    with pytest.raises(ConfigError, match="eskf: takes no aids of your own; euler, iterated, ukf"):
        flown.estimate(aids=aids)


def test_the_jacobian_by_differences_is_that_of_the_model(flown):
    from ekf_companion.filters.strapdown import Nominal

    state = Nominal(
        q_nb=so3.from_euler(0.3, -0.2, 1.0), vel_n=np.array([3.0, 1.0, 0.2]), pos_n=np.ones(3)
    )
    H = Rangefinder(1.0, 0.1).jacobian(state)
    assert pytest.approx(np.eye(15)[8:9] * -1.0, abs=1e-8) == H  # central difference, step 1e-6


def test_a_filter_of_ones_own_runs_over_arrays(flown):
    def complementary(recording, settings, option):
        return mahony.run(recording.events, gap=settings.imu.gap_reset)

    found = flown.estimate(filter=complementary)
    assert np.abs(found.euler[-1, :2]).max() < 0.5


def test_tab_and_types_find_it():
    assert {"estimate", "Stream", "open_log", "run_filter", "OwnAid"} <= set(dir(ekf_companion))
    assert all(getattr(ekf_companion, name) is not None for name in dir(ekf_companion))
    for name in ("estimate", "Stream", "Estimates"):
        assert "shape" in getattr(ekf_companion, name).__doc__ or name != "estimate"
    from importlib.resources import files

    assert (files("ekf_companion") / "py.typed").is_file()


def test_a_multicopter_that_tilts_its_own_force_is_not_taken_for_degrees():
    # its force stays along its own z, however fast it banks from one side to the other
    t = np.arange(0.0, 60.0, 0.01)
    roll_rate = 0.9 * np.cos(1.5 * t)
    gyro = np.stack([roll_rate, np.full_like(t, 0.05), np.zeros_like(t)], axis=1)
    accel = np.tile([0.05, 0.0, -9.83], (len(t), 1))
    to_events(t, gyro, accel)
    with pytest.raises(DataError, match="it looks like deg/s"):
        to_events(t, np.full_like(gyro, 0.4), accel)


def test_the_bias_of_a_gyro_that_stands_for_an_hour_is_not_taken_for_degrees():
    t = np.arange(0.0, 3600.0, 0.1)
    gyro = np.tile(np.deg2rad([0.5, -0.4, 0.3]), (len(t), 1))
    to_events(t, gyro, np.tile([0.0, 0.0, -9.81], (len(t), 1)))
    with pytest.raises(DataError, match="it looks like deg/s"):
        to_events(t, np.rad2deg(gyro), np.tile([0.0, 0.0, -9.81], (len(t), 1)))


def test_of_a_declared_aid_is_said_what_was_dropped_and_what_was_refused(flown):
    t = flown.baro["time"]
    ranges = {"time": t, "range": np.where(np.arange(len(t)) < 5, -1.0, 7.0)}
    found = flown.estimate(aids={"range_finder": ranges})
    assert found.dropped == {"range_finder.range": 5}
    why = "5 of 750 rows lie outside of what there is, 0 to 10000 m, the first is row 0"
    assert f"range_finder.range: {why}; they were not used" in found.notes
    wild = np.random.default_rng(1).uniform(0.3, 400.0, len(t))
    found = flown.estimate(aids={"range_finder": {"time": t, "range": wild}})
    (note,) = [one for one in found.notes if one.startswith("range_finder: ")]
    assert re.match(r"range_finder: \d+ of 7\d\d measurements refused \(look at what it poi", note)
