"""The command: what it prints, writes and refuses."""

import json

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from sim_autopilot.__main__ import app as simulator


def command(*arguments):
    return CliRunner().invoke(app, ["observability", *map(str, arguments)])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return logs of a flight and of a vehicle that stands."""
    logs = {}
    for name in ("figure-eight", "static"):
        logs[name] = tmp_path_factory.mktemp("flown") / f"{name}.tlog"
        options = ["--scenario", name, "--duration", "25", "--imu-rate", "25"]
        made = CliRunner().invoke(simulator, ["generate", "-o", str(logs[name]), *options])
        assert made.exit_code == 0, made.output
    return logs


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.campaign
def test_it_prints_a_sentence_per_state_and_writes_a_figure_and_json(flown, tmp_path):
    result = command(flown["static"])
    assert result.exit_code == 0, result.output
    assert (
        "accelerometer x bias: not observable in this flight: no turn, no change of tilt and no "
        "horizontal acceleration; it cannot be separated from a pitch error of 1."
    ) in result.stdout
    assert "accelerometer z bias: observable from " in result.stdout
    figure = flown["static"].with_name("static.observability.png")
    assert result.stdout.endswith(f"figure: {figure}\n")
    assert figure.read_bytes().startswith(b"\x89PNG")
    again = command(flown["static"], "--json")
    assert again.stderr.endswith(f"figure: {figure.with_name('static.observability-2.png')}\n")
    data = json.loads(again.stdout)
    assert data["states"]["accelerometer y bias"]["observable_since_s"] is None
    assert set(data["sentences"]) <= set(result.stdout.splitlines())


@pytest.mark.campaign
def test_a_flight_shows_its_biases_in_windows_of_any_length(flown, tmp_path):
    result = command(flown["figure-eight"], "--window", "5", "--plot", "f.svg", "--json")
    assert result.exit_code == 0, result.output
    assert "accelerometer x bias: not observable before " in result.stdout
    assert "<svg" in (tmp_path / "f.svg").read_text()
    data = json.loads(result.stdout)
    assert any("richest window of 5 s: " in sentence for sentence in data["sentences"])
    since = data["states"]["accelerometer x bias"]["observable_since_s"]
    # It takes off at 5.3 s and begins its first eight at 9 s
    assert 9.0 < since < 20.0


def test_a_log_without_fixes_or_headings_ends_with_3_and_a_sentence(tmp_path):
    rows = [f"{0.01 * k},0,0,0,0,0,-9.81" for k in range(500)]
    (tmp_path / "bare.csv").write_text(
        "\n".join(["t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z", *rows]) + "\n"
    )
    result = command("bare.csv")
    assert result.exit_code == 3
    assert "ekf-companion: bare.csv: " in result.stderr
    assert result.stdout == ""
    assert command("missing.ulg").exit_code == 3


def test_nothing_overwrites_the_log(flown):
    before = flown["static"].read_bytes()
    result = command(flown["static"], "--plot", flown["static"])
    assert result.exit_code == 2
    assert flown["static"].read_bytes() == before


def test_a_figure_that_cannot_be_written_ends_with_a_sentence(flown, tmp_path):
    folder = tmp_path / "figure.png"
    folder.mkdir()
    result = command(flown["static"], "--plot", str(folder))
    assert result.exit_code == 3
    assert str(folder) in result.stderr
    assert "Traceback" not in result.output
