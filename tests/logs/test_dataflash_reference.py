"""The autopilot's own estimate in a DataFlash log: which it flew on, and about which origin."""

import numpy as np
import pytest

from ekf_companion.logs import dataflash
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.interpolation import resample
from ekf_companion.nav.state import Trajectory
from tests.logs.test_dataflash import Writer

START = LocalFrame(np.deg2rad(-35.2), np.deg2rad(149.0), 580.0)
LAYOUTS = (
    ("IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    ("GPS", "BIHcLLeEefI", "Status,TimeMS,Week,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,T"),
    ("ATT", "Iccc", "TimeMS,Roll,Pitch,Yaw"),
    ("AHR2", "IccceLL", "TimeMS,Roll,Pitch,Yaw,Alt,Lat,Lng"),
    ("POS", "ILLe", "TimeMS,Lat,Lng,Alt"),
    ("PARM", "Nf", "Name,Value"),
    ("ORGN", "IBLLe", "TimeMS,Type,Lat,Lng,Alt"),
    *(
        (name, "IccCffffff", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
        for name in ("EKF1", "NKF1", "XKF1")
    ),
)


def degrees(north, east, down=0.0):
    """Return latitude and longitude as in a log, 1e-7 deg, and the height, cm."""
    lat, lon, alt = START.to_geodetic(np.array([[north, east, down]], dtype=float))
    return *(round(float(np.rad2deg(one[0])) * 1e7) for one in (lat, lon)), round(alt[0] * 100)


class Log(Writer):
    """Writes rows of a vehicle at 10 Hz, and the filter's about an origin of its own."""

    def __init__(self, **parameters):
        super().__init__()
        for number, layout in enumerate(LAYOUTS, start=1):
            self.define(number, *layout)
        for name, value in parameters.items():
            self.row("PARM", name.encode(), value)

    def fly(self, first_s, path, *, origin=(0.0, 0.0), by="EKF1", yaw=0.0, also=()):
        """Fly along places north and east, m, ten a second; ``also`` are POS and AHR2."""
        path = np.asarray(path, dtype=float)
        speed = np.gradient(path, 0.1, axis=0)
        for index, (place, vel) in enumerate(zip(path, speed, strict=True)):
            ms = round(first_s * 1000) + 100 * index
            angles = (0, 0, round(yaw * 100))
            self.row("IMU", ms, 0, 0, 0, 0, 0, -9.8)
            self.row("ATT", ms, 0, 0, 4500)
            self.row(by, ms, *angles, *vel, 0, *(place - origin), 0)
            lat, lon, alt = degrees(*place)
            if "POS" in also:
                self.row("POS", ms, lat, lon, alt)
            if "AHR2" in also:
                self.row("AHR2", ms, 0, 0, 0, alt, lat, lon)
            if index % 2 == 0:
                self.row("GPS", 3, ms, 1871, 100, lat, lon, alt, 0, 0, 0, ms)


def straight(begin, speed, seconds):
    """Return a straight way north from a place, ten a second."""
    t = np.arange(0.0, seconds, 0.1)
    return np.stack([begin[0] + speed * t, begin[1] + 0.0 * t], axis=1)


@pytest.fixture
def read(tmp_path):
    def write_and_read(log):
        path = tmp_path / "flight.bin"
        path.write_bytes(log.data)
        return dataflash.read(path)

    return write_and_read


def apart(reference: Trajectory, first_s, path):
    """Return the distances of a reference from places that it was flown along, m."""
    t_ns = np.rint((first_s + 0.1 * np.arange(len(path))) * 1e9).astype(np.int64)
    inside = (t_ns >= reference.pos_t_ns[0]) & (t_ns <= reference.pos_t_ns[-1])
    ned = START.to_ned(reference.lat, reference.lon, reference.alt)
    found = resample(t_ns[inside], reference.pos_t_ns, ned)[:, :2]
    return np.linalg.norm(found - np.asarray(path)[inside], axis=1)


def test_each_arming_has_an_origin_of_its_own_whether_the_log_runs_on_or_was_stopped(read):
    ways = [(0.0, straight((0, 0), 5, 20)), (20.0, straight((100, 12), 4, 20))]
    ways.append((140.0, straight((95, 30), 2, 20)))  # the log was stopped for 100 s
    log = Log()
    for first_s, path in ways:
        log.fly(first_s, path, origin=path[0])
    recording = read(log)
    for first_s, path in ways:
        assert apart(recording.reference, first_s, path).max() < 0.3
    assert any("took 2 new origins" in note for note in recording.notes)


def test_a_reset_of_the_estimate_and_a_pass_over_the_origin_are_no_new_origins(read):
    there_and_back = np.concatenate([straight((0, 0), 10, 20), straight((200, 0), -10, 20)])
    beyond = straight((0, 0), -10, 20)
    log = Log()
    log.fly(0.0, np.concatenate([there_and_back, beyond]))
    # the filter leaps by 9 m, 200 m from its origin: that is an error of it, and to be seen
    off = straight((-200, 0), -5, 4)
    log.fly(60.0, off, origin=(0.0, 9.0))
    recording = read(log)
    assert any("origin of the autopilot's filter is not in the log" in n for n in recording.notes)
    assert apart(recording.reference, 0.0, there_and_back).max() < 0.3
    assert apart(recording.reference, 60.0, off).min() > 8.0


def test_an_origin_that_too_few_fixes_show_gives_no_position(read):
    log = Log()
    log.fly(0.0, straight((0, 0), 5, 20))
    log.fly(20.0, straight((100, 40), 3, 1), origin=(100.0, 40.0))
    log.fly(21.0, straight((100, 60), 5, 20), origin=(100.0, 60.0))
    reference = read(log).reference
    stamps = reference.pos_t_ns * 1e-9
    assert not ((stamps >= 20.0) & (stamps < 20.95)).any()
    assert apart(reference, 21.0, straight((100, 60), 5, 20)).max() < 0.3


@pytest.mark.parametrize("also", [("AHR2",), ()])
def test_a_vehicle_that_flew_on_dcm_is_compared_with_that(read, also):
    log, path = Log(AHRS_EKF_USE=0.0), straight((0, 0), 5, 20)
    log.fly(0.0, path, origin=path[0], yaw=90.0, also=also)
    recording = read(log)
    own = recording.reference
    assert own.name.startswith("DCM (ATT), for AHRS_EKF_USE is 0")
    assert ("(AHR2)" if also else "(origin)") in own.name
    assert 2.0 * np.degrees(np.arctan2(own.q_nb[5, 3], own.q_nb[5, 0])) == pytest.approx(45.0)
    assert apart(own, 0.0, path).max() < 0.3
    assert np.allclose(own.vel_n[5], [5.0, 0.0, 0.0])
    assert any("EKF1 only looked on" in note for note in recording.notes)
    # the position is then as the filter says, and nothing is fitted that AHR2 has
    assert any("fitted" in note for note in recording.notes) is not bool(also)


def test_where_the_filter_flew_ahr2_is_the_other_estimate_and_not_used(read):
    log, path = Log(AHRS_EKF_USE=1.0), straight((0, 0), 5, 20)
    log.fly(0.0, path, yaw=90.0, also=("AHR2",))
    own = read(log).reference
    assert own.name == "EKF1 (EKF1, position from origin)"
    assert 2.0 * np.degrees(np.arctan2(own.q_nb[5, 3], own.q_nb[5, 0])) == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("used", "name"),
    [
        (3.0, "EKF3 (XKF1, position from POS)"),
        (2.0, "EKF2 (NKF1, position from POS)"),
        (10.0, "EKF3 (XKF1, position from POS)"),
        (0.0, "DCM (ATT), for AHRS_EKF_TYPE is 0"),
    ],
)
def test_of_two_generations_that_run_the_one_in_use_is_compared_with(read, used, name):
    log, path = Log(AHRS_EKF_TYPE=used), straight((0, 0), 5, 20)
    log.fly(0.0, path, by="XKF1", also=("POS",))
    log.fly(0.0, path, by="NKF1")
    assert read(log).reference.name == name


def test_an_origin_in_the_log_holds_until_the_next(read):
    log = Log()
    ways = [(1.0, straight((0, 0), 5, 20)), (21.0, straight((100, 0), 5, 20))]
    for first_s, path in ways:
        lat, lon, alt = degrees(*path[0])
        log.row("ORGN", round(first_s * 1000), 0, lat, lon, alt)
        log.row("ORGN", round(first_s * 1000), 1, lat + 900_000, lon, alt)  # home
        log.fly(first_s, path, origin=path[0], by="NKF1")
    recording = read(log)
    for first_s, path in ways:
        assert apart(recording.reference, first_s, path).max() < 0.3
    assert not any("fitted" in note for note in recording.notes)
