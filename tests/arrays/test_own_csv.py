"""A user's own table: README's example converts, and what contradicts itself in it is noted."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.logs.csv import read
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.filters_by_name import run_filter
from tests.arrays.test_run import Flown
from tests.paths import ROOT

SENSORS = (("gyro", "dps"), ("accel", "mps2"))


def example():
    """Return the lines of README's table."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```text\n(time_s.*?)```", text, flags=re.DOTALL)
    return block.strip().split("\n")


@pytest.fixture(scope="module")
def flown():
    return Flown()


def write(path, flown, **sizes):
    """Write a flight under README's header; columns may be multiplied."""
    names = example()[0].split(",")
    cells = {name: np.full(len(flown.time), np.nan) for name in names}
    cells["time_s"] = flown.time
    fix, field = (
        np.searchsorted(flown.time, table["time"] - 1e-6) for table in (flown.gnss, flown.mag)
    )
    for axis, name in enumerate("xyz"):
        cells[f"gyro_{name}_dps"] = np.rad2deg(flown.gyro[:, axis])
        cells[f"accel_{name}_mps2"] = flown.accel[:, axis]
        cells[f"mag_{name}_uT"][field] = flown.mag["field"][:, axis] * 100.0
    for axis, name in enumerate("ned"):
        cells[f"gps_v{name}_mps"][fix] = flown.gnss["vel_n"][:, axis]
    for name, key in (("lat_deg", "lat_deg"), ("lon_deg", "lon_deg"), ("alt_m", "alt")):
        cells[f"gps_{name}"][fix] = flown.gnss[key]
    for name, size in sizes.items():
        cells[name] = cells[name] * size
    rows = np.column_stack([cells[name] for name in names])
    lines = [",".join("" if np.isnan(x) else f"{x:.9f}" for x in row) for row in rows.tolist()]
    path.write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    return path


def convert(log, out):
    return CliRunner().invoke(app, ["convert", str(log), "-o", str(out)])


def test_the_table_in_the_readme_is_read_as_it_says(tmp_path):
    log = tmp_path / "mine.csv"
    log.write_text("\n".join(example()) + "\n", encoding="utf-8")
    found = read(log).events
    counts = {kind: int(np.count_nonzero(found.kind == kind)) for kind in Kind}
    assert (counts[Kind.IMU], counts[Kind.GNSS], counts[Kind.MAG]) == (4, 1, 2)
    (fix,) = found.values[found.kind == Kind.GNSS]
    assert fix[:3] == pytest.approx([np.deg2rad(47.397742), np.deg2rad(8.545594), 488.0])


def test_a_flight_under_its_header_converts_to_a_good_estimate(flown, tmp_path):
    result = convert(write(tmp_path / "mine.csv", flown), tmp_path / "out.csv")
    assert result.exit_code == 0, result.output
    assert " m RMS by its own sigma, no resets" in result.output.splitlines()[0]
    assert "look like" not in result.output
    assert "axes" not in result.output
    assert len((tmp_path / "out.csv").read_text().splitlines()) > 1400


@pytest.mark.parametrize(
    ("sizes", "sentence"),
    [
        ({"gps_vn_mps": 3.6, "gps_ve_mps": 3.6, "gps_vd_mps": 3.6}, "look like km/h; give m/s"),
        ({"gyro_y_dps": -1.0, "gyro_z_dps": -1.0}, "gyro is forward, left, up and accel forward"),
        (
            {"mag_z_uT": -1.0},
            "the field does not turn in the vehicle as the gyro does: z of mag is r",
        ),
        ({f"gyro_{axis}_dps": 1.0 / 57.29578 for axis in "xyz"}, "in a table gyro_x_rps"),
    ],
)
def test_what_contradicts_itself_in_a_table_is_noted(flown, tmp_path, sizes, sentence):
    result = convert(write(tmp_path / "mine.csv", flown, **sizes), tmp_path / "out.csv")
    assert sentence in " ".join(result.output.split())
    assert "the units or axes look wrong" in result.output.splitlines()[0]
    assert not result.output.startswith("good")


UP = {f"{name}_{axis}_{unit}": -1.0 for name, unit in SENSORS for axis in "yz"}
TURNED = {f"gyro_{axis}_dps": np.rad2deg(1.0) for axis in "xyz"}


@pytest.mark.parametrize(
    ("sizes", "sentence"),
    [
        (UP, "a level vehicle measures -9.8 along its down axis"),
        ({f"accel_{axis}_mps2": 1.0 / 9.80665 for axis in "xyz"}, "g; name the columns accel_x_g"),
        (TURNED, "it looks like deg/s; name the columns gyro_x_dps"),
    ],
)
def test_inertial_samples_of_other_axes_or_units_are_noted_and_not_called_good(
    flown, tmp_path, sizes, sentence
):
    """Forward, left, up; g under the name of m/s2; deg/s taken for rad/s."""
    result = convert(write(tmp_path / "mine.csv", flown, **sizes), tmp_path / "out.csv")
    assert sentence in " ".join(result.output.split())
    assert not result.output.startswith("good")
    assert ", the units or axes look wrong" in result.output.splitlines()[0]
    assert "units={" not in result.output


@pytest.mark.parametrize("name", ["zupt", "ahrs", "mahony"])
def test_other_filters_run_over_it_as_it_was_read(flown, tmp_path, name):
    log = read(write(tmp_path / "mine.csv", flown))
    assert len(run_filter(log, name).table.stamp_ns) > 1000
