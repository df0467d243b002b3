"""Rows that are no measurement: the same becomes of them in every kind of log and message."""

import re

import numpy as np
import pytest

from ekf_companion.engine.health import Aid
from ekf_companion.errors import LogError
from ekf_companion.nav.held_heading import REPEATED
from ekf_companion.nav.held_velocity import ALWAYS_ZERO, COURSE_HELD, HELD, MOVING, HeldVelocities
from ekf_companion.nav.held_velocity import REPEATED as REPEATED_VELOCITY
from ekf_companion.nav.measurements import Events, Kind, merge
from ekf_companion.nav.repetition import AXIS, LIMITED, SPIKE, STUCK, ZERO
from ekf_companion.replay.log_source import open_log
from ekf_companion.replay.screen import Screen
from ekf_companion.review.evidence import Evidence
from ekf_companion.review.left_out import (
    FROZEN,
    NO_FIELD,
    NO_PRESSURE,
    VERTICAL_ZERO,
    LeftOut,
    of_telemetry,
)
from ekf_companion.review.verdict import judge
from tests.rows import BOOT_NS, FORMATS, UTC_ZERO_US, Rows, convert, write

TABLES = ("csv", "bin", "ulg")
RECEIVERS = ("bin", "ulg")
BY_COURSE = tuple(kind for kind in FORMATS if kind not in ("csv", "ulg"))
"""Formats that have speed and course; the others hold a vector."""
WEEK_US = 604_800_000_000

FLIGHT = Rows.plan()
HOVER = Rows.plan("hover")

in_every_format = pytest.mark.parametrize("kind", FORMATS)


@pytest.fixture
def rows():
    return FLIGHT.copy()


def verdict(found):
    return judge(found.report, Evidence()).sentence


def left_out(found):
    """Return how many measurements were left out, by reason."""
    return {one.why: one.number for one in found.report.left_out}


def worst(errors, found, begin, end=np.inf):
    return np.nanmax(errors[(found.since > begin) & (found.since < end)])


@in_every_format
def test_nothing_is_left_out_of_a_flight_without_fault(rows, kind, tmp_path):
    found = convert(rows, kind, tmp_path, has_heading=True)
    # Hundredths of a degree repeat by chance
    assert left_out(found).get(REPEATED, 0) < 6
    assert set(left_out(found)) <= {REPEATED}
    assert verdict(found) == "good: no resets"
    assert worst(found.distance, found, 20.0) < 1.5
    assert worst(found.tilt, found, 20.0) < 1.5
    assert worst(found.yaw, found, 20.0) < 3.0


@in_every_format
def test_a_place_at_0_0_is_none_before_the_fix_and_while_it_is_lost(rows, kind, tmp_path):
    lost = (rows.fix_since < 8.0) | ((rows.fix_since > 30.0) & (rows.fix_since < 36.0))
    rows.fix[lost] = 0.0
    found = convert(rows, kind, tmp_path)
    assert verdict(found) == "fair: without GNSS for 5 s"
    assert worst(found.distance, found, 38.0) < 2.0


@in_every_format
@pytest.mark.parametrize(
    ("fault", "why"), [("hangs", STUCK), ("gyro hangs", STUCK), ("is gone", ZERO)]
)
def test_samples_that_say_the_same_are_left_out_as_a_gap(rows, kind, fault, why, tmp_path):
    """Rows of a sensor that hangs turned the vehicle on its back: tilt 120 deg, yaw 179 deg."""
    hung = rows.since > 50.0
    columns = slice(3) if fault == "gyro hangs" else slice(6)
    last = rows.imu[np.searchsorted(rows.since, 50.0), columns]
    rows.imu[hung, columns] = 0.0 if fault == "is gone" else last
    found = convert(rows, kind, tmp_path)
    assert hung.sum() - 25 < left_out(found)[why] <= hung.sum()
    assert "inertial samples end at " in verdict(found)
    assert worst(found.tilt, found, 20.0) < 5.0
    assert worst(found.yaw, found, 20.0) < 5.0


@in_every_format
def test_a_sensor_that_hangs_for_a_while_is_believed_when_it_speaks_again(rows, kind, tmp_path):
    hung = (rows.since > 30.0) & (rows.since < 33.0)
    rows.imu[hung] = rows.imu[np.searchsorted(rows.since, 30.0)]
    found = convert(rows, kind, tmp_path)
    assert 270 < left_out(found)[STUCK] <= 300
    assert "no inertial samples for " in verdict(found)
    assert worst(found.tilt, found, 55.0) < 5.0
    assert worst(found.distance, found, 40.0) < 3.0


