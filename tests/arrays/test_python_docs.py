"""What README, docs/PYTHON.md and the notebook show in Python runs."""

import json
import re

import matplotlib as mpl
import numpy as np
import pytest

from ekf_companion import estimate
from tests.arrays.test_run import Flown
from tests.notebook import run_all
from tests.paths import ROOT


def blocks(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


@pytest.fixture(scope="module")
def given():
    """Return the names that the examples use for the user's own arrays."""
    flown = Flown()
    moments = flown.time[::25]
    above = flown.truth.alt - flown.truth.alt.min() + 1.5
    heights = np.interp(moments, flown.truth.pos_t_ns * 1e-9, above)
    # A receiver of 1 m, of which the first fix is one of the worst
    noise = np.random.default_rng(7).standard_normal(len(flown.gnss["alt"]))
    noise[0] = 2.5
    return {
        "t": flown.time,
        "gyro": flown.gyro,
        "accel": flown.accel,
        "t_fix": flown.gnss["time"],
        "lat": flown.gnss["lat_deg"],
        "lon": flown.gnss["lon_deg"],
        "alt": flown.gnss["alt"] + noise,
        "velocity": flown.gnss["vel_n"],
        "t_mag": flown.mag["time"],
        "field": flown.mag["field"],
        "t_true": flown.truth.pos_t_ns * 1e-9,
        "true_lat": np.rad2deg(flown.truth.lat),
        "true_lon": np.rad2deg(flown.truth.lon),
        "true_alt": flown.truth.alt,
        "mag": flown.mag,
        "fixes": {**flown.gnss, "alt": flown.gnss["alt"] + noise},
        "t_range": moments,
        "ranges": heights,
        "lowest": flown.truth.alt.min() - 1.5,
        "estimate": estimate,
    }


def test_readme_s_lines_run(given, tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas")
    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    (shown,) = [block for block in blocks("README.md") if "import estimate" in block]
    assert len(shown.strip().splitlines()) == 6
    exec(compile(shown, "README.md", "exec"), dict(given))
    assert "[" in capsys.readouterr().out


def test_the_page_s_examples_run_in_their_order(given, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = dict(given)
    for number, block in enumerate(blocks("docs/PYTHON.md")):
        exec(compile(block, f"docs/PYTHON.md, example {number}", "exec"), names)
        if "Rangefinder" in block:
            aided = names["track"]
    assert len(names["track"]) > 1000
    shown = [float(one) for one in capsys.readouterr().out.split("]")[0].strip("[ ").split()]
    assert 0.0 < max(shown) < 3.0

    # The range finder is fused, and its height is its own
    assert not any("range" in note for note in aided.notes)
    late = aided.time > aided.time[-1] - 10.0
    above = np.interp(aided.time, given["t_true"], given["true_alt"]) - given["lowest"]
    assert np.std((aided.alt - given["lowest"] - above)[late]) < 0.1
    assert abs(np.mean((aided.alt - given["lowest"] - above)[late])) < 0.5


@pytest.mark.campaign
def test_the_notebook_runs_and_shows_what_it_did(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs" / "python.ipynb").read_text(encoding="utf-8"))
    committed = [cell.get("outputs") for cell in notebook["cells"]]
    names = run_all(notebook)
    made = [cell.get("outputs") for cell in notebook["cells"]]
    assert (tmp_path / "flight.tum").exists()
    assert names["aided"].sigma[-1, 2] < 0.2

    # It is committed with what it prints and draws: python -m tests.notebook
    kinds = [[sorted(one.get("data", {"text": 0})) for one in cell or ()] for cell in committed]
    assert kinds == [[sorted(one.get("data", {"text": 0})) for one in cell or ()] for cell in made]
    assert [["image/png"]] in kinds
    assert "it looks like deg/s" in "".join(committed[8][0]["text"])
    assert committed[8] == made[8]
