"""Foreign headers that need no map."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ekf_companion.errors import LogError
from ekf_companion.logs import csv, csv_known
from ekf_companion.logs.estimate import read_truth
from ekf_companion.nav import so3
from ekf_companion.nav.earth import SIMULATED, gravity
from ekf_companion.nav.measurements import HeadingSource, Kind

Flight = Callable[[str], Path]
SENSORS = (
    "time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2,mag_x,mag_y,"
    "mag_z,mag2D_yaw_deg,gps_valid,gps_north_m,gps_east_m,gps_h_msl_m,gps_vn_mps,gps_ve_mps,"
    "gps_vd_mps\n"
    "0,0.01,0.02,0.03,0.1,0.2,-9.8,1,0,0,-90,1,12.5,-40,110,3,4,-1\n"
    "0.1,0.01,0.02,0.03,0.1,0.2,-9.8,1,0,0,190,0,NaN,NaN,NaN,NaN,NaN,NaN\n"
)


def test_the_seeds_sensors_are_read_without_a_map(tmp_path: Path):
    path = tmp_path / "uavSensors.csv"
    path.write_text(SENSORS)
    recording = csv.read(path)
    events = recording.events
    counts = [int((events.kind == kind).sum()) for kind in (Kind.IMU, Kind.GNSS, Kind.MAG)]
    assert counts == [2, 1, 0]
    fix = events.values[events.kind == Kind.GNSS][0]
    np.testing.assert_allclose(SIMULATED.to_ned(*fix[:3]), [12.5, -40.0, -110.0], atol=1e-8)
    np.testing.assert_allclose(fix[3:9], [3.0, 4.0, -1.0, 1.0, 1.0, 0.05])
    headings = events.values[events.kind == Kind.HEADING][:, :3]
    expected = [
        [-np.pi / 2.0, 0.02, HeadingSource.MAGNETOMETER],
        [np.radians(-170.0), 0.02, HeadingSource.MAGNETOMETER],
    ]
    np.testing.assert_allclose(headings, expected)
    assert any("the seed article" in note for note in recording.notes)
    assert recording.zero_height == SIMULATED.alt
    assert any("height of zero is put at 5895.2 m" in note for note in recording.notes)


def test_a_place_of_ones_own_has_heights_above_the_sea(tmp_path: Path):
    path = tmp_path / "uavSensors.csv"
    path.write_text(SENSORS)
    origin = "origin: {lat_deg: 47.4, lon_deg: 8.5, alt_m: 400.0}\n"
    (tmp_path / "uavSensors.csv.columns.yaml").write_text(origin)
    recording = csv.read(path)
    assert recording.zero_height == 0.0
    assert recording.events.values[recording.events.kind == Kind.GNSS][0][2] == 510.0


def test_a_map_beside_the_file_goes_before(tmp_path: Path):
    path = tmp_path / "uavSensors.csv"
    path.write_text(SENSORS)
    (tmp_path / "uavSensors.csv.columns.yaml").write_text(
        "time: {column: time_s, unit: s}\nheading: {column: mag2D_yaw_deg, unit: deg}\n"
    )
    assert set(csv.read(path).events.kind.tolist()) == {int(Kind.HEADING)}


def test_an_option_beside_the_file_beats_that_of_the_known_header(tmp_path: Path):
    path = tmp_path / "uavSensors.csv"
    path.write_text(SENSORS)
    (tmp_path / "uavSensors.csv.columns.yaml").write_text("heading_source: autopilot\n")
    events = csv.read(path).events
    assert set(events.values[events.kind == Kind.HEADING][:, 2]) == {HeadingSource.AUTOPILOT}


def test_a_stranger_is_not_taken_for_a_known_header():
    assert csv_known.find(["time_s", "gyro_x_rps"]) is None


def test_gravity_where_the_simulation_is_put_is_the_simulations():
    assert float(gravity(SIMULATED.lat, SIMULATED.alt + 160.0)) == pytest.approx(9.81, abs=1e-12)


@pytest.mark.parametrize(("unit", "roll"), [("deg", 30.0), ("rad", np.radians(30.0))])
def test_a_simulations_truth_is_read_in_degrees_and_in_radians(
    tmp_path: Path, unit: str, roll: float
):
    path = tmp_path / "uavTruth.csv"
    angles = ",".join(f"{name}_{unit}" for name in ("roll", "pitch", "yaw"))
    path.write_text(
        f"time_s,{angles},north_m,east_m,h_msl_m,vn_mps,ve_mps,vd_mps\n"
        f"0,0,0,0,0,0,110,3,4,-1\n0.1,{roll},0,0,100,-200,111,3,4,-1\n"
    )
    truth = read_truth(path)
    assert truth.pos_t_ns.tolist() == [0, 100_000_000]
    pos_n = SIMULATED.to_ned(truth.lat, truth.lon, truth.alt)
    np.testing.assert_allclose(pos_n, [[0.0, 0.0, -110.0], [100.0, -200.0, -111.0]], atol=1e-8)
    np.testing.assert_allclose(so3.to_euler(truth.q_nb)[:, 0], [0.0, np.pi / 6.0], atol=1e-12)
    np.testing.assert_allclose(truth.vel_n[1], [3.0, 4.0, -1.0])


@pytest.mark.parametrize(("unit", "roll"), [("deg", 30.0), ("rad", np.radians(30.0))])
def test_a_truth_may_have_roll_pitch_and_yaw(tmp_path: Path, unit: str, roll: float):
    path = tmp_path / "truth.csv"
    angles = ",".join(f"{name}_{unit}" for name in ("roll", "pitch", "yaw"))
    path.write_text(
        f"time_us,lat_deg,lon_deg,alt_m,vn_mps,ve_mps,vd_mps,{angles}\n"
        f"0,47,8,500,3,4,-1,0,0,0\n100000,47,8,500,3,4,-1,{roll},0,0\n"
    )
    truth = read_truth(path)
    np.testing.assert_allclose(so3.to_euler(truth.q_nb)[:, 0], [0.0, np.pi / 6.0], atol=1e-12)
    np.testing.assert_allclose(truth.vel_n[1], [3.0, 4.0, -1.0])
    path.write_text(path.read_text().replace("yaw", "course"))
    with pytest.raises(LogError, match="q_w"):
        read_truth(path)


def test_the_seeds_flight_is_read_whole(flight: Flight):
    recording = csv.read(flight("seed-basicekf-sim/uavSensors.csv"))
    kinds = recording.events.kind
    counts = [int((kinds == kind).sum()) for kind in (Kind.IMU, Kind.GNSS, Kind.HEADING)]
    assert counts == [4001, 401, 4001]
    truth = read_truth(flight("seed-basicekf-sim/uavTruth.csv"))
    estimate = read_truth(flight("seed-basicekf-sim/uavEst.csv"))
    apart = SIMULATED.to_ned(truth.lat, truth.lon, truth.alt) - SIMULATED.to_ned(
        estimate.lat, estimate.lon, estimate.alt
    )
    # As the README of the flight says
    np.testing.assert_allclose(
        np.sqrt(np.mean(np.square(apart), axis=0)), [0.654, 0.531, 0.194], atol=1e-3
    )
