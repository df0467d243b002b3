"""Which of several sensors and receivers of a PX4 log is used, and when."""

import struct

import numpy as np
import pytest

from ekf_companion.logs import ulog
from ekf_companion.nav.measurements import GNSS_FLAGS, GnssFlag, Kind
from tests.logs.test_ulog import COMBINED, NEW_GPS, Writer

SECONDS = 20
FIRST_LAT, SECOND_LAT = 47.3977, 47.3985
BIAS = 0.05
IDS = (100, 200)
FIELDS = ((0.2, 0.0, 0.4), (0.19, 0.01, 0.41))

IMU = (
    "vehicle_imu",
    [
        ("uint64_t", "timestamp"),
        ("uint64_t", "timestamp_sample"),
        ("int32_t", "gyro_device_id"),
        ("float[3]", "delta_angle"),
        ("float[3]", "delta_velocity"),
        ("int32_t", "delta_angle_dt"),
        ("int32_t", "delta_velocity_dt"),
    ],
)
POSITION = ("vehicle_gps_position", NEW_GPS[1])
MAG = (
    "vehicle_magnetometer",
    [("uint64_t", "timestamp"), ("int32_t", "device_id"), ("float[3]", "magnetometer_ga")],
)
BARO = (
    "vehicle_air_data",
    [("uint64_t", "timestamp"), ("int32_t", "baro_device_id"), ("float", "baro_alt_meter")],
)
SELECTOR = (
    "estimator_selector_status",
    [
        ("uint64_t", "timestamp"),
        ("int32_t", "gyro_device_id"),
        ("int32_t", "mag_device_id"),
        ("int32_t", "baro_device_id"),
    ],
)
INSTANCES = (
    (COMBINED, 0),
    (COMBINED, 1),
    (IMU, 0),
    (IMU, 1),
    (POSITION, 0),
    (NEW_GPS, 0),
    (NEW_GPS, 1),
    (MAG, 0),
    (MAG, 1),
    (BARO, 0),
    (BARO, 1),
    (SELECTOR, 0),
)


class Numbered(Writer):
    """Writes several instances of a topic."""

    def __init__(self, parameters=()):
        super().__init__([topic for topic, _ in INSTANCES], parameters)
        # The subscriptions stand at the end of the header
        self.data = self.data[: self.data.index(struct.pack("<HBBH", 18, ord("A"), 0, 0))]
        for index, (topic, instance) in enumerate(INSTANCES):
            self.message("A", struct.pack("<BH", instance, index) + topic[0].encode())


def never(number, s):
    return None


class Flight:
    """Writes a standing vehicle; the test says what each instance holds at a time, or None."""

    def __init__(self, parameters=()):
        self.parameters = parameters
        self.combined = lambda number, s: 0.01 if number == 0 else None
        """Rate about x."""
        self.imu = never
        self.imu_steps = 1
        """Every how many samples vehicle_imu is logged."""
        self.position = lambda number, s: None
        """Fix type and latitude of vehicle_gps_position, of sensor_gps."""
        self.gps = never
        self.mag = lambda number, s: FIELDS[0] if number == 0 else None
        self.baro = lambda number, s: 5.0 if number == 0 else None
        self.selected = lambda s: None
        """Numbers of the inertial sensor, the compass and the barometer of the primary filter."""

    def write(self):
        log = Numbered(self.parameters)
        for tick in range(SECONDS * 100):
            us, s, noise = 1_000_000 + 10_000 * tick, tick / 100, 1e-3 * (tick % 7)
            for number in range(2):
                if (rate := self.combined(number, s)) is not None:
                    log.row(number, us, rate + noise, 0, 0, 0, 0, -9.8)
                if tick % self.imu_steps == 0 and (rate := self.imu(number, s)) is not None:
                    angle, velocity = 0.01 * (rate + noise), 0.01 * -9.8
                    sums = (angle, 0, 0, 0, 0, velocity, 10_000, 10_000)
                    log.row(2 + number, us + 500, us, IDS[number], *sums)
                if tick % 20 == 0 and (fix := self.gps(number, s)) is not None:
                    self._fix(log, 5 + number, us, *fix)
                if tick % 10 == 0 and (field := self.mag(number, s)) is not None:
                    log.row(7 + number, us, IDS[number], *field)
                if tick % 10 == 0 and (height := self.baro(number, s)) is not None:
                    log.row(9 + number, us, IDS[number], height)
            if tick % 20 == 0 and (fix := self.position(0, s)) is not None:
                self._fix(log, 4, us, *fix)
            if tick % 100 == 0 and (selected := self.selected(s)) is not None:
                log.row(11, us, *(IDS[number] for number in selected))
        return log.data

    @staticmethod
    def _fix(log, index, us, fix_type, lat):
        log.row(index, us, us, lat, 8.5455, 489.0, 0, 0, 0, fix_type, 1, 1)


