"""The pictures of docs/FLEET.md are drawn by a command."""

import sys

import pytest

from benchmarks import fleet_figures


@pytest.mark.campaign
def test_three_questions_are_answered_by_pictures(monkeypatch, tmp_path):
    monkeypatch.setattr(fleet_figures, "FLIGHTS", 3)
    monkeypatch.setattr(sys, "argv", ["fleet_figures", "--out", str(tmp_path), "--jobs", "1"])
    fleet_figures.main()
    drawn = {path.name: path.read_bytes()[:4] for path in tmp_path.iterdir()}
    names = ("fleet-worst.png", "fleet-noise.png", "fleet-compare.png")
    assert drawn == dict.fromkeys(names, b"\x89PNG")
