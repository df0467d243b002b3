"""Tracks for maps: called as the log, with UTC where the log knows it."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.config.config import Config
from ekf_companion.logs.map_time import Label, utc
from ekf_companion.review.convert import convert
from sim_autopilot.__main__ import app as simulator
from tests.analysis.test_report_page import with_stamps

BEGAN_US = 1_782_907_200_000_000
"""2026-07-01 12:00 UTC."""


@pytest.fixture(scope="module")
def dated(tmp_path_factory):
    """Return a .tlog of an autopilot that counts from its boot; the recorder knows the day."""
    root = tmp_path_factory.mktemp("dated")
    words = ("generate", "--duration", "30", "--imu-rate", "50", "-o", root / "plain.tlog")
    assert CliRunner().invoke(simulator, [*map(str, words)]).exit_code == 0
    log = root / "north & south.tlog"
    log.write_bytes(with_stamps((root / "plain.tlog").read_bytes(), BEGAN_US))
    return log


@pytest.mark.parametrize("suffix", [".kml", ".gpx"])
def test_a_track_has_the_logs_name_and_its_day(dated, suffix):
    out = dated.with_suffix(suffix)
    report = convert(dated, out, Config())
    text = out.read_text()
    assert "<name>north &amp; south.tlog</name>" in text
    times = re.findall(r"<(?:when|time)>([^<]+)<", text)
    assert times[0].startswith("2026-07-01T12:00:0")
    assert times[-1].startswith("2026-07-01T12:00:29")
    assert not any("holds no point" in note for note in report.notes)


def test_a_stamp_that_is_utc_already_stays():
    stamps = np.array([1_000_000_000, BEGAN_US * 1000], dtype=np.int64)
    first, second = utc(stamps, BEGAN_US * 1000)
    assert first.startswith("2026-07-01T12:00:01")
    assert second.startswith("2026-07-01T12:00:00")
    assert utc(stamps[:1]) == ["1970-01-01T00:00:01.000000Z"]


def test_a_track_without_a_point_is_noted(tmp_path):
    rows = ["time_s,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2"]
    rows += [f"{i * 0.01:.2f},0,0,0,0.01,0,-9.81" for i in range(2000)]
    log = tmp_path / "still.csv"
    log.write_text("\n".join(rows))
    report = convert(log, [tmp_path / "still.kml", tmp_path / "out.csv"], Config())
    assert "still.kml: holds no point, for no position was estimated" in report.notes


@pytest.mark.parametrize("name", ["a\x01", "\0", "<b>&\x1f", "\udcff\ud800", "\ufffe", "Höhe 🚁\t"])
def test_any_name_is_text_of_an_xml_file(name):
    text = ElementTree.fromstring(f"<name>{Label(name).text}</name>").text  # ours
    assert len(text) == len(name)
    assert all(a == b or a == "\ufffd" for a, b in zip(text, name, strict=True))
