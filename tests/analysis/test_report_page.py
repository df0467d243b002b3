"""The report on a flight: one file, offline, small, drawn by a browser, and true."""

import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.analysis.report_page import POINTS, thin
from ekf_companion.cli import app
from sim_autopilot.__main__ import app as simulator

LARGEST = 3_000_000


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    log = tmp_path_factory.mktemp("flown") / "flight.tlog"
    made = CliRunner().invoke(
        simulator, ["generate", "-o", str(log), "--scenario", "figure-eight", "--duration", "40"]
    )
    assert made.exit_code == 0, made.output
    return log


@pytest.fixture(scope="module")
def reported(flown):
    pytest.importorskip("bokeh")
    return CliRunner().invoke(app, ["report", str(flown)]), flown.with_name("flight.report.html")


def test_it_says_its_verdict_and_where_it_is(reported):
    result, path = reported
    assert result.exit_code == 0, result.output
    verdict, file = result.stdout.splitlines()
    assert re.fullmatch(r"good: 0\.\d m RMS from the truth, no resets", verdict)
    assert file == f"report: {path}"


def test_it_is_one_small_file_that_needs_no_network(reported):
    text = reported[1].read_text()
    assert len(text) < LARGEST
    assert not re.search(r"<(script|link|img)[^>]*\b(src|href)=", text)
    assert "good: 0." in text.partition("class='verdict good'>")[2][:40]
    for title in (
        *("track", "height above mean sea level", "velocity north", "roll", "position north"),
        *("fused, per second", "gyro bias", "accelerometer", "status ("),
    ):
        assert f'"{title}' in text, title
    assert "position: " in text.partition("found, used and refused")[2]


def test_a_browser_draws_it_without_an_error(reported, tmp_path):
    browser = shutil.which("chromium")
    if browser is None:
        pytest.skip("no chromium")
    picture = tmp_path / "shot.png"
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    options += ["--virtual-time-budget=10000", f"--user-data-dir={tmp_path / 'profile'}"]
    options += ["--window-size=1200,900", f"--screenshot={picture}"]
    options += ["--host-resolver-rules=MAP * ~NOTFOUND"]
    result = subprocess.run(
        [browser, *options, reported[1].as_uri()],
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )
    assert picture.stat().st_size > 30_000, result.stderr  # an empty page has 8 kB
    said = [line for line in result.stderr.splitlines() if "CONSOLE" in line]
    assert not [line for line in said if "rror" in line], said


def test_a_second_one_overwrites_nothing_and_json_comes_in_place_of_the_text(reported, flown):
    before = reported[1].read_bytes()
    result = CliRunner().invoke(app, ["report", str(flown), "--json", "--png"])
    assert result.exit_code == 0, result.output
    second = flown.with_name("flight.report-2.html")
    assert result.stderr == f"report: {second}, {second.with_suffix('.png')}\n"
    assert second.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    data = json.loads(result.stdout)
    assert data["grade"] == "good"
    assert data["verdict"].startswith("good: 0.")
    assert reported[1].read_bytes() == before


def test_without_bokeh_it_says_what_to_install(flown):
    hidden = "import sys; sys.modules['bokeh'] = None; from ekf_companion.cli import app; app()"
    result = subprocess.run(
        [sys.executable, "-c", hidden, "report", flown, "-o", flown.with_name("no.html")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert "report: needs bokeh, which is not installed" in result.stderr
    assert "-m pip install 'ekf-companion[report]'" in result.stderr
    assert not flown.with_name("no.html").exists()


def test_a_line_keeps_its_extremes_and_its_gaps():
    x = np.arange(100_000.0)
    y = np.sin(x / 3000.0)
    y[5_000], y[77_777], y[50_000] = 9.0, -9.0, np.nan
    _, short = thin(x, y)
    assert len(short) <= 1.6 * POINTS
    assert (np.nanmax(short), np.nanmin(short)) == (9.0, -9.0)
    assert np.isnan(short).sum() == 1