@in_every_format
def test_an_accelerometer_at_the_end_of_its_range_is_named_and_used(rows, kind, tmp_path):
    """Without its samples the tilt was 70 deg off, with a larger noise 3 deg."""
    rows.imu[:, 3:] = np.clip(rows.imu[:, 3:], -10.5, 10.5)
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[LIMITED] > 2000
    assert "the inertial sensor is at the end of its range" in verdict(found)
    assert worst(found.tilt, found, 20.0) < 6.0


@in_every_format
@pytest.mark.parametrize("begin", [0.0, 25.0])
def test_a_gyro_with_an_axis_that_is_stuck_at_0_is_named_and_used(rows, kind, begin, tmp_path):
    """Yaw is 74 deg off then, and nothing else says why."""
    is_stuck = rows.since >= begin
    rows.imu[is_stuck, 2] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[AXIS] > 0.5 * np.count_nonzero(is_stuck)
    assert "of a sensor with an axis that is stuck" in found.notes
    assert "the inertial sensor is stuck on an axis" in verdict(found)


@in_every_format
@pytest.mark.parametrize("begin", [0.0, 25.0])
@pytest.mark.parametrize("axes", [[0, 1], [1, 2], [0, 2]])
def test_two_axes_of_a_gyro_that_are_stuck_at_0_are_named(rows, kind, axes, begin, tmp_path):
    is_stuck = rows.since >= begin
    rows.imu[np.ix_(is_stuck, axes)] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[AXIS] > 0.85 * np.count_nonzero(is_stuck)
    assert verdict(found).startswith("poor")
    assert "the inertial sensor is stuck on an axis" in verdict(found)


@in_every_format
@pytest.mark.parametrize("begin", [0.0, 25.0])
def test_a_gyro_that_is_stuck_at_0_is_left_out_as_a_gap(rows, kind, begin, tmp_path):
    """Whatever the tilt is then, nobody knows: it was 60 degrees off."""
    is_stuck = rows.since >= begin
    rows.imu[is_stuck, :3] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[STUCK] > 0.85 * np.count_nonzero(is_stuck)
    assert "of a sensor that is stuck" in found.notes
    assert re.search("inertial samples end at .*the inertial sensor is stuck", verdict(found))
    # At rest before the take-off zeros are right
    assert found.since[-1] < max(begin + 1.0, 7.0)


@in_every_format
@pytest.mark.parametrize(("axes", "value"), [([0], 32.767), ([2], -32.768), ([0, 1, 2], 32.767)])
def test_single_spikes_of_a_gyro_are_left_out_and_named(rows, kind, axes, value, tmp_path):
    """32.767 rad/s ends 16 bits of mrad/s: the tilt was 30 degrees off, and the flight good."""
    spikes = np.arange(100, len(rows.imu), 150)
    rows.imu[np.ix_(spikes, axes)] = value
    found = convert(rows, kind, tmp_path)
    # Of a .tlog the first 3 s await a better message
    assert left_out(found) == {SPIKE: pytest.approx(len(spikes), abs=2)}
    assert "leap by more than 10 rad/s or 32 g, and back" in found.notes
    assert verdict(found) == "good: no resets"
    assert worst(found.tilt, found, 20.0) < 2.0


@in_every_format
@pytest.mark.parametrize("table", ["imu_ns", "fix_ns"])
def test_a_row_with_stamp_0_costs_itself_and_no_row_before_it(rows, kind, table, tmp_path):
    whole = convert(rows, kind, tmp_path)
    stamps = getattr(rows, table)
    places = (len(stamps) * np.array([0.3, 0.5, 0.52, 0.8])).astype(int)
    stamps[places] = 0
    found = convert(rows, kind, tmp_path)
    lost = len(places) if table == "imu_ns" else 0
    assert len(whole.table) - len(found.table) == lost
    assert verdict(found).startswith("good: no resets")
    assert worst(found.distance, found, 20.0) < 1.5


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize(
    ("count", "words"), [(1, "good: no resets, 1 row"), (150, "fair: 150 rows")]
)
def test_rows_that_are_dropped_for_their_stamps_are_named_in_the_verdict(
    rows, kind, count, words, tmp_path
):
    """Of a .csv alone; the same flight as .bin or .ulg was good with thousands dropped."""
    rows.imu_ns[1000 : 1000 + 20 * count : 20] += 10**15
    found = convert(rows, kind, tmp_path)
    assert verdict(found) == f"{words} dropped"


