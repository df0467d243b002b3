"""Which of several sensors, receivers and lanes of a DataFlash log is used, and when."""

import numpy as np
import pytest

from ekf_companion.logs import dataflash
from ekf_companion.nav.measurements import GNSS_FLAGS, GnssFlag, Kind
from tests.logs.test_dataflash import Writer

SECONDS = 20
OUR_LAT, OTHER_LAT = -353632610, -353640000
BIAS = 0.05


class Flight:
    """Writes a standing vehicle with two of each sensor; the test says what they hold."""

    def __init__(self):
        self.parameters = {}
        self.imu = lambda number, s: (0.01 + BIAS * number, 1, 1)
        """Rate about x, gyro and accelerometer healthy; None: no row."""
        self.gps = lambda number, s: (3, (OUR_LAT, OTHER_LAT)[number], int(number == 0))
        """Status, latitude and whether it is used."""
        self.mag = lambda number, s: ((200, 0, 400), (190, 10, 410))[number]
        self.baro = lambda number, s: 5.0 + 2.0 * number
        self.lane = lambda s: None
        self.fuses = lambda lane, s: None
        """Compass and barometer that a lane fuses."""

    def write(self):
        log = Writer()
        log.define(1, "IMU", "QBffffffBB", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,GH,AH")
        log.define(2, "GPS", "QBBIcLLefffB", "TimeUS,I,Status,GMS,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U")
        log.define(3, "MAG", "QBhhhB", "TimeUS,I,MagX,MagY,MagZ,Health")
        log.define(4, "BARO", "QBffB", "TimeUS,I,Alt,Press,H")
        log.define(5, "XKF4", "QBb", "TimeUS,C,PI")
        log.define(6, "XKFS", "QBBB", "TimeUS,C,MI,BI")
        log.define(7, "XKF1", "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
        log.define(8, "PARM", "QNf", "TimeUS,Name,Value")
        for name, value in self.parameters.items():
            log.row("PARM", 0, name, value)
        for tick in range(SECONDS * 100):
            us, s = 1_000_000 + 10_000 * tick, tick / 100
            noise = 1e-3 * (tick % 7)
            for number in range(2):
                self._rows(log, number, tick, us, s, noise)
            if tick % 10 == 0 and (primary := self.lane(s)) is not None:
                for lane in range(2):
                    log.row("XKF1", us, lane, 0, 0, 9000 * lane, 0, 0, 0, lane, 0, 0)
                    log.row("XKF4", us, lane, primary)
                    if (fuses := self.fuses(lane, s)) is not None:
                        log.row("XKFS", us, lane, *fuses)
        return log.data

    def _rows(self, log, number, tick, us, s, noise):
        if (imu := self.imu(number, s)) is not None:
            log.row("IMU", us, number, imu[0] + noise, 0, 0, 0, 0, -9.8, *imu[1:])
        if tick % 20 == 0 and (gps := self.gps(number, s)) is not None:
            status, lat, used = gps
            rest = (150, lat, 1491652300, 58400, 0.0, 0.0, 0.0, used)
            log.row("GPS", us, number, status, us // 1000, *rest)
        if tick % 10 == 0:
            log.row("MAG", us, number, *self.mag(number, s), 1)
            log.row("BARO", us, number, self.baro(number, s), 1e5, 1)


@pytest.fixture
def log():
    return Flight()


@pytest.fixture
def read(tmp_path):
    def write_and_read(log):
        path = tmp_path / "flight.bin"
        path.write_bytes(log.write() if isinstance(log, Flight) else log)
        return dataflash.read(path)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


def latitudes(fixes):
    return np.round(np.rad2deg(fixes.values[:, 0]) * 1e7).astype(int)


def seconds(events):
    return events.t_ns * 1e-9 - 1.0


def noted(recording, start):
    return [note for note in recording.notes if note.startswith(start)]


def test_the_receiver_is_read_that_the_autopilot_uses(log, read):
    log.gps = lambda number, s: (3, (OUR_LAT, OTHER_LAT)[number], int(number == 1))
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    assert len(fixes) == 5 * SECONDS
    assert {*latitudes(fixes)} == {OTHER_LAT}
    # It is the only one: nothing stands by for it
    assert {*fixes.values[:, GNSS_FLAGS]} == {GnssFlag.NONE}
    assert "GPS: instance 1 is used as by the autopilot; the log also holds 0" in recording.notes


def test_a_change_of_the_receiver_in_use_is_followed_row_by_row_and_named(log, read):
    log.gps = lambda number, s: (3, (OUR_LAT, OTHER_LAT)[number], int(number == (8 <= s < 14)))
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    second = (seconds(fixes) >= 8.0) & (seconds(fixes) < 14.0)
    np.testing.assert_array_equal(latitudes(fixes), np.where(second, OTHER_LAT, OUR_LAT))
    np.testing.assert_array_equal(fixes.values[:, GNSS_FLAGS] == GnssFlag.SECOND, second)
    assert noted(recording, "GPS") == [
        "GPS: instance 1 is used from 8.0 s on: the autopilot uses it",
        "GPS: instance 0 is used from 14.0 s on: the autopilot uses it",
    ]


@pytest.mark.parametrize("u", [0, None], ids=["no receiver in use", "the lost one in use"])
def test_a_receiver_that_loses_its_fix_gives_way_to_one_that_has_one(log, read, u):
    def gps(number, s):
        status = 1 if number == 0 and s >= 8 else 3
        return status, (OUR_LAT, OTHER_LAT)[number], int(number == 0) if u is None else u

    log.gps = gps
    recording = read(log)
    fixes = of_kind(recording, Kind.GNSS)
    np.testing.assert_array_equal(
        latitudes(fixes), np.where(seconds(fixes) < 8, OUR_LAT, OTHER_LAT)
    )
    assert noted(recording, "GPS: inst") == [
        "GPS: instance 1 is used from 7.8 s on: instance 0 has no new fix there"
    ]


def test_a_fix_that_is_repeated_is_no_fix_of_a_good_receiver(log, read):
    data = Flight()
    data.gps = lambda number, s: (3, (OUR_LAT, OTHER_LAT)[number], 0)
    frozen = Writer.row

    class Frozen(Writer):
        def row(self, name, *values):
            if name == "GPS" and values[1] == 0 and values[0] > 9_000_000:
                values = (*values[:3], 8_000, *values[4:])  # its time stands still
            frozen(self, name, *values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(f"{__name__}.Writer", Frozen)
        recording = read(data.write())
    fixes = of_kind(recording, Kind.GNSS)
    assert {*latitudes(fixes)[seconds(fixes) > 8.3]} == {OTHER_LAT}


@pytest.mark.parametrize("speed", [5.0, 0.0])
@pytest.mark.parametrize("columns", ["I,GMS", "I", "GMS", ""])
def test_a_receiver_that_says_the_same_in_motion_is_frozen(read, columns, speed):
    """Whatever tells the time of its fixes. At rest, without one, it may be right."""
    log, is_numbered, is_timed = Writer(), "I" in columns, "GMS" in columns
    log.define(1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    form = "Q" + "B" * is_numbered + "B" + "I" * is_timed + "LLefff"
    names = ["TimeUS", *["I"] * is_numbered, "Status", *["GMS"] * is_timed]
    names += ["Lat", "Lng", "Alt", "Spd", "GCrs", "VZ"]
    for number, name in enumerate(["GPS"] if is_numbered else ["GPS", "GPS2"]):
        log.define(2 + number, name, form, ",".join(names))
    for tick in range(SECONDS * 50):
        us, s = 1_000_000 + 20_000 * tick, tick / 50
        log.row("IMU", us, 0.01, 1e-3 * (tick % 7), 0, 0, 0, -9.8)
        for number, t in enumerate([min(s, 8.0), s] if tick % 10 == 0 else []):
            place = ((OUR_LAT, OTHER_LAT)[number] + round(10 * t), 1491652300, 58400)
            head = (*[number] * is_numbered, 3, *[round(1000 * t) + 1] * is_timed)
            log.row("GPS2" if number and not is_numbered else "GPS", us, *head, *place, speed, 0, 0)
    fixes = of_kind(recording := read(log.data), Kind.GNSS)
    is_other = latitudes(fixes) < OUR_LAT - 1000
    is_found = speed > 0.0 or is_timed
    np.testing.assert_array_equal(is_other, (seconds(fixes) > 8.1) & is_found)
    assert len(noted(recording, "GPS: ")) <= 1
    assert any("has no new fix there" in note for note in recording.notes) == is_found


def test_a_receiver_is_not_left_for_a_second_without_a_fix(log, read):
    def gps(number, s):
        status = 1 if number == 0 and 8 <= s < 9 else 3
        return status, (OUR_LAT, OTHER_LAT)[number], 0

    log.gps = gps
    assert {*latitudes(of_kind(read(log), Kind.GNSS))} == {OUR_LAT}


@pytest.mark.parametrize(
    ("first", "why"),
    [
        (lambda s: (0.01, 1, 1) if s < 10 else None, "silent"),
        (lambda s: (0.01, int(s < 10), 1), "unhealthy by the autopilot's own word"),
        (lambda s: (0.01, 1, int(s < 10)), "unhealthy by the autopilot's own word"),
        (
            lambda s: (0.01, 1, 1) if s < 10 else (0.016 - 1e-3 * (round(s * 100) % 7), 1, 1),
            "stuck on an axis",
        ),
        (lambda s: (0.01, 1, 1) if s < 10 else (np.nan, 1, 1), "not a number"),
    ],
    ids=["ends", "gyro unhealthy", "accelerometer unhealthy", "stuck", "not a number"],
)
def test_an_inertial_sensor_that_fails_gives_way_to_the_other_whose_bias_is_taken_off(
    log, read, first, why
):
    log.imu = lambda number, s: (0.01 + BIAS, 1, 1) if number else first(s)
    recording = read(log)
    samples = of_kind(recording, Kind.IMU)
    assert len(samples) >= SECONDS * 100 - 1
    assert np.diff(samples.t_ns).max() <= 20_000_000
    rates = samples.values[:, 0]
    assert rates.min() == pytest.approx(0.01, abs=1e-3)
    assert rates.max() == pytest.approx(0.016, abs=1e-3)
    (note,) = noted(recording, "IMU")
    begin, _, rest = note.partition(" s on: ")
    assert 10.0 <= float(begin.removeprefix("IMU: instance 1 is used from ")) <= 10.2
    assert rest == f"instance 0 is {why}"


def test_a_unit_that_stands_by_and_fails_is_named_and_not_gone_to(log, read):
    stuck = lambda s: 0.016 - 1e-3 * (round(s * 100) % 7) if s >= 10 else 0.01  # noqa: E731
    log.imu = lambda number, s: (stuck(s) + BIAS if number else 0.01, 1, 1)
    samples = of_kind(read(log), Kind.IMU)
    assert len(samples) == SECONDS * 100
    assert samples.values[:, 0].max() < 0.02
    (fault,) = [note for note in read(log).notes if "stands by" in note]
    assert fault.startswith("IMU: instance 1, which stands by, is stuck on an axis at 10.")


def test_a_unit_that_steps_is_left_and_what_it_did_goes_with_the_next_sample(log, read):
    log.imu = lambda number, s: (0.01 + BIAS * number + 0.3 * (number == 0 and s >= 10), 1, 1)
    recording = read(log)
    samples = of_kind(recording, Kind.IMU)
    (note,) = noted(recording, "IMU")
    assert note.endswith("instance 0 is off from the others by a step")
    late = seconds(samples) > 10.2
    assert samples.values[late, 0].max() == pytest.approx(0.016, abs=2e-3)
    (first,) = np.flatnonzero(samples.values[:, 6:].any(axis=1))
    assert samples.values[first, 8] == pytest.approx(0.3 * 0.1, abs=0.3 * 0.05)  # turned
    assert len(samples) >= SECONDS * 100 - 2


def test_the_inertial_sensor_is_that_of_the_primary_lane(log, read):
    log.lane = lambda s: int(s >= 12)
    recording = read(log)
    rates = of_kind(recording, Kind.IMU)
    assert len(rates) == SECONDS * 100
    assert noted(recording, "IMU") == [
        "IMU: instance 1 is used from 12.0 s on: the autopilot uses it"
    ]
    # The estimate that is compared is the primary lane's, too
    assert noted(recording, "XKF1: instance 1") == ["XKF1: instance 1 is primary from 12.0 s on"]
    assert recording.reference is not None


@pytest.mark.parametrize(("mask", "number"), [(1.0, 0), (2.0, 1), (3.0, 0)])
def test_the_sensor_of_a_lane_follows_from_the_mask_of_those_that_have_one(log, read, mask, number):
    log.parameters = {b"EK3_IMU_MASK": mask}
    log.lane = lambda s: 0
    samples = of_kind(read(log), Kind.IMU)
    assert samples.values[0, 0] == pytest.approx(0.01 + BIAS * number, abs=1e-6)


def test_before_a_lane_is_chosen_there_is_none(log, read):
    log.parameters = {b"EK3_IMU_MASK": 2.0}
    log.lane = lambda s: -3 if s < 3 else -1 if s < 6 else 0
    recording = read(log)
    assert recording.notes[0] == "IMU: instance 1 is used as by the autopilot; the log also holds 0"


def test_compass_and_barometer_are_those_of_the_primary_lane_and_go_on_from_those_before(log, read):
    log.lane = lambda s: int(s >= 12)
    log.fuses = lambda lane, s: (lane, lane)
    recording = read(log)
    fields, heights = of_kind(recording, Kind.MAG), of_kind(recording, Kind.BARO)
    assert len(fields) == len(heights) == SECONDS * 10
    np.testing.assert_allclose(fields.values[:, :3], np.full((200, 3), [0.2, 0.0, 0.4]), atol=1e-9)
    np.testing.assert_allclose(heights.values[:, 0], 5.0, atol=1e-6)
    # What was learnt of one compass is not taken to be true of the other
    np.testing.assert_array_equal(fields.values[:, 3] != 0.0, seconds(fields) >= 12.0)
    assert noted(recording, "MAG") == [
        "MAG: instance 1 is used from 12.0 s on: the autopilot uses it"
    ]


def old_log(gps, gps2, imu2_alone=False):
    """Write a log of the old layout: sensors told apart by name."""
    log = Writer()
    imu = "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    log.define(1, "IMU", "Iffffff", imu)
    log.define(2, "IMU2", "Iffffff", imu)
    columns = "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"
    log.define(3, "GPS", "BIHBcLLeeEefI", columns)
    log.define(4, "GPS2", "BIHBcLLeeEefI", columns)
    for tick in range(SECONDS * 50):
        ms, s = 1000 + 20 * tick, tick / 50
        if not imu2_alone:
            log.row("IMU", ms, 0.01, 1e-3 * (tick % 7), 0, 0, 0, -9.8)
        log.row("IMU2", ms, 0.06, 1e-3 * (tick % 7), 0, 0, 0, -9.8)
        if tick % 10 == 0:
            for name, status, lat in (("GPS", gps(s), OUR_LAT), ("GPS2", gps2(s), OTHER_LAT)):
                row = (300_000_000 + ms, 1800, 9, 150, lat, 1491652300, 0, 58400, 0, 0, 0, ms)
                log.row(name, status, *row)
    return log.data


def test_the_second_receiver_of_an_old_log_is_used_where_the_first_has_no_fix(read):
    recording = read(old_log(lambda s: 3 if s < 6 else 1, lambda s: 3))
    fixes = of_kind(recording, Kind.GNSS)
    np.testing.assert_array_equal(
        latitudes(fixes), np.where(seconds(fixes) < 6, OUR_LAT, OTHER_LAT)
    )
    assert noted(recording, "GPS: ") == [
        "GPS: GPS2 is used from 5.8 s on: GPS has no new fix there"
    ]
    recording = read(old_log(lambda s: 1, lambda s: 3))
    assert {*latitudes(of_kind(recording, Kind.GNSS))} == {OTHER_LAT}
    assert noted(recording, "GPS: ") == [
        "GPS: GPS2 is used, as GPS has no new fix there; the log also holds GPS"
    ]


def test_the_only_inertial_sensor_of_a_log_is_used_whatever_its_name(read):
    recording = read(old_log(lambda s: 3, lambda s: 3, imu2_alone=True))
    assert len(of_kind(recording, Kind.IMU)) == SECONDS * 50
    assert "IMU: IMU2 is used: the log holds no other" in recording.notes
