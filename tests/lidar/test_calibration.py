"""Mounting and delay by passes over the first turns: how often the recording is read for them."""

from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.lidar import calibration
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.settings import Settings
from sim_autopilot.lidar.write import write_sequence
from tests.lidar.recordings import small


class Counted:
    """Scans that count how often they are read from their beginning."""

    def __init__(self, scans):
        self.scans, self.times = scans, 0

    def __iter__(self):
        self.times += 1
        return iter(self.scans)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration") / "room"
    write_sequence(folder, small())
    return read(folder)


def test_the_passes_read_a_recording_once_unless_it_is_too_large(recording, monkeypatch):
    found, times = [], []
    for most in (calibration.MOST_KEPT, 1000):
        monkeypatch.setattr(calibration, "MOST_KEPT", most)
        scans = Counted(recording.scans)
        settings = Settings(delay_sigma=0.02)
        found.append(calibration.calibrate(replace(recording, scans=scans), settings))
        times.append(scans.times)
    assert times[0] == 1
    assert times[1] > 1
    assert found[0].delay == found[1].delay
    np.testing.assert_array_equal(found[0].P, found[1].P)