@in_every_format
def test_a_block_that_stands_in_a_log_twice_counts_once(rows, kind, tmp_path):
    """All before it was dropped, as of another boot; in telemetry it cost nothing."""
    whole = convert(rows, kind, tmp_path)
    for name, stamps, columns in (
        (Kind.IMU, "imu_ns", ["imu"]),
        (Kind.GNSS, "fix_ns", ["fix", "fix_type", "heading", "utc_us"]),
        (Kind.MAG, "mag_ns", ["mag"]),
        (Kind.BARO, "baro_ns", ["baro"]),
    ):
        came = rows.arrivals_ns[name]
        again = (came >= BOOT_NS + 20 * 10**9) & (came < BOOT_NS + 25 * 10**9)
        for one in (stamps, *columns):
            values = getattr(rows, one)
            setattr(rows, one, np.concatenate([values, values[again]]))
        late = BOOT_NS + 25 * 10**9 - 10**6 + (came[again] - BOOT_NS - 20 * 10**9) // 100_000
        rows.arrivals_ns[name] = np.concatenate([came, late])
    found = convert(rows, kind, tmp_path)
    assert verdict(found) == verdict(whole)
    assert np.array_equal(found.table.stamp_ns, whole.table.stamp_ns)
    assert ("rows repeat earlier ones to the bit" in found.notes) == (kind in TABLES)
    assert worst(found.distance, found, 20.0) < 1.5


def test_a_counter_of_32_bits_that_goes_round_costs_nothing(rows, tmp_path):
    """It cost half of the flight: a step back by 71.6 minutes was taken for a reboot."""
    period_ns = 1000 * (1 << 32)
    stamps = [rows.imu_ns, rows.fix_ns, rows.mag_ns, rows.baro_ns]
    for one in stamps:
        one += period_ns - BOOT_NS - 30 * 10**9
    whole = convert(rows, "csv", tmp_path)
    for one in stamps:
        one %= period_ns
    found = convert(rows, "csv", tmp_path)
    assert found.notes == whole.notes
    assert np.array_equal(found.table.stamp_ns, whole.table.stamp_ns)
    latitudes = [one.table.column("lat_deg") for one in (found, whole)]
    assert np.array_equal(*latitudes, equal_nan=True)


@in_every_format
def test_stamps_that_have_lost_digits_are_named(rows, kind, tmp_path):
    rows.imu_ns = rows.imu_ns // 500_000_000 * 500_000_000
    found = convert(rows, kind, tmp_path)
    assert "inertial samples have the stamp of the one before" in found.notes
    assert "inertial samples share their stamps" in verdict(found)
    assert "ask for a faster stream" not in found.notes


@pytest.mark.parametrize("kind", TABLES)
def test_rows_that_are_not_in_the_order_of_their_times_are_named(rows, kind, tmp_path):
    np.random.default_rng(1).shuffle(rows.imu_ns)
    try:
        words = convert(rows, kind, tmp_path).notes
    except LogError as why:
        words = str(why)
    assert "not in the order of their times" in words


@in_every_format
def test_a_heading_that_is_held_between_updates_counts_once(rows, kind, tmp_path):
    second = rows.fix_since.astype(int)
    rows.heading = rows.heading[np.searchsorted(second, second)]
    found = convert(rows, kind, tmp_path, has_heading=True)
    assert left_out(found)[REPEATED] >= 230
    assert worst(found.yaw, found, 20.0) < 2.0
    assert verdict(found) == "good: no resets"


@in_every_format
def test_a_heading_of_0_is_none_where_the_vehicle_does_not_point_north(rows, kind, tmp_path):
    rows.heading[(rows.fix_since > 20.0) & (rows.fix_since < 30.0)] = 0.0
    found = convert(rows, kind, tmp_path, has_heading=True)
    assert worst(found.yaw, found, 20.0) < 3.0
    assert verdict(found) == "good: no resets"


