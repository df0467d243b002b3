import gzip
from itertools import pairwise

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.errors import LogError
from ekf_companion.logs import csv, table
from ekf_companion.nav.measurements import HeadingSource, Kind
from ekf_companion.replay.log_source import open_log

IMU = "gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2"
GPS = "gps_lat_deg,gps_lon_deg,gps_alt_m"


@pytest.fixture
def read(tmp_path):
    def write_and_read(text, columns=None, beside=None):
        path = tmp_path / "log.csv"
        path.write_text(text)
        if beside is not None:
            (tmp_path / "log.csv.columns.yaml").write_text(beside)
        return csv.read(path, columns)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


def test_a_native_file_needs_no_map(read):
    recording = read(f"time_us,{IMU}\n1000,1,2,3,4,5,6\n2000,1,2,3,4,5,6\n")
    assert recording.events.t_ns.tolist() == [1_000_000, 2_000_000]
    assert recording.events.values[0, :6].tolist() == [1, 2, 3, 4, 5, 6]


def test_rows_that_are_stamped_zero_are_dropped_and_named(read):
    times = [0 if number in (40, 41) else 30_000_000 + 10_000 * number for number in range(300)]
    rows = [f"{time},{number}" for number, time in enumerate(times)]
    found = read("\n".join(["time_us,baro_alt_m", *rows, ""]))
    assert len(found.events) == 298
    note = (
        "2 rows without a time, or with one that does not fit the rest (2 of them 0) were dropped"
    )
    assert note in found.notes


@pytest.mark.parametrize(("unit", "time"), [("us", "1500000"), ("ms", "1500"), ("s", "1.5")])
def test_time_may_be_in_three_units(read, unit, time):
    assert read(f"time_{unit},baro_alt_m\n{time},7\n").events.t_ns.tolist() == [1_500_000_000]


def test_microseconds_since_1970_keep_every_digit(read):
    text = "time_us,baro_alt_m\n1700000000123457,1\n1700000000123458,2\n"
    expected = [1700000000123457000, 1700000000123458000]
    assert read(text).events.t_ns.tolist() == expected


def test_units_in_the_header_are_brought_to_si(read):
    header = IMU.replace("rps", "dps").replace("mps2", "g")
    imu = read(f"time_s,{header}\n1,180,0,0,0,0,-1\n").events
    assert imu.values[0, [0, 5]] == pytest.approx([np.pi, -9.80665])
    mag = read("time_s,mag_x_uT,mag_y_uT,mag_z_uT\n1,50,0,-20\n").events
    assert mag.values[0, :3] == pytest.approx([0.5, 0.0, -0.2])


def test_pressure_becomes_the_height_of_the_standard_atmosphere(read):
    events = read("time_s,baro_press_hPa\n1,1013.25\n2,898.7457\n").events
    assert events.values[:, 0] == pytest.approx([0.0, 1000.0], abs=0.05)  # ICAO table, 1000 m


def test_speed_and_course_are_a_velocity(read):
    text = f"time_s,{GPS},gps_speed_kmph,gps_course_deg\n1,47,8,500,36,90\n"
    values = read(text).events.values[0]
    assert values[3:5] == pytest.approx([0.0, 10.0], abs=1e-12)
    assert np.isnan(values[5])


def test_an_empty_cell_is_no_measurement(read):
    recording = read(f"time_s,{IMU},{GPS}\n1,0,0,0,0,0,-9.8,,,\n2,0,0,0,0,0,-9.8,47,8,500\n")
    assert of_kind(recording, Kind.GNSS).t_ns.tolist() == [2_000_000_000]
    assert len(of_kind(recording, Kind.IMU)) == 2


def test_within_a_row_the_inertial_sample_comes_last(read):
    recording = read(f"time_s,{IMU},heading_deg,{GPS}\n1,0,0,0,0,0,-9.8,90,47,8,500\n")
    assert recording.events.kind.tolist() == [Kind.GNSS, Kind.HEADING, Kind.IMU]