@pytest.fixture
def log():
    return Flight()


@pytest.fixture
def read(tmp_path):
    def write_and_read(log):
        path = tmp_path / "flight.ulg"
        path.write_bytes(log.write())
        return ulog.read(path)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


def seconds(events):
    return events.t_ns * 1e-9 - 1.0


def latitudes(fixes):
    return np.round(np.rad2deg(fixes.values[:, 0]), 4)


def noted(recording, start):
    return [note for note in recording.notes if note.startswith(start)]


def test_a_receiver_without_a_fix_gives_way_to_the_one_that_has_one(log, read):
    log.gps = lambda number, s: (3, SECOND_LAT) if number else (0, 0.0)
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    assert len(fixes) == 5 * SECONDS
    assert {*latitudes(fixes)} == {SECOND_LAT}
    assert {*fixes.values[:, GNSS_FLAGS]} == {GnssFlag.NONE}
    assert noted(recording, "GPS") == [
        "GPS: sensor_gps 1 is used: sensor_gps 0 has no new fix there"
    ]


@pytest.mark.parametrize("position", [True, False], ids=["chosen topic", "sensors alone"])
@pytest.mark.parametrize("ends", ["no rows", "no fix"])
def test_a_receiver_that_loses_its_fix_gives_way_to_the_other_from_there_on(
    log, read, position, ends
):
    lost = None if ends == "no rows" else (1, FIRST_LAT)

    def first(number, s):
        return (3, FIRST_LAT) if s < 8 else lost

    log.gps = lambda number, s: (3, SECOND_LAT) if number else first(number, s)
    if position:
        log.position = first
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    np.testing.assert_array_equal(
        latitudes(fixes), np.where(seconds(fixes) < 7.9, FIRST_LAT, SECOND_LAT)
    )
    # The first fix of the second receiver is after the last of the first
    assert seconds(fixes)[latitudes(fixes) == SECOND_LAT][0] == pytest.approx(8.0)
    is_second = latitudes(fixes) == SECOND_LAT
    np.testing.assert_array_equal(fixes.values[:, GNSS_FLAGS] == GnssFlag.SECOND, is_second)
    was = "vehicle_gps_position 0" if position else "sensor_gps 0"
    assert noted(recording, "GPS: ") == [
        f"GPS: sensor_gps 1 is used from 7.8 s on: {was} has no new fix there"
    ]


@pytest.mark.parametrize("position", [False, True])
@pytest.mark.parametrize("end", [8.0, 0.0, SECONDS])
def test_a_receiver_that_says_the_same_in_motion_is_left(log, read, monkeypatch, position, end):
    """Its stamps go on: the driver publishes what it has."""

    def first(number, s):
        return 3, FIRST_LAT + 1e-6 * min(s, end)

    def fix(log, index, us, fix_type, lat):
        log.row(index, us, us, lat, 8.5455, 489.0, 2.0, 0, 0, fix_type, 1, 1)

    monkeypatch.setattr(Flight, "_fix", staticmethod(fix))
    log.gps = lambda number, s: (3, SECOND_LAT + 1e-6 * s) if number else first(number, s)
    if position:
        log.position = first
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    is_second = np.rad2deg(fixes.values[:, 0]) > SECOND_LAT - 1e-9
    np.testing.assert_array_equal(is_second, seconds(fixes) > (end + 0.1 if end else -1.0))
    assert len(noted(recording, "GPS")) == (end < SECONDS)


def test_the_receiver_that_px4_has_chosen_is_used_as_long_as_it_has_fixes(log, read):
    log.position = lambda number, s: (3, SECOND_LAT)
    log.gps = lambda number, s: (3, (FIRST_LAT, SECOND_LAT)[number])
    recording = read(log)
    assert {*latitudes(of_kind(recording, Kind.GNSS))} == {SECOND_LAT}
    assert noted(recording, "GPS") == []


def test_of_two_receivers_alone_the_primary_one_of_the_parameters_comes_first(read):
    log = Flight(parameters=(("SENS_GPS_PRIME", 1.0),))
    log.gps = lambda number, s: (3, (FIRST_LAT, SECOND_LAT)[number])
    assert {*latitudes(of_kind(read(log), Kind.GNSS))} == {SECOND_LAT}