@in_every_format
def test_a_heading_of_360_that_is_held_counts_no_more_than_any_other(rows, kind, tmp_path):
    """In a message it is north, and was used each time: 21 % of the headings refused."""
    rows.heading[(rows.fix_since > 20.0) & (rows.fix_since < 30.0)] = 360.0
    found = convert(rows, kind, tmp_path, has_heading=True)
    assert worst(found.yaw, found, 20.0) < 3.0
    assert verdict(found) == "good: no resets"


@in_every_format
def test_a_field_that_is_frozen_is_no_field(rows, kind, tmp_path):
    """A table's was used again and again until it was refused: yaw 4.7 deg off."""
    since = (rows.mag_ns - BOOT_NS) * 1e-9
    is_frozen = (since > 30.0) & (since < 45.0)
    rows.mag[is_frozen] = rows.mag[is_frozen][0]
    found = convert(rows, kind, tmp_path)
    reason = r"\(no compass [\d.]+ s\)"
    assert re.fullmatch(rf"(fair|poor): degraded for \d+ s {reason}", verdict(found))
    assert worst(found.yaw, found, 20.0) < 3.0


def test_a_field_that_repeats_at_rest_counts_once_a_second():
    """Of a simulator without noise a vehicle at rest has no other."""
    t_ns = BOOT_NS + np.arange(500) * 10_000_000
    sample = (0.0, 0.0, 0.0, 0.0, 0.0, -9.81)
    found = []
    for turn in (0.0, 0.1):
        samples = np.tile(sample, (len(t_ns), 1)) + 1e-6 * np.arange(len(t_ns))[:, None]
        samples[:, 2] += turn
        imu = Events.from_columns(t_ns, Kind.IMU, *samples.T)
        mag = Events.from_columns(t_ns[::10], Kind.MAG, *np.tile((0.2, 0.0, 0.4), (50, 1)).T)
        out = Screen().pass_on(merge(imu, mag))
        found.append(np.count_nonzero(out.kind == Kind.MAG))
    assert found == [5, 1]


@in_every_format
def test_zeros_between_the_samples_do_not_make_the_others_late(rows, kind, tmp_path):
    """One sample in ten was none, and ten in a hundred were said to have come too late."""
    rows.imu[np.flatnonzero((rows.since > 20.0) & (rows.since < 50.0))[1::4]] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[ZERO] == pytest.approx(750, abs=1)
    assert "too late" not in verdict(found) + found.notes


@pytest.mark.parametrize("kind", TABLES)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_velocity_that_is_no_number_costs_no_position(rows, kind, value, tmp_path):
    """The fixes were left out in .csv and .bin, and were "without a 3-D fix" in the words."""
    rows.fix[(rows.fix_since > 20.0) & (rows.fix_since < 30.0), 3] = value
    found = convert(rows, kind, tmp_path)
    assert verdict(found) == "good: no resets"
    assert "without a 3-D fix" not in found.notes
    assert worst(found.distance, found, 20.0) < 2.0


@in_every_format
@pytest.mark.parametrize(
    ("vel", "why", "words"),
    [
        ((0.0, 0.0), ALWAYS_ZERO, "the receiver's velocity is always 0"),
        ((5.0, 1.0), HELD, "the receiver's velocity is held"),
    ],
)
def test_a_velocity_that_stands_while_positions_move_is_left_out(
    rows, kind, vel, why, words, tmp_path
):
    """It led a flight 225 m astray; without any velocity the same flight is within 2 m."""
    rows.fix[:, 3:5] = vel
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[why] > 200
    assert words in verdict(found)
    assert worst(found.distance, found, 20.0) < 3.0


@in_every_format
@pytest.mark.parametrize("vel", [0.0, None])
def test_a_receiver_that_freezes_in_motion_is_named(rows, kind, vel, tmp_path):
    """It says one place, and that it stands there, or its last speed."""
    begin = int(np.searchsorted(rows.fix_since, 25.0))
    rows.fix[begin:] = rows.fix[begin]
    if vel is not None:
        rows.fix[begin:, 3:] = vel
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[FROZEN] == pytest.approx(len(rows.fix) - begin, abs=4)
    assert "the receiver is frozen, and they were not used" in found.notes
    assert re.search("poor: .*the receiver is frozen", verdict(found))


