"""Four inertial units on one quadrotor: samples of docs/accuracy/outages.md."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.accuracy import four_imus
from benchmarks.accuracy.four_imus import FLIGHTS, FOLDER, Track, Unit, mounting
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.nav import so3
from tests.paths import DATA

pytestmark = pytest.mark.campaign

needs_data = pytest.mark.skipif(
    not (DATA / FOLDER).is_dir(), reason="the recorded flights are not here"
)


def test_a_mounting_and_an_offset_are_found_from_the_rates():
    t = np.arange(0.0, 30.0, 0.1)
    fine_t = np.arange(-1.0, 31.0, 0.01)

    def euler(t):
        return np.column_stack(
            [0.4 * np.sin(2.0 * t), 0.3 * np.sin(1.3 * t), 0.2 * np.sin(0.7 * t)]
        )

    q_nb = so3.from_euler(*euler(fine_t).T)
    rate_b = so3.log(so3.multiply(so3.conjugate(q_nb[:-1]), q_nb[1:])) / 0.01
    C_bu = Rotation.from_euler("ZYX", [70.0, -20.0, 170.0], degrees=True).as_matrix()
    gyro = rate_b @ C_bu + [0.01, -0.03, 0.02]
    unit = Unit(fine_t[:-1] + 0.005 + 0.3, np.zeros_like(gyro), gyro)
    found = mounting(Track(t, np.zeros((len(t), 3)), euler(t)), unit)
    assert found.offset == pytest.approx(0.3, abs=0.011)
    np.testing.assert_allclose(found.C_bu, C_bu, atol=0.01)


@needs_data
def test_a_unit_is_mounted_alike_in_all_flights():
    found = [
        mounting(
            Track.read(DATA / FOLDER / name / "GT.csv"),
            Unit.read(DATA / FOLDER / name / "IMU_2.csv"),
        )
        for name in FLIGHTS
    ]
    for one in found[1:]:
        turn = Rotation.from_matrix(found[0].C_bu.T @ one.C_bu)
        assert np.degrees(turn.magnitude()) < 1.0


@needs_data
def test_the_drift_of_an_outage_is_covered(monkeypatch):
    monkeypatch.setattr(four_imus, "STEP", 6.0)
    found = four_imus.cases(DATA / FOLDER / FLIGHTS[0], 1, FilterSettings(), seed=0)
    for case in found[10.0]:
        _, _, *is_covered = case.drift
        assert all(is_covered)
        assert case.drift[0] < 60.0
