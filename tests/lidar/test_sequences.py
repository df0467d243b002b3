from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.lidar.readers import read
from tests.paths import DATA


@pytest.mark.parametrize("name", ["room_walk", "forest_flight"])
def test_a_sequence_is_read_as_its_readme_says(name):
    path = DATA / "lidar" / name
    if not path.is_dir():
        pytest.skip(f"{path} is not here")
    recording = read(path)
    arrays = np.load(path / "lidar.npz")
    scans = list(recording.scans)
    assert [scan.stamp for scan in scans] == list(arrays["stamp"])
    assert np.array_equal(
        np.concatenate([scan.points for scan in scans]), arrays["xyz"] * float(arrays["unit"])
    )
    assert np.array_equal(
        np.concatenate([scan.times for scan in scans]), arrays["dt"] * float(arrays["tick"])
    )
    assert len(list(recording.scans)) == len(scans)
