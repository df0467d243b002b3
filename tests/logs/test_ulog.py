import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyulog import ULog

from ekf_companion.analysis import score
from ekf_companion.errors import LogError
from ekf_companion.logs import ulog, ulog_messages
from ekf_companion.logs.estimate import read_truth
from ekf_companion.nav.measurements import GnssFlag, HeadingSource, Kind

CODES = {
    "uint32_t": "I",
    "uint64_t": "Q",
    "float": "f",
    "double": "d",
    "int32_t": "i",
    "uint8_t": "B",
    "bool": "?",
}
CODES["int8_t"] = "b"


class Writer:
    """Writes a ULog: formats, then parameters, then rows."""

    def __init__(self, topics, parameters=()):
        self.data = ULog.HEADER_BYTES + b"\x01" + struct.pack("<Q", 0)
        self.layouts = []
        for name, fields in topics:
            text = ";".join(f"{kind} {field}" for kind, field in fields)
            self.message("F", f"{name}:{text};".encode())
            codes = []
            for kind, _ in fields:
                base, _, size = kind.partition("[")
                codes.append(CODES[base] * int(size.rstrip("]") or 1))
            self.layouts.append(struct.Struct("<" + "".join(codes)))
        for name, value in parameters:
            key = f"float {name}".encode()
            self.message("P", bytes([len(key)]) + key + struct.pack("<f", value))
        for index, (name, _) in enumerate(topics):
            self.message("A", struct.pack("<BH", 0, index) + name.encode())

    def message(self, kind, payload):
        self.data += struct.pack("<HB", len(payload), ord(kind)) + payload

    def row(self, index, *values):
        self.message("D", struct.pack("<H", index) + self.layouts[index].pack(*values))


COMBINED = (
    "sensor_combined",
    [("uint64_t", "timestamp"), ("float[3]", "gyro_rad"), ("float[3]", "accelerometer_m_s2")],
)
VELOCITY = [(kind, f"vel_{axis}_m_s") for kind, axis in zip(["float"] * 3, "ned", strict=True)]
OLD_GPS = (
    "vehicle_gps_position",
    [
        ("uint64_t", "timestamp"),
        ("int32_t", "lat"),
        ("int32_t", "lon"),
        ("int32_t", "alt"),
        *VELOCITY,
        ("float", "eph"),
        ("float", "epv"),
        ("float", "s_variance_m_s"),
        ("float", "heading"),
        ("uint8_t", "fix_type"),
    ],
)
NEW_GPS = (
    "sensor_gps",
    [
        ("uint64_t", "timestamp"),
        ("uint64_t", "timestamp_sample"),
        ("double", "latitude_deg"),
        ("double", "longitude_deg"),
        ("double", "altitude_msl_m"),
        *VELOCITY,
        ("uint8_t", "fix_type"),
        ("uint8_t", "jamming_state"),
        ("uint8_t", "spoofing_state"),
    ],
)
STATUS = ("vehicle_status", [("uint64_t", "timestamp"), ("uint8_t", "arming_state")])
LANDED = ("vehicle_land_detected", [("uint64_t", "timestamp"), ("bool", "landed")])