def test_accuracies_that_are_not_declared_are_assumed_aloud(read):
    recording = read(f"time_s,{GPS}\n1,47,8,500\n")
    assert recording.events.values[0, 6:9].tolist() == [2.0, 3.0, 0.5]
    assert "gps_std_h 2, gps_std_v 3, gps_std_vel 0.5" in " ".join(recording.notes)
    recording = read("time_s,heading_deg\n1,90\n")
    assert recording.events.values[0, 1] == pytest.approx(np.deg2rad(5.0))
    assert "heading_std 5" in " ".join(recording.notes)


def test_held_values_count_when_they_change(read):
    rows = "".join(f"{index},{47 + index // 10},8,500\n" for index in range(30))
    columns = f"time_s,{GPS}\n{rows}"
    assert len(of_kind(read(columns, beside="hold: [gps]\n"), Kind.GNSS)) == 3


def test_values_that_look_held_are_noted(read):
    rows = "".join(f"{index},{47 + index // 10},8,500\n" for index in range(30))
    recording = read(f"time_s,{GPS}\n{rows}")
    assert len(of_kind(recording, Kind.GNSS)) == 30
    assert any("declare hold: [gps]" in note for note in recording.notes)


def test_columns_that_are_not_ours_are_named(read):
    recording = read("time_s,baro_alt_m,mood\n1,2,3\n")
    assert "columns that are not ours were ignored: mood" in recording.notes


@pytest.mark.parametrize(
    ("header", "complaint"),
    [
        ("time_s,gyro_x_radps", "'gyro_x_radps': no known unit at its end; use gyro_x_rps"),
        ("time_s,mag_x", "'mag_x': no known unit at its end; use mag_x_gauss, mag_x_uT"),
        ("time_s,gyro_x_rps", "gyro_y, gyro_z, accel_x, accel_y, accel_z missing beside gyro_x"),
        ("time_s,gps_lat_deg,gps_lon_deg", "gps_alt missing beside"),
        ("time_s,gps_vn_mps", "gps_lat, gps_lon, gps_alt missing"),
        (f"time_s,{GPS},gps_speed_mps", "gps_course missing beside gps_speed"),
        (f"time_s,{GPS},gps_vd_mps", "gps_vn, gps_ve missing"),
        ("baro_alt_m,baro_alt_cm", "baro_alt stands in two columns"),
        ("baro_alt_m", "no time column"),
        ("a,b,c", "no column name of ours"),
        ("time_s,heading_std_deg", "heading_std without heading"),
        ("time_s", "no measurement found"),
    ],
)
def test_a_header_that_says_too_little_is_refused(read, header, complaint):
    with pytest.raises(LogError, match=r"log\.csv") as caught:
        read(header + "\n" + ",".join("1" for _ in header.split(",")) + "\n")
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "complaint"),
    [
        ({"gyro": {"column": "t", "unit": "s"}}, "gyro: unknown quantity; known are time"),
        ({"time": {"column": "t", "unit": "min"}}, "unknown unit 'min'; known are s, ms, us, ns"),
        ({"time": {"column": "t"}}, "time: no unit; known are"),
        ({"time": {"column": "nope", "unit": "s"}}, "no column 'nope'; there are: t, h"),
        ({"time": "t"}, "must be {column: NAME, unit: UNIT}"),
        ({"time": {"column": "t", "unit": "s", "offset": 1}}, "unknown key 'offset'"),
        ({"time": {"column": "t", "unit": "s", "sign": 2}}, "sign 2: must be 1 or -1"),
        ({"baro_alt": {"value": "high", "unit": "m"}}, "value 'high': must be a number"),
        ({"hold": "gps"}, "hold: 'gps' is not a list"),
        ({"delimiter": "semicolon"}, "is not one character"),
        ({"heading_source": "sun"}, "heading_source: 'sun'; known are gnss"),
    ],
)
def test_a_map_that_cannot_be_meant_is_refused(read, columns, complaint):
    whole = {"time": {"column": "t", "unit": "s"}, "heading": {"column": "h", "unit": "deg"}}
    with pytest.raises(LogError, match=r"log\.csv") as caught:
        read("t,h\n1,2\n", {**whole, **columns})
    assert complaint in str(caught.value)