@in_every_format
def test_a_velocity_that_is_0_from_a_moment_on_is_not_refused_for_good(rows, kind, tmp_path):
    """Once none comes, none is refused: the rest of a .tlog was degraded, and poor."""
    rows.fix[rows.fix_since > 25.0, 3:] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[ALWAYS_ZERO] > 150
    assert verdict(found).startswith("good")
    assert "the receiver's velocity is always 0" in verdict(found)


@pytest.mark.parametrize("kind", TABLES)
def test_a_vertical_velocity_of_0_is_left_out_while_heights_move(rows, kind, tmp_path):
    rows.fix[:, 5] = 0.0
    found = convert(rows, kind, tmp_path)
    assert left_out(found) == {VERTICAL_ZERO: len(rows.fix)}
    assert "the receiver's vertical velocity is always 0" in verdict(found)


@in_every_format
def test_a_velocity_that_begins_to_stand_is_left_out_from_there(rows, kind, tmp_path):
    begin = int(np.searchsorted(rows.fix_since, 30.0))
    rows.fix[begin:, 3:5] = rows.fix[begin, 3:5]
    found = convert(rows, kind, tmp_path)
    assert sum(left_out(found).values()) == len(rows.fix) - begin - 2
    assert verdict(found) == "good: no resets, the receiver's velocity is held"
    assert worst(found.distance, found, 20.0) < 2.0


@in_every_format
def test_a_velocity_that_is_held_between_updates_counts_once(rows, kind, tmp_path):
    """Once a second among five fixes: counted five times it led 14 m astray."""
    second = rows.fix_since.astype(int)
    rows.fix[:, 3:6] = rows.fix[np.searchsorted(second, second), 3:6]
    found = convert(rows, kind, tmp_path)
    assert left_out(found)[REPEATED_VELOCITY] > 120
    assert worst(found.distance, found, 20.0) < 3.0


@pytest.mark.parametrize("kind", BY_COURSE)
def test_a_velocity_whose_course_is_held_at_low_speed_is_left_out(kind, tmp_path):
    """A hover that wanders at 0.8 m/s: its velocity pointed back half of the time."""
    rows = HOVER.copy()
    speed = np.hypot(*rows.fix[:, 3:5].T)
    course = np.arctan2(rows.fix[:, 4], rows.fix[:, 3])
    is_held = (rows.fix_since > 20.0) & (rows.fix_since < 55.0)
    course[is_held] = course[is_held][0]
    rows.fix[:, 3:5] = np.stack([speed * np.cos(course), speed * np.sin(course)], axis=1)
    found = convert(rows, kind, tmp_path)
    # in a message speeds are in cm/s
    assert left_out(found)[COURSE_HELD] >= np.count_nonzero(speed[is_held][2:] > MOVING + 0.01)
    assert worst(found.distance, found, 20.0) < 2.0


def test_a_course_that_repeats_once_or_at_speed_may_be_chance():
    courses = [0.1, 0.5, 0.5, 0.9, 1.2, 1.2, 1.2]
    for speed, held in ((1.0, [6]), (3.0, []), (0.2, [])):
        judge = HeldVelocities()
        why = []
        for i, course in enumerate(courses):
            v = speed + 0.001 * i
            vel = (v * np.cos(course), v * np.sin(course), None)
            why.append(judge.judge(i * 200_000_000, (0.8, 0.1 + 1e-7 * i, 500.0), vel, 1.0, 1.5)[0])
        assert [i for i, one in enumerate(why) if one == COURSE_HELD] == held


@in_every_format
def test_inertial_samples_that_end_before_the_log_are_named(rows, kind, tmp_path):
    rows.keep_samples(rows.since < 30.0)
    found = convert(rows, kind, tmp_path)
    assert verdict(found).startswith("fair: inertial samples end at ")


# Before HIGHRES_IMU nothing here says the autopilot's time
@pytest.mark.parametrize("kind", [one for one in FORMATS if one != "HIGHRES_IMU"])
def test_inertial_samples_that_begin_after_the_log_are_named(rows, kind, tmp_path):
    rows.keep_samples(rows.since > 20.0)
    found = convert(rows, kind, tmp_path)
    assert "inertial samples begin at " in verdict(found)


def utc_us(rows, kind, folder):
    """Return the UTC of the log's first row, us since 1970, and what is said about the log."""
    log = open_log(write(rows, kind, folder))
    zero_ns = log.utc_zero_ns
    return None if zero_ns is None else (zero_ns + BOOT_NS) // 1000, "\n".join(log.notes)


