import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import DFReader

from ekf_companion.errors import LogError
from ekf_companion.logs import dataflash
from ekf_companion.logs.dataflash_records import read_tables
from ekf_companion.logs.estimate import read_truth
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import GnssFlag, HeadingSource, Kind
from ekf_companion.nav.mounting import trim_matrix

CODES = {"c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "n": "4s", "N": "16s", "Z": "64s"}
CODES |= {"M": "B"}


class Writer:
    """Writes a DataFlash log: formats first, then rows by name, numbers as they are in the file."""

    def __init__(self):
        self.data = b""
        self.types = {}
        self.define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")

    def define(self, number, name, characters, columns):
        layout = struct.Struct("<" + "".join(CODES.get(one, one) for one in characters))
        self.types[name] = (number, layout)
        fields = (number, layout.size + 3, name.encode(), characters.encode(), columns.encode())
        self.data += bytes([0xA3, 0x95, 128]) + struct.pack("<BB4s16s64s", *fields)

    def row(self, name, *values):
        number, layout = self.types[name]
        self.data += bytes([0xA3, 0x95, number]) + layout.pack(*values)


def new_log(n=50):
    """Write a log of the new layout: 100 Hz IMU of two instances, 10 Hz of the rest."""
    log = Writer()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "GPS", "QBBcLLefff", "TimeUS,I,Status,HDop,Lat,Lng,Alt,Spd,GCrs,VZ")
    log.define(3, "GPA", "QBCCCBI", "TimeUS,I,HAcc,VAcc,SAcc,VV,SMS")
    log.define(4, "ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw")
    log.define(5, "ARM", "QB", "TimeUS,ArmState")
    log.define(6, "EV", "QB", "TimeUS,Id")
    log.define(7, "PARM", "QNf", "TimeUS,Name,Value")
    log.row("PARM", 0, b"GPS1_DELAY_MS", 120.0)
    for index in range(n):
        us = 1_000_000 + 10_000 * index
        log.row("IMU", us, 1, 9, 9, 9, 9, 9, 9)
        log.row("IMU", us, 0, 0.5, 0.25, -0.5, 1.0, 2.0, -9.75)
        if index % 10 == 0:
            status = 1 if index == 0 else 3
            log.row("GPS", us, 0, status, 150, -353632610, 1491652300, 58400, 5.0, 90.0, -1.0)
            log.row("GPA", us, 0, 40, 0, 25, int(index < 40), us // 1000 - 30)
            log.row("ATT", us, 100, -200, 27000)
        if index == 20:
            log.row("ARM", us, 1)
        if index == 30:
            log.row("EV", us, 28)
    return log.data


@pytest.fixture
def read(tmp_path):
    def write_and_read(data):
        path = tmp_path / "flight.bin"
        path.write_bytes(data)
        return dataflash.read(path)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


def test_the_first_inertial_sensor_is_read_and_the_others_are_named(read):
    recording = read(new_log())
    imu = of_kind(recording, Kind.IMU)
    assert imu.t_ns[:2].tolist() == [1_000_000_000, 1_010_000_000]
    assert imu.values[0, :6].tolist() == [0.5, 0.25, -0.5, 1.0, 2.0, -9.75]
    assert "IMU: instance 0 is used; the log also holds 1" in recording.notes


def test_a_fix_has_the_sample_time_and_the_accuracies_of_its_gpa_row(read):
    fixes = of_kind(read(new_log()), Kind.GNSS)
    assert len(fixes) == 4  # the first row has no fix
    assert fixes.t_ns[0] == 1_070_000_000
    lat, lon, alt, north, east, down, std_h, std_v, std_vel, declination, flags = fixes.values[
        0, :11
    ]
    assert (np.rad2deg(lat), np.rad2deg(lon), alt) == pytest.approx((-35.363261, 149.16523, 584.0))
    assert (north, east, down) == pytest.approx((0.0, 5.0, -1.0), abs=1e-12)
    # VAcc 0 is none: the model's 1.5 times HDop 1.5.
    assert (std_h, std_v, std_vel) == (0.4, 2.25, 0.25)
    assert np.isnan(declination)
    assert flags == GnssFlag.NONE


def test_a_receiver_without_vertical_velocity_has_none(read):
    assert np.isnan(of_kind(read(new_log()), Kind.GNSS).values[-1, 5])


def test_the_autopilots_heading_is_marked_as_its_own(read):
    heading = of_kind(read(new_log()), Kind.HEADING)
    assert len(heading) == 5
    assert heading.values[0, 0] == pytest.approx(-np.pi / 2.0)
    assert heading.values[0, 2] == HeadingSource.AUTOPILOT


def test_armed_and_landed_are_told_when_they_change(read):
    vehicle = of_kind(read(new_log()), Kind.VEHICLE)
    assert vehicle.t_ns.tolist() == [1_200_000_000, 1_300_000_000]
    np.testing.assert_array_equal(vehicle.values[:, :2], [[1.0, np.nan], [1.0, 0.0]])


def test_the_delay_that_a_parameter_sets_is_given(read):
    assert read(new_log()).gnss_delay == pytest.approx(0.12)


def test_events_arrive_in_the_order_of_the_file(read):
    recording = read(new_log())
    imu = np.flatnonzero(recording.events.kind == Kind.IMU)
    fix = np.flatnonzero(recording.events.kind == Kind.GNSS)[0]
    # Stamped 30 ms before the inertial sample that stands before it in the file.
    newest = recording.events.t_ns[imu[imu < fix][-1]]
    assert newest - recording.events.t_ns[fix] == 30_000_000


def test_the_old_layout_takes_boot_time_from_the_column_t_of_a_fix(read):
    log = Writer()
    log.define(1, "IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "GPS", "BIHcLLeEefI", "Status,TimeMS,Week,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,T")
    log.define(3, "EKF1", "IccCffffff", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
    log.define(4, "EV", "B", "Id")
    for index in range(20):
        ms = 5000 + 20 * index
        log.row("IMU", ms, 0, 0, 0, 0, 0, -9.8)
        log.row("EKF1", ms, 0, 0, 9000, 0, 0, 0, 0, 0, 0)
        log.row("GPS", 3, 600_000_000, 1871, 50, 100000000, 200000000, 5000, 250, 0, 0, ms)
    log.row("EV", 10)
    recording = read(log.data)
    fixes = of_kind(recording, Kind.GNSS)
    assert fixes.t_ns[0] == 5_000_000_000
    assert fixes.values[0, 3] == 2.5
    assert fixes.values[0, 6:9].tolist() == [0.5, 0.75, 0.3]  # by HDop 0.5: the floor
    assert of_kind(recording, Kind.VEHICLE).t_ns.tolist() == [5_380_000_000]
    # The filter's origin is nowhere in the log: it is put where the fixes say.
    assert np.rad2deg(recording.reference.lat) == pytest.approx(np.full(20, 10.0))
    assert any("fitted to the GNSS fixes" in note for note in recording.notes)


def test_a_row_whose_type_was_damaged_is_not_taken_for_a_shorter_one(tmp_path):
    log = Writer()
    log.define(1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(2, "BARO", "Qf", "TimeUS,Alt")
    for index in range(20):
        log.row("IMU", 10_000 * index, 0, 0, 0, 0, 0, -9.8)
    data = bytearray(log.data)
    data[-10 * 35 + 2] = 2
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(data))
    tables = read_tables(path)[0]
    assert "BARO" not in tables
    assert len(tables["IMU"]) == 19


@pytest.mark.parametrize(
    ("begin_us", "damaged", "note"),
    [
        (0, {500: 2**60}, "1 row whose time stamps do not fit the log's clock was dropped"),
        (
            30_000_000,
            {400: 2**60, 500: 0, 600: 0},
            "3 rows whose time stamps do not fit the log's clock (2 of them 0) were dropped",
        ),
    ],
)
def test_rows_of_a_damaged_clock_are_dropped_and_counted(read, begin_us, damaged, note):
    log = Writer()
    log.define(1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for index in range(1000):
        us = damaged.get(index, begin_us + 10_000 * index)
        log.row("IMU", us, 0, 0, 0, 0, 0, -9.8)
    recording = read(log.data)
    assert len(recording.events) == 1000 - len(damaged)
    assert note in recording.notes


WHOLE = new_log()


@settings(max_examples=200, deadline=None)
@given(
    place=st.integers(0, len(WHOLE)),
    junk=st.binary(max_size=40),
    cut=st.integers(0, 300),
)
def test_damage_anywhere_leaves_a_recording_or_a_sentence(tmp_path_factory, place, junk, cut):
    path = tmp_path_factory.getbasetemp() / "damaged.bin"
    path.write_bytes(WHOLE[:place] + junk + WHOLE[place + cut :])
    try:
        recording = dataflash.read(path)
    except LogError as error:
        assert str(error).startswith(str(path))  # noqa: PT017
    else:
        assert np.isfinite(recording.events.values[:, 0]).all()


@pytest.mark.parametrize("rest", [0, 1, 5])
def test_a_record_that_the_end_of_the_file_cuts_is_noted(read, rest):
    again = b"\xa3\x95\x80\x80FM"
    notes = read(WHOLE + again[:rest]).notes
    cut = "the last byte is" if rest == 1 else f"the last {rest} bytes are"
    expected = [f"{cut} no whole record: the recording was cut off there"] if rest else []
    assert [one for one in notes if "cut off" in one] == expected


@settings(max_examples=50, deadline=None)
@given(place=st.integers(0, len(WHOLE) - 1))
def test_a_cut_log_gives_what_stands_before_the_cut(tmp_path_factory, place):
    path = tmp_path_factory.getbasetemp() / "cut.bin"
    path.write_bytes(WHOLE[:place])
    try:
        tables = read_tables(path)[0]
    except LogError:
        assert place < 89 or WHOLE[:place].count(b"FMT") == 0
    else:
        assert sum(map(len, tables.values())) >= (place - 7 * 89) // 40 - 1


@settings(max_examples=50, deadline=None)
@given(data=st.binary(max_size=300))
def test_what_is_no_dataflash_log_is_refused_by_a_sentence(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.bin"
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"any\.bin: "):
        dataflash.read(path)


def test_a_log_with_nothing_to_estimate_from_says_what_to_record(read):
    log = Writer()
    log.define(7, "PARM", "QNf", "TimeUS,Name,Value")
    log.row("PARM", 0, b"GPS1_DELAY_MS", 120.0)
    with pytest.raises(LogError, match="LOG_BITMASK"):
        read(log.data)


@pytest.mark.parametrize(
    "name",
    [
        "ardupilot-bin-copter-50hz/log171.bin",
        "ardupilot-bin-copter-netherlands/spark404_log.bin",
        "ardupilot-bin-no-gps/dataflash-sample-1.bin",
    ],
)
def test_columns_agree_with_pymavlink(flight, name):
    path = flight(name)
    reader = DFReader.DFReader_binary(str(path))
    tables = {name: rows.all() for name, rows in read_tables(path)[0].items()}
    for message in ("IMU", "GPS", "ATT", "BARO", "MAG", "EKF1", "NKF1", "XKF1"):
        rows = []
        reader.rewind()
        while len(rows) < 300 and (row := reader.recv_match(type=message)) is not None:
            rows.append(row)
        assert (message in tables) == bool(rows)
        for field in rows[0].get_fieldnames() if rows else ():
            theirs = [getattr(row, field) for row in rows]
            np.testing.assert_allclose(tables[message][field][:300], theirs, rtol=1e-12)
    reader.data_map.close()
    reader.filehandle.close()


@pytest.mark.parametrize(
    ("name", "fixes", "samples"),
    [
        ("ardupilot-bin-copter-50hz/log171.bin", 1038, 11916),
        ("ardupilot-bin-copter-netherlands/spark404_log.bin", 254, 1258),
        ("ardupilot-bin-no-gps/dataflash-sample-1.bin", 0, 6818),
        ("sitl-arducopter-bin/flight.bin", 723, 15203),
    ],
)
def test_recorded_flights_give_their_events_and_the_autopilots_estimate(
    flight, name, fixes, samples
):
    recording = dataflash.read(flight(name))
    assert recording.family == "ardupilot"
    assert len(of_kind(recording, Kind.GNSS)) == fixes
    assert len(of_kind(recording, Kind.IMU)) == samples
    assert np.all(np.diff(recording.reference.att_t_ns) > 0)
    assert len(recording.reference.vel_n) > 100


def test_the_simulators_truth_agrees_with_what_was_recorded_beside_it(flight):
    from ekf_companion.analysis import score

    recording = dataflash.read(flight("sitl-arducopter-bin/flight.bin"))
    truth = read_truth(flight("sitl-arducopter-bin/truth.csv"))
    found = score.score(recording.truth, truth)
    assert found.horizontal.rms < 0.01
    assert found.yaw.rms < np.deg2rad(0.01)
    assert abs(found.lag) < 1e-3
    # The attitude of SIM is its quaternion.
    assert np.allclose(np.linalg.norm(recording.truth.q_nb, axis=1), 1.0)
    assert so3.to_euler(recording.truth.q_nb).shape == (1520, 3)


def test_the_boards_trim_turns_its_sensors_into_the_vehicles_axes(read):
    rows = Writer()
    rows.define(8, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ")
    for index in range(10):
        rows.row("MAG", 1_000_000 + 50_000 * index, 0, 210, 30, 420)
    before = read(new_log() + rows.data)
    rows.define(7, "PARM", "QNf", "TimeUS,Name,Value")
    for name, value in ((b"AHRS_TRIM_X", 0.03), (b"AHRS_TRIM_Y", -0.05), (b"AHRS_TRIM_X", 0.1)):
        rows.row("PARM", 0, name, value)  # what is set later, in flight, does not count
    after = read(new_log() + rows.data)
    assert len(of_kind(before, Kind.MAG)) == 10
    C_vb = trim_matrix(0.03, -0.05)
    for kind, columns in ((Kind.IMU, (slice(0, 3), slice(3, 6))), (Kind.MAG, (slice(0, 3),))):
        for part in columns:
            expected = of_kind(before, kind).values[:, part] @ C_vb.T
            assert np.allclose(of_kind(after, kind).values[:, part], expected, atol=1e-9)
    assert any("roll 1.7 and pitch -2.9 deg (AHRS_TRIM)" in note for note in after.notes)
    assert not any("AHRS_TRIM" in note for note in before.notes)


def test_the_hull_pressure_of_a_submarine_is_no_height(read):
    rows = Writer()
    rows.define(8, "BARO", "QBf", "TimeUS,I,Alt")
    rows.define(9, "MSG", "QZ", "TimeUS,Message")
    for index in range(10):
        rows.row("BARO", 1_000_000 + 50_000 * index, 0, 100.0)
    before = read(new_log() + rows.data)
    rows.row("MSG", 1_000_000, b"ArduSub V4.1.0 (f2af3c7e)")
    after = read(new_log() + rows.data)
    assert len(of_kind(before, Kind.BARO)) > 0
    assert len(of_kind(after, Kind.BARO)) == 0
    assert any("air within the hull" in note for note in after.notes)