def small_log(gps=OLD_GPS, n=40, early_us=1000, parameters=(("EKF2_GPS_DELAY", 110.0),)):
    log = Writer([COMBINED, gps, STATUS, LANDED], parameters)
    for index in range(n):
        us = 1_000_000 + 5000 * index
        log.row(0, us, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
        if index % 10 == 5:
            velocity = (1.0, 2.0, 3.0)
            if gps is OLD_GPS:
                position = (473977000, 85455000, 489000)
                log.row(1, us, *position, *velocity, 0.5, 0.75, 0.25, float("nan"), 3)
            else:
                log.row(1, us, us - early_us, 47.3977, 8.5455, 489.0, *velocity, 3, 3, 1)
        if index == 10:
            log.row(2, us, 2)
        if index == 20:
            log.row(3, us, False)
    return log.data


@pytest.fixture
def read(tmp_path):
    def write_and_read(data):
        path = tmp_path / "flight.ulg"
        path.write_bytes(data)
        return ulog.read(path)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


def test_rows_that_are_stamped_zero_are_dropped_and_named(read):
    log = Writer([COMBINED], {})
    for index in range(300):
        us = 0 if index in (40, 41) else 30_000_000 + 5000 * index
        log.row(0, us, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    found = read(log.data)
    assert len(found.events) == 298
    note = "2 rows whose time stamps do not fit the log's clock (2 of them 0) were dropped"
    assert note in found.notes


@pytest.mark.parametrize("gps", [OLD_GPS, NEW_GPS])
def test_both_ways_to_name_a_position_are_read(read, gps):
    fixes = of_kind(read(small_log(gps)), Kind.GNSS)
    assert len(fixes) == 4
    assert np.rad2deg(fixes.values[0, :2]) == pytest.approx([47.3977, 8.5455], abs=1e-12)
    assert fixes.values[0, 2:6].tolist() == [489.0, 1.0, 2.0, 3.0]


def test_a_fix_counts_when_the_receiver_sampled_it_where_that_is_said(read):
    assert of_kind(read(small_log(NEW_GPS)), Kind.GNSS).t_ns[0] == 1_024_000_000
    assert of_kind(read(small_log(OLD_GPS)), Kind.GNSS).t_ns[0] == 1_025_000_000


@pytest.mark.parametrize(
    ("parameters", "early_us", "stamp_ns", "delay"),
    [
        ((("EKF2_GPS_DELAY", 110.0),), 0, 1_025_000_000, 0.11),
        ((("SENS_GPS0_DELAY", 80.0), ("EKF2_GPS_DELAY", 110.0)), 0, 1_025_000_000, 0.08),
        ((("SENS_GPS0_DELAY", 110.0),), 110_000, 1_025_000_000, 0.11),  # PX4 1.18
        ((("SENS_GPS0_DELAY", 110.0),), 65_000, 960_000_000, 0.0),  # the receiver knows better
        ((("EKF2_GPS_DELAY", 110.0),), 65_000, 960_000_000, 0.0),
        ((), 65_000, 960_000_000, 0.0),
        ((), 0, 1_025_000_000, None),
    ],
)
def test_no_delay_is_taken_off_twice(read, parameters, early_us, stamp_ns, delay):
    recording = read(small_log(NEW_GPS, early_us=early_us, parameters=parameters))
    assert of_kind(recording, Kind.GNSS).t_ns[0] == stamp_ns
    assert recording.gnss_delay == (delay if delay is None else pytest.approx(delay))


def test_accuracies_are_the_receivers_or_on_the_safe_side(read):
    assert of_kind(read(small_log(OLD_GPS)), Kind.GNSS).values[0, 6:9].tolist() == [0.5, 0.75, 0.25]
    assert of_kind(read(small_log(NEW_GPS)), Kind.GNSS).values[0, 6:9].tolist() == [2.0, 3.0, 0.5]


def test_a_jammed_receiver_is_flagged(read):
    recording = read(small_log(NEW_GPS))
    assert set(of_kind(recording, Kind.GNSS).values[:, 10]) == {float(GnssFlag.SUSPECT)}
    assert "the receiver reports jamming or spoofing in 4 fixes" in recording.notes


def test_the_declared_delay_is_given_in_seconds(read):
    assert read(small_log()).gnss_delay == pytest.approx(0.11)


def test_armed_and_landed_are_told_when_they_change(read):
    vehicle = of_kind(read(small_log()), Kind.VEHICLE)
    assert vehicle.t_ns.tolist() == [1_050_000_000, 1_100_000_000]
    np.testing.assert_array_equal(vehicle.values[:, :2], [[1.0, np.nan], [1.0, 0.0]])


def test_no_position_and_no_fix_are_refused(read):
    log = Writer([COMBINED, NEW_GPS])
    log.row(0, 1_000_000, 0, 0, 0, 0, 0, -9.8)
    for place, fix in (((0.0, 0.0), 3), ((float("nan"), 8.0), 3), ((47.0, 8.0), 2)):
        log.row(1, 1_000_000, 0, *place, 489.0, 0, 0, 0, fix, 0, 0)
    recording = read(log.data)
    assert len(of_kind(recording, Kind.GNSS)) == 0
    assert "3 GPS rows without a 3-D fix were left out" in recording.notes


def test_the_projection_agrees_with_px4s_own_at_a_kilometre():
    # North 1000 m and east 1000 m of 47.4 N, 8.5 E on PX4's sphere, by its forward formula.
    lat0, lon0 = np.deg2rad(47.4), np.deg2rad(8.5)
    x, y = np.array([1000.0]), np.array([1000.0])
    lat, lon = ulog._unproject(x, y, lat0, lon0)
    c = np.arccos(np.sin(lat0) * np.sin(lat) + np.cos(lat0) * np.cos(lat) * np.cos(lon - lon0))
    k = c / np.sin(c) * ulog.EARTH_RADIUS
    north = k * (np.cos(lat0) * np.sin(lat) - np.sin(lat0) * np.cos(lat) * np.cos(lon - lon0))
    east = k * np.cos(lat) * np.sin(lon - lon0)
    assert (north[0], east[0]) == pytest.approx((1000.0, 1000.0), abs=1e-3)  # arccos near 0


def test_the_projections_origin_is_itself():
    lat, lon = ulog._unproject(np.zeros(1), np.zeros(1), np.array([0.8]), np.array([0.1]))
    assert (lat[0], lon[0]) == pytest.approx((0.8, 0.1), abs=1e-15)


WHOLE = small_log()


@settings(max_examples=200, deadline=None)
@given(
    place=st.integers(0, len(WHOLE)),
    junk=st.binary(max_size=30),
    cut=st.integers(0, 200),
)
def test_damage_anywhere_leaves_a_recording_or_a_sentence(tmp_path_factory, place, junk, cut):
    path = tmp_path_factory.getbasetemp() / "damaged.ulg"
    path.write_bytes(WHOLE[:place] + junk + WHOLE[place + cut :])
    try:
        recording = ulog.read(path)
    except LogError as error:
        assert str(error).startswith(str(path))  # noqa: PT017
    else:
        assert np.isfinite(recording.events.values[:, 0]).all()


@settings(max_examples=30, deadline=None)
@given(data=st.binary(max_size=300))
def test_what_is_no_ulog_is_refused_by_a_sentence(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.ulg"
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"any\.ulg: "):
        ulog.read(path)


def test_nothing_is_printed(read, capsys):
    read(WHOLE[:-500] + b"\0" * 50 + WHOLE[-500:])
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "fixes", "samples"),
    [
        ("px4-ulg-x500-mission/x500_mission_2023.ulg", 125, 13911),
        ("px4-ulg-x500-hover/x500_hover_2023-06-21.ulg", 121, 13465),
        ("px4-ulg-x500-no-gps/x500_no_gps_2023-06-21.ulg", 0, 12762),
        ("px4-ulg-fixedwing-ground/fw_ground_v6c.ulg", 13, 1297),
        ("sitl-px4-ulg/flight.ulg", 1187, 37053),
    ],
)
def test_recorded_flights_give_their_events_and_ekf2s_estimate(flight, name, fixes, samples):
    recording = ulog.read(flight(name))
    assert recording.family == "px4"
    assert len(of_kind(recording, Kind.GNSS)) == fixes
    assert len(of_kind(recording, Kind.IMU)) == samples
    heading = of_kind(recording, Kind.HEADING)
    assert set(heading.values[:, 2]) == {float(HeadingSource.AUTOPILOT)}
    assert len(heading) <= 10.5 * (heading.t_ns[-1] - heading.t_ns[0]) * 1e-9 + 1
    assert len(recording.reference.att_t_ns) > 100
    assert np.all(np.diff(recording.reference.att_t_ns) > 0)