@pytest.mark.parametrize("kind", RECEIVERS)
def test_the_date_of_rows_without_a_fix_is_not_the_log_s(rows, kind, tmp_path):
    rows.fix_type[:40] = 1
    rows.utc_us[:40] -= 8 * 52 * WEEK_US
    rows.utc_us[40:45] += 18_000_000  # no leap seconds yet
    found, notes = utc_us(rows, kind, tmp_path)
    assert abs(found - UTC_ZERO_US - BOOT_NS // 1000) < 1000
    assert "date" not in notes


@pytest.mark.parametrize("kind", RECEIVERS)
def test_a_date_1024_weeks_early_is_mended_and_named(rows, kind, tmp_path):
    rows.utc_us -= 1024 * WEEK_US
    found, notes = utc_us(rows, kind, tmp_path)
    assert abs(found - UTC_ZERO_US - BOOT_NS // 1000) < 1000
    assert "1024 weeks" in notes


def test_a_date_long_before_the_firmware_is_not_used(rows, tmp_path):
    """Of 2002, and 1024 weeks later still before PX4 that writes degrees."""
    rows.utc_us -= (1024 + 2 * 52) * WEEK_US
    found, notes = utc_us(rows, "ulg", tmp_path)
    assert found is None
    assert "before the firmware" in notes


@in_every_format
@pytest.mark.parametrize(("begin", "end"), [(15, 40), (30, 99)])
def test_a_field_of_zeros_is_named_in_every_format(rows, kind, begin, end, tmp_path):
    since = (rows.mag_ns - BOOT_NS) * 1e-9
    is_zero = (since > begin) & (since < end)
    rows.mag[is_zero] = 0.0
    found = convert(rows, kind, tmp_path)
    count = np.count_nonzero(is_zero)
    # RAW_IMU and SCALED_IMU bring the field with each sample, twice as often
    times = 1 if kind in (*TABLES, "HIGHRES_IMU") else 2
    assert left_out(found)[NO_FIELD] == pytest.approx(times * count, abs=times + 1)
    assert "magnetic fields are of zeros: they were not used" in found.notes
    assert "magnetic fields of zeros" in verdict(found)


@in_every_format
@pytest.mark.parametrize("alt", [15_900.0, 26_100.0, 11_050.0])
def test_a_pressure_below_that_of_the_troposphere_is_none_in_every_format(
    rows, kind, alt, tmp_path
):
    """In kPa for hPa; in hPa for Pa; and a balloon's."""
    is_high = (rows.baro_ns - BOOT_NS) * 1e-9 > 30.0
    rows.baro[is_high] += alt - rows.baro.mean()
    found = convert(rows, kind, tmp_path)
    # In the 32 bits of a message a few are the one before again, which counts once
    assert left_out(found)[NO_PRESSURE] == pytest.approx(np.count_nonzero(is_high), abs=4)
    assert "of a pressure that air has nowhere up to 11 km" in found.notes
    assert "the barometer's pressure is none of the air" in verdict(found)
    assert worst(found.distance, found, 20.0) < 1.5


@in_every_format
def test_a_vehicle_at_ten_kilometres_has_a_barometer(rows, kind, tmp_path):
    rows.baro += 10_000.0 - rows.baro.mean()
    found = convert(rows, kind, tmp_path)
    assert NO_PRESSURE not in left_out(found)
    assert found.report.health.fused(Aid.BARO) > 500


@pytest.mark.parametrize("kind", ["HIGHRES_IMU", "RAW_IMU", "SCALED_IMU"])
def test_zeros_of_a_vehicle_without_a_compass_are_not_named(rows, kind, tmp_path):
    rows.mag[:] = 0.0
    found = convert(rows, kind, tmp_path)
    assert NO_FIELD not in left_out(found)


def test_the_counts_of_a_telemetry_log_become_the_words_of_any_log():
    refused = {"refused: RAW_IMU: stuck": 30, "refused: GPS_RAW_INT: velocity held": 7}
    found = list(of_telemetry(refused, {Kind.IMU: 70, Kind.GNSS: 10}))
    assert found == [LeftOut(Kind.IMU, STUCK, 30, 100), LeftOut(Kind.GNSS, HELD, 7, 10)]
    assert [one.words for one in found] == [
        "the inertial sensor is stuck",
        "the receiver's velocity is held",
    ]
