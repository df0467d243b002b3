"""The pictures of docs/FLEET.md are drawn by a command."""

import sys

import pytest

from benchmarks import fleet, fleet_figures
from tests.paths import DATA

FLIGHTS = ("px4-ulg-x500-mission", "px4-ulg-x500-hover", "sitl-arducopter-bin")


@pytest.mark.campaign
@pytest.mark.skipif(not DATA.is_dir(), reason="the recorded flights are not here")
def test_three_questions_are_answered_by_pictures(monkeypatch, tmp_path):
    some = tmp_path / "some"
    for name in FLIGHTS:
        (some / name).mkdir(parents=True)
        for log in (DATA / name).iterdir():
            (some / name / log.name).symlink_to(log)
    monkeypatch.setattr(fleet, "DATA", some)
    out = tmp_path / "images"
    out.mkdir()
    monkeypatch.setattr(sys, "argv", ["fleet_figures", "--out", str(out), "--jobs", "1"])
    fleet_figures.main()
    drawn = {path.name: path.read_bytes()[:4] for path in out.iterdir()}
    names = ("fleet-worst.png", "fleet-noise.png", "fleet-compare.png")
    assert drawn == dict.fromkeys(names, b"\x89PNG")
