"""The commands: what they print, write and refuse."""

import json

import pytest
import yaml
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import parse_config
from ekf_companion.yaml_file import YamlLoader
from sim_autopilot.__main__ import app as simulator


def command(*arguments):
    return CliRunner().invoke(app, ["calibrate", *map(str, arguments)])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Return logs of a flight and of a vehicle that stands."""
    logs = {}
    for name, seconds in (("figure-eight", "45"), ("static", "40"), ("hover", "12")):
        logs[name] = tmp_path_factory.mktemp("flown") / f"{name}.tlog"
        options = ["--scenario", name, "--duration", seconds, "--imu-rate", "25"]
        options += ["--seed", str(len(logs))]  # frames of two flights are not the same
        made = CliRunner().invoke(simulator, ["generate", "-o", str(logs[name]), *options])
        assert made.exit_code == 0, made.output
    return logs


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("kind", "name", "key"),
    [
        ("noise", "static", "imu.gyro_noise"),
        ("delay", "figure-eight", "gnss.delay"),
        ("mag", "figure-eight", "heading.hard_iron"),
    ],
)
def test_a_calibration_prints_yaml_and_writes_a_figure_and_json(flown, tmp_path, kind, name, key):
    result = command(kind, flown[name])
    assert result.exit_code == 0, result.output
    pasted = parse_config(yaml.load(result.stdout, YamlLoader), "printed")
    if kind == "delay":
        assert pasted.gnss.delay == pytest.approx(0.12, abs=0.01)
    assert result.stdout.startswith(f"# ekf-companion calibrate {kind} ")
    figure = flown[name].with_name(f"{name}.{kind}.png")
    before = figure.read_bytes()
    assert result.stdout.endswith(f"# figure: {figure}\n")
    assert before.startswith(b"\x89PNG")
    again = command(kind, flown[name], "--json")
    assert key in json.loads(again.stdout)["keys"]
    assert again.stderr.endswith(f"# figure: {figure.with_name(f'{name}.{kind}-2.png')}\n")
    assert figure.read_bytes() == before
    assert list(tmp_path.iterdir()) == []


def test_the_figure_goes_where_it_is_asked_for_and_what_is_printed_says_so(flown, tmp_path):
    result = command("mag", flown["figure-eight"], "--plot", "curve.svg")
    assert result.stdout.endswith("# figure: curve.svg\n")
    assert b"<svg" in (tmp_path / "curve.svg").read_bytes()


@pytest.mark.parametrize(
    ("kind", "name", "sentence"),
    [
        ("noise", "hover", "shows nothing of the noise"),
        ("delay", "static", "its motion does not show the delay of fixes"),
        ("mag", "static", "the vehicle has hardly turned"),
    ],
)
def test_a_log_that_cannot_serve_ends_with_3_and_a_sentence(flown, tmp_path, kind, name, sentence):
    result = command(kind, flown[name])
    assert result.exit_code == 3
    assert f"ekf-companion: {flown[name]}: {sentence}" in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_nothing_overwrites_the_log(flown):
    before = flown["static"].read_bytes()
    result = command("noise", flown["static"], "--plot", flown["static"])
    assert result.exit_code == 2
    assert "is the log; name another file" in result.stderr
    assert flown["static"].read_bytes() == before


@pytest.mark.parametrize("place", ["missing/figure.png", "figure.unknown"])
def test_a_figure_that_could_not_be_written_is_refused_before_the_log_is_read(place):
    result = command("mag", "missing.tlog", "--plot", place)
    assert result.exit_code == 2
    assert place in result.stderr


def test_a_log_that_is_none_ends_with_3(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    assert command("delay", "empty.csv").exit_code == 3
    assert command("mag", "missing.bin").exit_code == 3


def test_a_log_with_a_restart_serves_by_its_longest_part(flown, tmp_path):
    from ekf_companion.config.config import Config
    from ekf_companion.nav.measurements import Kind
    from ekf_companion.replay.read import read

    twice = tmp_path / "twice.tlog"
    twice.write_bytes(flown["hover"].read_bytes() + flown["static"].read_bytes())
    recording = read(twice, Config())
    imu = recording.events.t_ns[recording.events.kind == Kind.IMU]
    assert not (recording.events.kind == Kind.RESTART).any()
    assert (imu[-1] - imu[0]) * 1e-9 == pytest.approx(40.0, abs=1.0)
    assert (
        "the autopilot rebooted in this log, and its clock begins anew; the longest part counts"
        in (recording.notes)
    )
