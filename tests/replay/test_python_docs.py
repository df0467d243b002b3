"""What README, docs/PYTHON.md and the notebook show in Python runs."""

import json
import re

import matplotlib as mpl
import numpy as np
import pytest

from ekf_companion import estimate
from tests.paths import ROOT
from tests.replay.test_arrays import Flown


def blocks(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    return re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)


@pytest.fixture(scope="module")
def given():
    """Return the names that the examples use for the user's own arrays."""
    flown = Flown()
    heights = -np.zeros(5)
    return {
        "t": flown.time,
        "gyro": flown.gyro,
        "accel": flown.accel,
        "t_fix": flown.gnss["time"],
        "lat": flown.gnss["lat_deg"],
        "lon": flown.gnss["lon_deg"],
        "alt": flown.gnss["alt"],
        "velocity": flown.gnss["vel_n"],
        "t_mag": flown.mag["time"],
        "field": flown.mag["field"],
        "t_true": flown.truth.pos_t_ns * 1e-9,
        "true_lat": np.rad2deg(flown.truth.lat),
        "true_lon": np.rad2deg(flown.truth.lon),
        "true_alt": flown.truth.alt,
        "mag": flown.mag,
        "fixes": flown.gnss,
        "ranges": list(
            zip((flown.time[1000:1005] * 1e9).astype(int).tolist(), heights, strict=True)
        ),
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
    assert len(names["track"]) > 1000
    shown = [float(one) for one in capsys.readouterr().out.split("]")[0].strip("[ ").split()]
    assert 0.0 < max(shown) < 3.0


@pytest.mark.campaign
def test_the_notebook_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pandas")
    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs" / "python.ipynb").read_text(encoding="utf-8"))
    names = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert "it looks like deg/s" in capsys.readouterr().out
    assert (tmp_path / "flight.tum").exists()
    assert names["aided"].sigma[-1, 2] < 0.2