@pytest.mark.parametrize("other", ["combined", "imu"])
@pytest.mark.parametrize("fails", ["ends", "stuck", "not a number"])
def test_inertial_samples_that_fail_give_way_to_those_of_the_other_sensor(log, read, other, fails):
    def first(s):
        if s < 10:
            return 0.01
        stuck = 0.016 - 1e-3 * (round(s * 100) % 7)
        return {"ends": None, "stuck": stuck, "not a number": np.nan}[fails]

    def second(number, s):
        return 0.01 + BIAS if number == 1 else None

    log.combined = lambda number, s: first(s) if number == 0 else None
    if other == "imu":
        log.imu = second
    else:
        log.combined = lambda number, s: second(number, s) if number else first(s)
    recording = read(log)
    samples = of_kind(recording, Kind.IMU)
    assert len(samples) >= SECONDS * 100 - 1
    assert np.diff(samples.t_ns).max() <= 20_000_000
    rates = samples.values[:, 0]
    # The bias of the second is taken off: what was learnt of the first holds of it
    assert rates.min() == pytest.approx(0.01, abs=1e-3)
    assert rates.max() == pytest.approx(0.016, abs=1e-3)
    topic = "vehicle_imu 1" if other == "imu" else "sensor_combined 1"
    assert noted(recording, "IMU") == [
        f"IMU: {topic} is used from 10.0 s on: sensor_combined 0 has no good sample there"
    ]


def test_a_log_of_vehicle_imu_alone_has_the_samples_of_the_selected_sensor(log, read):
    log.combined = never
    log.imu = lambda number, s: 0.01 + BIAS * number
    log.selected = lambda s: (1, 0, 0)
    samples = of_kind(read(log), Kind.IMU)
    assert len(samples) == SECONDS * 100
    assert samples.values[0, :6] == pytest.approx([0.01 + BIAS, 0, 0, 0, 0, -9.8], rel=1e-6)
    assert samples.t_ns[0] == 1_000_000_000  # of the sample, not of its publication


def test_of_two_units_at_their_full_rate_one_that_is_stuck_is_left(log, read):
    def rate(number, s):
        stuck = number == 0 and s >= 10
        return 0.016 - 1e-3 * (round(s * 100) % 7) if stuck else 0.01 + BIAS * number

    log.combined = never
    log.imu = rate
    recording = read(log)
    samples = of_kind(recording, Kind.IMU)
    assert len(samples) >= SECONDS * 100 - 2
    assert samples.values[:, 0].max() == pytest.approx(0.016, abs=2e-3)
    (note,) = noted(recording, "IMU")
    assert note.startswith("IMU: vehicle_imu 1 is used from 10.")
    assert note.endswith("vehicle_imu 0 is stuck on an axis")


def test_thinned_rows_of_vehicle_imu_are_no_inertial_samples(log, read):
    log.combined = lambda number, s: 0.01 if number == 0 and s < 10 else None
    log.imu = lambda number, s: 0.01
    log.imu_steps = 20
    samples = of_kind(read(log), Kind.IMU)
    assert len(samples) == 1000


def test_compass_and_barometer_are_those_of_the_selected_filter(log, read):
    log.mag = lambda number, s: FIELDS[number]
    log.baro = lambda number, s: 5.0 + 2.0 * number
    log.selected = lambda s: (0, 0, 0) if s < 12 else (0, 1, 1)
    recording = read(log)
    fields, heights = of_kind(recording, Kind.MAG), of_kind(recording, Kind.BARO)
    assert len(fields) == len(heights) == SECONDS * 10
    # Both go on from the sensor before
    np.testing.assert_allclose(fields.values[:, :3], np.full((200, 3), FIELDS[0]), atol=1e-6)
    np.testing.assert_allclose(heights.values[:, 0], 5.0, atol=1e-6)
    np.testing.assert_array_equal(fields.values[:, 3], (seconds(fields) >= 12.0).astype(float))
    assert noted(recording, "magnetometer") == [
        "magnetometer: vehicle_magnetometer 1 is used from 12.0 s on: the autopilot uses it"
    ]


def test_a_compass_that_ends_gives_way_to_the_other(log, read):
    log.mag = lambda number, s: FIELDS[number] if number or s < 10 else None
    fields = of_kind(read(log), Kind.MAG)
    assert len(fields) == SECONDS * 10