def test_a_damaged_flight_keeps_its_longest_run_of_the_clock(flight):
    recording = ulog.read(flight("px4-ulg-damaged-fixedwing/damaged_format_not_utf8.ulg"))
    t_ns = of_kind(recording, Kind.IMU).t_ns
    assert len(t_ns) == 13944
    assert np.all(np.diff(t_ns) > 0)
    span_ns = recording.events.t_ns.max() - recording.events.t_ns.min()
    assert span_ns < 80_000_000_000
    assert any("time stamps do not fit the log's clock" in note for note in recording.notes)


def test_the_simulators_truth_agrees_with_what_was_recorded_beside_it(flight):
    truth = read_truth(flight("sitl-px4-ulg/truth.csv"))
    found = score.score(ulog.read(flight("sitl-px4-ulg/flight.ulg")).truth, truth)
    assert found.horizontal.rms < 0.01
    assert found.velocity.rms < 0.01
    assert found.tilt.rms < np.deg2rad(0.01)
    assert abs(found.lag) < 1e-3


@pytest.mark.parametrize(
    "name",
    [
        "px4-ulg-x500-mission/x500_mission_2023.ulg",
        "px4-ulg-fixedwing-ground/fw_ground_v6c.ulg",
        "px4-ulg-damaged-fixedwing/damaged_format_not_utf8.ulg",
        "sitl-px4-ulg/flight.ulg",
    ],
)
def test_every_row_of_every_topic_is_pyulogs(flight, name, capsys):
    theirs = ULog(str(flight(name)))
    capsys.readouterr()  # it prints what it finds damaged
    log = ulog_messages.read(flight(name), {one.name for one in theirs.data_list})
    ours = {(table.topic, table.instance): table.rows.all() for table in log.tables}
    assert ours.keys() == {(one.name, one.multi_id) for one in theirs.data_list}
    for one in theirs.data_list:
        rows = ours[one.name, one.multi_id]
        assert rows.dtype.names == tuple(one.data)
        for field, column in one.data.items():
            assert np.ascontiguousarray(rows[field]).tobytes() == column.tobytes()
    assert log.is_damaged == theirs.file_corruption
    assert len(log.dropouts) == len(theirs.dropouts)
    for name, value in theirs.initial_parameters.items():
        assert log.parameters[name] == value