def test_local_metres_need_an_origin(read):
    columns = {
        "time": {"column": "t", "unit": "s"},
        **{f"gps_{name}": {"column": name, "unit": "m"} for name in ("north", "east", "h")},
    }
    text = "t,north,east,h\n1,0,0,100\n2,1000,0,100\n"
    with pytest.raises(LogError, match=r"need an origin; declare origin: \{lat_deg"):
        read(text, columns)
    fixes = read(text, {**columns, "origin": {"lat_deg": 45.0, "lon_deg": 8.0}}).events.values
    assert np.rad2deg(fixes[0, :2]) == pytest.approx([45.0, 8.0])
    # A minute of latitude at 45 degrees is 1852.2 m.
    assert np.rad2deg(fixes[1, 0]) - 45.0 == pytest.approx(1000.0 / 1852.2 / 60.0, rel=1e-3)
    assert fixes[:, 2].tolist() == [100.0, 100.0]


def test_a_sign_turns_an_axis_round(read):
    columns = {
        "time": {"column": "t", "unit": "s"},
        "baro_alt": {"column": "depth", "unit": "cm", "sign": -1},
    }
    assert read("t,depth\n1,250\n", columns).events.values[0, 0] == -2.5


def test_the_map_beside_the_file_is_found(read):
    beside = "time: {column: t, unit: ms}\nbaro_alt: {column: h, unit: m}\ndelimiter: ';'\n"
    assert read("t;h\n5;2\n", beside=beside).events.t_ns.tolist() == [5_000_000]


def test_a_map_that_is_no_yaml_is_refused(read):
    with pytest.raises(LogError, match=r"columns\.yaml: is not YAML"):
        read("t,h\n1,2\n", beside="time: {column: t\n  x: [")


@pytest.mark.parametrize("target", ["absent.yaml", "log.csv.columns.yaml", "/dev/zero", "."])
def test_a_map_that_is_no_file_is_refused(read, tmp_path, target):
    (tmp_path / "log.csv.columns.yaml").symlink_to(target)
    with pytest.raises(LogError, match=r"columns\.yaml: is no file, or a link to none"):
        read("time_s,baro_alt_m\n1,10\n")


def test_a_last_line_cut_short_is_left_out(read):
    assert len(read("time_s,baro_alt_m,x_m\n1,10,0\n2,20,0\n3,3").events) == 2


def test_a_cell_that_is_no_number_is_named(read):
    with pytest.raises(LogError, match=r"log\.csv: .*'high'.* row 1"):
        read("time_s,baro_alt_m\n1,10\n2,high\n")


def test_a_header_alone_is_refused(read):
    with pytest.raises(LogError, match="ends after its header"):
        read("time_s,baro_alt_m\n")


WHOLE = (f"time_s,{IMU},{GPS}\n" + "0.1,0,0,0,0,0,-9.8,47.1,8.2,500\n" * 5).encode()


@settings(max_examples=300, deadline=None)
@given(place=st.integers(0, len(WHOLE)), junk=st.binary(max_size=5), cut=st.integers(0, 60))
def test_damage_anywhere_leaves_a_recording_or_a_sentence(tmp_path_factory, place, junk, cut):
    path = tmp_path_factory.getbasetemp() / "damaged.csv"
    path.write_bytes(WHOLE[:place] + junk + WHOLE[place + cut :])
    try:
        recording = csv.read(path)
    except LogError as error:
        assert str(error).startswith(str(path))  # noqa: PT017
    else:
        assert np.isfinite(recording.events.values[:, 0]).all()


