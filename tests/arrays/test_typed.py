"""That type checkers know what a user of a checkout calls."""

import os
import subprocess
import sys

import pytest

from tests.arrays.test_python_docs import blocks
from tests.daemon.waiting import LIMIT
from tests.paths import ROOT

ARRAYS = ("t", "gyro", "accel", "t_fix", "lat", "lon", "alt", "velocity", "t_mag", "field")
HEAD = """
import numpy as np
import numpy.typing as npt
from ekf_companion import FilterName, Fixes, Units
def given() -> npt.NDArray[np.float64]: return np.zeros(3)
""" + "".join(f"{name} = given()\n" for name in ARRAYS)


def checked(folder, text):
    """Return what mypy says of a user's file, in a folder where only its path names the package."""
    (folder / "user.py").write_text(text)
    # Of the package is read what is installed: no source of it is checked here
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "user.py"],
        cwd=folder,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=2 * LIMIT,
        check=False,
    )
    return [
        line for line in done.stdout.splitlines() if line.startswith("user.py") and "error" in line
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    pytest.importorskip("mypy")
    return tmp_path_factory.mktemp("user")


@pytest.mark.campaign
def test_readme_s_examples_are_typed(folder):
    shown = [block for block in blocks("README.md") if "ekf_companion" in block]
    assert len(shown) == 2
    assert checked(folder, HEAD + "".join(shown)) == []


@pytest.mark.campaign
def test_what_cannot_be_meant_is_found_before_it_runs(folder):
    text = HEAD + "\n".join(
        [
            "from ekf_companion import estimate, run_filter",
            'fixes: Fixes = {"time": t, "lat_deg": lat, "lon_deg": lon, "height": alt}',
            'estimate(t, gyro, accel, filter="eksf")',
            'estimate(t, gyro, accel, units={"gyro": "rpm"})',
            'good: Fixes = {"time": t, "lat_deg": lat, "lon_deg": lon, "alt": alt, "std_h": 1.0}',
            'found = estimate(t, gyro, accel, gnss=good, filter="ukf", units={"gyro": "deg/s"})',
            "reveal_type(found.pos_n)",
            "found.positions",
        ]
    )
    said = checked(folder, text)
    assert [("height" in said[0]), ("eksf" in said[1] or "filter" in said[1])] == [True, True]
    assert len(said) == 4, said