def test_padding_at_the_end_of_a_row_is_left_out(read):
    topic, fields = COMBINED
    padded = Writer([(topic, [*fields, ("uint8_t[4]", "_padding0")])])
    padded.row(0, 1_000_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8, 0, 0, 0, 0)
    assert of_kind(read(padded.data), Kind.IMU).values[0, 2] == np.float32(0.3)


@pytest.mark.parametrize(
    ("cut", "words"), [(20, "the last {} bytes are no whole message"), (0, "")]
)
def test_a_message_that_the_end_of_the_file_cuts_is_noted(read, cut, words):
    whole = small_log()
    rows = Writer([COMBINED])
    begin = len(rows.data)
    rows.row(0, 2_000_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    last = len(rows.data) - begin
    found = [one for one in read(whole[: len(whole) - cut]).notes if "cut off there" in one]
    assert [one.partition(":")[0] for one in found] == ([words.format(last - cut)] if cut else [])


def test_data_that_were_appended_after_the_log_are_read(read, tmp_path):
    log = small_log(n=20)
    # flags: the file goes on at a place, whatever was left half written before it
    flags = struct.pack("<8B8B3Q", *[0] * 8, 1, *[0] * 7, len(log) + 43 + 4, 0, 0)
    head, body = log[:16], log[16:]
    message = struct.pack("<HB", len(flags), ord("B")) + flags
    again = Writer([COMBINED])
    again.data = again.data[:16]
    again.row(0, 1_200_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    recording = read(head + message + body + b"\x30\x00D\x00" + again.data[16:])
    assert of_kind(recording, Kind.IMU).t_ns[-1] == 1_200_000_000


@pytest.mark.parametrize("size", [b"65535", b"99999999", b"-1", b"x"])
def test_a_format_that_no_row_can_have_is_damage(read, size):
    log = small_log()
    big = b"sensor_gyro:big[%b] a;" % size
    big += b"" if size == b"x" else b"big[65535] b;"
    definitions = b"".join(
        struct.pack("<HB", len(text), ord("F")) + text
        for text in (b"big:more[65535] c;", b"more:float[65535] d;", big)
    )
    name = b"\x00\x00\x40sensor_gyro"
    subscription = struct.pack("<HB", len(name), ord("A")) + name
    assert len(of_kind(read(log[:16] + definitions + log[16:] + subscription), Kind.IMU)) == 40


def test_a_format_within_itself_is_damage(read):
    log = small_log(n=4)
    text = b"vehicle_attitude:vehicle_attitude q;"
    message = struct.pack("<HB", len(text), ord("F")) + text
    name = struct.pack("<BH", 0, 77) + b"vehicle_attitude"
    subscription = struct.pack("<HB", len(name), ord("A")) + name
    recording = read(log[:16] + message + log[16:] + subscription)
    assert "the file is damaged: what could not be read is lost" in recording.notes


def test_a_flag_that_changes_the_meaning_of_bytes_is_refused(read):
    flags = struct.pack("<8B8B3Q", *[0] * 8, 2, *[0] * 7, 0, 0, 0)
    message = struct.pack("<HB", len(flags), ord("B")) + flags
    log = small_log()
    with pytest.raises(LogError, match="a feature that is not known here"):
        read(log[:16] + message + log[16:])


def test_after_damage_the_search_goes_on_at_the_next_synchronisation(read):
    log = small_log(n=40)
    sync = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
    more = Writer([COMBINED])
    before = len(more.data)
    more.row(0, 1_205_000, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
    recording = read(log + b"\xff" * 50 + sync + more.data[before:])
    assert of_kind(recording, Kind.IMU).t_ns[-1] == 1_205_000_000
    assert "the file is damaged: what could not be read is lost" in recording.notes


OLD_COMBINED = (
    "sensor_combined",
    [
        ("uint64_t", "timestamp"),
        ("float[3]", "gyro_rad"),
        ("float[3]", "accelerometer_m_s2"),
        ("int32_t", "magnetometer_timestamp_relative"),
        ("float[3]", "magnetometer_ga"),
        ("int32_t", "baro_timestamp_relative"),
        ("float", "baro_alt_meter"),
    ],
)


def test_px4_before_1_8_holds_magnetometer_and_barometer_within_the_inertial_rows(read):
    log = Writer([OLD_COMBINED])
    none = 2**31 - 1
    for index in range(20):
        us = 1_000_000 + 4000 * index
        # a magnetic field each second row, 1 ms old; a pressure each fourth, repeated in between
        mag = -1000 if index % 2 == 0 else none
        baro = -2000 - 4000 * (index % 4)
        field = (0.2, 0.0, 0.4 + 0.001 * index)
        log.row(0, us, 0, 0, 0, 0, 0, -9.8, mag, *field, baro, 500.0 + index // 4)
    recording = read(log.data)
    mags, baros = of_kind(recording, Kind.MAG), of_kind(recording, Kind.BARO)
    assert len(of_kind(recording, Kind.IMU)) == 20
    assert mags.t_ns.tolist() == [999_000_000 + 8_000_000 * i for i in range(10)]
    assert mags.values[:, 2] == pytest.approx([0.4 + 0.002 * i for i in range(10)])
    assert baros.t_ns.tolist() == [998_000_000 + 16_000_000 * i for i in range(5)]
    assert baros.values[:, 0].tolist() == [500.0, 501.0, 502.0, 503.0, 504.0]