CAR = {
    "time": {"column": "millis", "unit": "ms"},
    "gyro_x": {"column": "rollrate", "unit": "deg/s"},
    "gyro_y": {"column": "pitchrate", "unit": "deg/s"},
    "gyro_z": {"column": "yawrate", "unit": "deg/s"},
    **{f"accel_{axis}": {"column": f"a{axis}", "unit": "m/s2"} for axis in "xyz"},
    "gps_lat": {"column": "latitude", "unit": "deg"},
    "gps_lon": {"column": "longitude", "unit": "deg"},
    "gps_alt": {"column": "altitude", "unit": "m"},
    "gps_speed": {"column": "speed", "unit": "km/h"},
    "gps_course": {"column": "course", "unit": "deg"},
    "gps_std_h": {"column": "epe", "unit": "m"},
    "hold": ["gps"],
}


def test_a_phones_file_is_read_by_its_map(flight):
    recording = csv.read(flight("car-phone-2014/2014-03-26-000-Data.csv"), CAR)
    assert len(of_kind(recording, Kind.IMU)) == 10800
    fixes = of_kind(recording, Kind.GNSS)
    assert 1900 < len(fixes) < 2200
    assert np.hypot(fixes.values[:, 3], fixes.values[:, 4]).max() == pytest.approx(
        57.8 / 3.6, abs=0.1
    )


SEED = {
    "time": {"column": "time_s", "unit": "s"},
    **{f"gyro_{axis}": {"column": f"gyro_{axis}_rps", "unit": "rad/s"} for axis in "xyz"},
    **{f"accel_{axis}": {"column": f"accel_{axis}_mps2", "unit": "m/s2"} for axis in "xyz"},
    "heading": {"column": "mag2D_yaw_deg", "unit": "deg"},
    "heading_std": {"value": 1.74, "unit": "deg"},
    "gps_north": {"column": "gps_north_m", "unit": "m"},
    "gps_east": {"column": "gps_east_m", "unit": "m"},
    "gps_h": {"column": "gps_h_msl_m", "unit": "m"},
    **{f"gps_v{axis}": {"column": f"gps_v{axis}_mps", "unit": "m/s"} for axis in "ned"},
    "origin": {"lat_deg": 40.0, "lon_deg": 116.0},
}


def test_the_seeds_file_is_read_by_its_map(flight):
    recording = csv.read(flight("seed-basicekf-sim/uavSensors.csv"), SEED)
    assert len(of_kind(recording, Kind.IMU)) == 4001
    assert len(of_kind(recording, Kind.GNSS)) == 401
    heading = of_kind(recording, Kind.HEADING)
    assert len(heading) == 4001
    assert heading.values[0, 1] == pytest.approx(np.deg2rad(1.74))
    assert heading.values[0, 2] == HeadingSource.MAGNETOMETER
    assert of_kind(recording, Kind.GNSS).values[0, 2] == pytest.approx(110.0651038)


def table_of(rows, rng, damage=""):
    """Return a native file with numbers of all lengths, and empty cells."""
    lines = [f"time_us,{IMU},{GPS}"]
    for index in range(rows):
        cells = [repr(float(x)) for x in rng.normal(size=6) * 10.0 ** rng.integers(-12, 6)]
        cells += ["", "", ""] if index % 5 else ["47.25", " 8.5", "nan"]
        lines.append(",".join([str(1_700_000_000_000_000 + 4000 * index), *cells]))
    return "\n".join([*lines[: rows // 2], *([damage] if damage else []), *lines[rows // 2 :], ""])


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_large_table_has_the_bits_of_a_small_one(read, monkeypatch, end):
    text = table_of(500, np.random.default_rng(4)).replace("\n", end)
    small = read(text).events
    monkeypatch.setattr(table, "SMALL", 0)
    monkeypatch.delattr(table.Table, "_read_rows")  # Arrow reads it, or nobody
    large = read(text).events
    assert large.t_ns.tolist() == small.t_ns.tolist()
    assert large.values.tobytes() == small.values.tobytes()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ("1,2,3", "invalid column index"),
        ("1,2,3,4,5,6,x,8,9,10", "could not convert string 'x' to float"),
        ("1700000000000000,1,2,3,4,5,6,8,9,10,11,12", None),  # a cell too many does no harm
    ],
)
def test_a_large_table_is_refused_as_a_small_one(read, monkeypatch, damage, words):
    text = table_of(60, np.random.default_rng(4), damage)
    monkeypatch.setattr(table, "SMALL", 0)
    if words is None:
        assert len(of_kind(read(text), Kind.IMU)) == 61
        return
    with pytest.raises(LogError, match=words):
        read(text)


@pytest.mark.parametrize("suffix", [".gz", ".zst"])
def test_a_packed_file_is_read_with_the_map_of_the_one_within(tmp_path, suffix):
    pack = {".gz": gzip.compress, ".zst": zstandard.ZstdCompressor().compress}[suffix]
    path = tmp_path / f"log.csv{suffix}"
    path.write_bytes(pack(b"millis,h\n1000,7\n2000,8\n"))
    (tmp_path / "log.csv.columns.yaml").write_text(
        "time: {column: millis, unit: ms}\nbaro_alt: {column: h, unit: m}\n"
    )
    assert open_log(path).events.values[:, 0].tolist() == [7.0, 8.0]


@pytest.mark.parametrize("suffix", [".gz", ".zst"])
def test_a_packed_file_that_was_cut_gives_what_is_whole_in_it_and_says_so(tmp_path, suffix):
    pack = {".gz": gzip.compress, ".zst": zstandard.ZstdCompressor().compress}[suffix]
    noise = np.random.default_rng(1).normal(100.0, 20.0, 40_000)
    rows = "".join(f"{n * 10000},{one:.9f}\n" for n, one in enumerate(noise))
    packed = pack(b"time_us,baro_alt_m\n" + rows.encode())
    path = tmp_path / f"log.csv{suffix}"
    path.write_bytes(packed[: len(packed) // 2])
    log = open_log(path)
    np.testing.assert_allclose(log.events.values[:, 0], noise[: len(log.events)], atol=1e-9)
    assert 0.2 * len(noise) < len(log.events) < 0.6 * len(noise)
    assert log.notes == ("the packed file is cut short: what comes before that was read",)
    path.write_bytes(packed[:4] + b"damage all over")
    with pytest.raises(LogError, match=r"log\.csv\.(gz|zst): cannot be unpacked, it is damaged"):
        open_log(path)


@pytest.mark.parametrize("at_once", [1, 7, 64])
@pytest.mark.parametrize("hold", ["[]", "[gps, mag, baro]"])
def test_a_table_has_the_same_events_however_many_rows_are_read_at_once(
    read, monkeypatch, at_once, hold
):
    rng = np.random.default_rng(11)
    lines = ["time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2"]
    lines[0] += ",mag_x_gauss,mag_y_gauss,mag_z_gauss,baro_alt_m,gps_lat_deg,gps_lon_deg,gps_alt_m"
    for n in range(500):
        time = "" if n % 97 == 5 else str(4000 * n + (90_000_000_000 if n in (200, 201) else 0))
        mag = f"0.{2 + n // 9},0.1,0.4" if n % 31 else ",,"
        alt = "" if n % 13 == 7 else str(5 + n // 10)
        gps = f"{47 + n // 20 * 1e-5},8.5,500" if n % 50 else ",,"
        lines.append(f"{time},{rng.normal()},0,0,0,0,-9.8,{mag},{alt},{gps}")
    text = "\n".join(lines) + "\n"
    whole = read(text, beside=f"hold: {hold}\n")
    monkeypatch.setattr(csv, "AT_ONCE", at_once)
    parts = read(text, beside=f"hold: {hold}\n")
    assert parts.notes == whole.notes
    assert any("rows without a time" in note for note in whole.notes)
    for name in ("t_ns", "kind", "values"):
        assert getattr(parts.events, name).tobytes() == getattr(whole.events, name).tobytes()


@pytest.mark.parametrize(("other", "words"), [(";", "semicolons"), ("\t", "tabs")])
def test_columns_that_another_character_separates_are_named(tmp_path, other, words):
    log = tmp_path / "mine.csv"
    names = ["time_s", *(f"{one}_rps" for one in ("gyro_x", "gyro_y", "gyro_z"))]
    names += [f"accel_{axis}_mps2" for axis in "xyz"]
    rows = [f"{0.01 * i:.2f},0,0,0,0,0,-9.8" for i in range(3)]
    log.write_text("\n".join([",".join(names), *rows, ""]).replace(",", other))
    with pytest.raises(LogError, match=f"{words} separate its columns; say delimiter:") as found:
        csv.read(log)
    # what it says is what helps
    _, _, line = str(found.value).partition("say ")
    map_of = tmp_path / "mine.csv.columns.yaml"
    map_of.write_text(line.partition(" in a file")[0])
    assert len(csv.read(log).events) == 3


ALIASES = "a: &a [1, 1]\n" + "".join(f"{c}: &{c} [*{b}, *{b}]\n" for b, c in pairwise("abcdefghij"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ALIASES, "is an alias; write the value itself"),
        ("[" * 5000, "a list stands too deep in lists"),
        ("# \n" * 60_000, "larger than 128 KiB"),
        ("time: 2024-13-45", "is no timestamp; put text in quotes"),
        ("time: {column: a, unit: s}\ntime: {column: b, unit: s}", "time stands 2 times; keep one"),
        ("? [a]\n: b", "is not YAML"),
        ("time: \0", "is not YAML"),
        ("- time", "must be a map from quantity"),
        ("", "is empty"),
    ],
)
def test_a_map_of_columns_may_be_anything(tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text("t,h\n1,7\n")
    (tmp_path / "log.csv.columns.yaml").write_text(text)
    with pytest.raises(LogError, match=words):
        open_log(path)


def test_no_row_is_a_fix_where_there_is_no_place(read):
    places = ["0,0", "0.0,-0.0", "91,8", "47,nan", "47.1,8.1", "0,8", "47.1,368.1", "-90,180"]
    lines = ["time_us,gps_lat_deg,gps_lon_deg,gps_alt_m"]
    lines += [f"{n * 200_000},{place},400" for n, place in enumerate(places)]
    log = read("\n".join([*lines, ""]))
    assert len(log.events) == 4
    assert any(
        "3 rows of the receiver without a place, as 0, 0, were left out" in n for n in log.notes
    )
    assert np.degrees(log.events.values[:, 1]) == pytest.approx([8.1, 8.0, 8.1, -180.0], abs=1e-6)


def test_of_several_inertial_units_one_that_is_stuck_is_left(read):
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 1.0, (2, 2000, 6)) * np.repeat([0.004, 0.05], 3)
    means = np.array([[0, 0, 0, 0, 0, -9.81], [0.02, 0, 0, 0.1, 0, -9.71]])
    values = noise + means[:, None]
    values[0, 1500:] = values[0, 1500]
    header = f"time_us,{IMU},{IMU.replace('gyro', 'gyro2').replace('accel', 'accel2')}"
    rows = [
        ",".join([str(1_000_000 + 10_000 * n), *(f"{one:.6f}" for one in values[:, n].ravel())])
        for n in range(2000)
    ]
    recording = read("\n".join([header, *rows, ""]))
    samples = of_kind(recording, Kind.IMU)
    assert len(samples) >= 1990
    # What the second's biases are beside the first's is taken off
    np.testing.assert_allclose(samples.values[1600:, :3].mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_allclose(samples.values[1600:, 3:6].mean(axis=0), [0, 0, -9.81], atol=0.01)
    (note,) = [note for note in recording.notes if note.startswith("IMU")]
    assert note.startswith("IMU: gyro2, accel2 is used from 15.")
    assert note.endswith("gyro, accel is stuck")
    assert np.count_nonzero(samples.values[:, 6:].any(axis=1)) == 1
