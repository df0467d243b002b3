"""What the command line refuses, in a sentence and with which exit code."""

import json

import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from sim_autopilot.__main__ import app as simulator


def command(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    log = tmp_path_factory.mktemp("flown") / "flight.tlog"
    options = ["--scenario", "hover", "--duration", "12", "--imu-rate", "50"]
    result = CliRunner().invoke(simulator, ["generate", "-o", str(log), *options])
    assert result.exit_code == 0, result.output
    return log


@pytest.mark.parametrize("option", ["--skip", "--until"])
@pytest.mark.parametrize("seconds", ["nan", "inf", "-1"])
def test_a_span_that_cannot_be_meant_is_refused(flown, option, seconds):
    result = command("compare", flown, option, seconds)
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit)


def test_what_leaves_nothing_to_compare_is_named(flown):
    result = command("compare", flown, "--skip", 8, "--until", 5)
    assert result.exit_code == 3
    assert "and before 5 s; leave out less with --skip and --until" in result.stderr
    assert command("compare", flown, "--skip", 8, "--until", 8).exit_code == 3
    result = command("compare", flown, "--skip", 80)
    assert result.exit_code == 3
    assert result.stderr.endswith("after the first 80 s; leave out fewer with --skip\n")


def test_the_estimates_do_not_overwrite_the_log(flown):
    before = flown.read_bytes()
    result = command("convert", flown, "-o", flown)
    assert result.exit_code == 2
    assert "is the log; name another file" in result.stderr
    assert flown.read_bytes() == before


@pytest.mark.parametrize(
    "words",
    [
        "convert LOG -o out.csv",
        "convert LOG -o out.csv --filter mahony",
        "compare LOG --skip 2",
        "compare LOG --skip 2 --filters mahony",
        "observability LOG",
        "doctor --log LOG",
    ],
)
def test_json_means_the_same_everywhere_the_result_in_place_of_the_text(
    flown, tmp_path, monkeypatch, words
):
    monkeypatch.chdir(tmp_path)
    result = command(*words.replace("LOG", str(flown)).split(), "--json")
    assert result.exit_code in (0, 5), result.output
    assert json.loads(result.stdout)


@pytest.mark.parametrize("name", ["report", "convert", "view"])
def test_a_folder_and_several_logs_are_for_batch(tmp_path, name):
    outs = {"report": ["-o", tmp_path / "out.html"], "convert": ["-o", tmp_path / "out.csv"]}
    out = outs.get(name, [])
    result = command(name, tmp_path, *out)
    assert result.exit_code == 3
    assert f"{tmp_path}: a folder; name one log in it, or all: ekf-companion batch" in result.stderr
    result = command(name, "a.tlog", "b.tlog", *out)
    assert result.exit_code == 2
    assert f"{name} takes one log, batch takes several" in " ".join(result.stderr.split())


def test_an_output_of_another_kind_or_of_two_names_is_refused(flown, tmp_path):
    kept = tmp_path / "track.kml"
    kept.write_text("mine")
    result = command("report", flown, "-o", kept)
    assert result.exit_code == 2
    assert "track.kml: a report is a .html; --png draws a picture" in result.stderr
    assert kept.read_text() == "mine"
    result = command("convert", flown, "-o", tmp_path / "b.csv,b.kml")
    assert result.exit_code == 2
    assert "b.csv,b.kml: is one name; give --out again for each file" in result.stderr
    assert command("convert", flown, "-o", tmp_path / "north, 2.csv").exit_code == 0
    assert sorted(one.name for one in tmp_path.iterdir()) == ["north, 2.csv", "track.kml"]


@pytest.mark.parametrize("words", ["compare --skip 5", "observability"])
def test_a_figure_of_no_kind_is_a_png_and_of_another_kind_refused_before_the_work(
    flown, tmp_path, words
):
    pytest.importorskip("matplotlib")
    result = command(*words.split(), flown, "--plot", tmp_path / "figure")
    assert result.exit_code == 0, result.output
    assert f"figure: {tmp_path / 'figure.png'}" in result.output
    assert [one.name for one in tmp_path.iterdir()] == ["figure.png"]
    for name in ("figure.v2", "figure.jpg", "figure.png.gz"):
        result = command(*words.split(), flown, "--plot", tmp_path / name)
        assert result.exit_code == 2
        assert f"{name}: a figure is a .png, .pdf or .svg; name one of them" in result.stderr
        assert not result.stdout


@pytest.mark.parametrize("name", ["report", "compare"])
def test_a_quoted_pattern_is_for_the_shell(tmp_path, name):
    result = command(name, tmp_path / "*.ulg")
    assert result.exit_code == 3
    assert "*.ulg: a pattern, and no file of that name; leave the quotes out" in result.stderr


def test_an_estimate_of_ours_is_no_log(flown, tmp_path):
    estimate = tmp_path / "estimate.csv"
    assert command("convert", flown, "-o", estimate).exit_code == 0
    result = command("report", estimate)
    assert result.exit_code == 3
    assert "an estimate that convert wrote, and no log" in result.stderr
    assert f"ekf-companion compare {estimate} --reference TRUTH.csv" in result.stderr


def test_a_link_that_is_none_is_a_wrong_command_line():
    result = command("run", "--link", "com3")
    assert result.exit_code == 2
    assert result.stderr.startswith("ekf-companion: com3: not a link; write for")


@pytest.mark.parametrize("suffix", [".csv", ".kml"])
def test_convert_says_what_it_wrote(flown, tmp_path, suffix):
    out = tmp_path / f"out{suffix}"
    result = command("convert", flown, "-o", out)
    assert result.stdout.endswith(f"wrote {out}\n")


def test_convert_by_another_filter_and_to_two_files_says_so_too(flown, tmp_path):
    outs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    result = command("convert", flown, "-o", outs[0], "-o", outs[1], "--filter", "mahony")
    assert result.stdout.endswith(f"wrote {outs[0]}\nwrote {outs[1]}\n")


def test_on_a_pipe_nothing_but_numbers_is_on_the_standard_output(flown, tmp_path):
    beside = tmp_path / "track.csv"
    result = command("convert", flown, "-o", "-", "-o", beside)
    assert "wrote" not in result.stdout
    assert f"wrote {beside}\n" in result.stderr


def test_compare_says_the_verdict_that_report_and_convert_do_and_names_its_figure(flown, tmp_path):
    figure = tmp_path / "track.png"
    compared = command("compare", flown, "--skip", 2, "--plot", figure)
    assert compared.exit_code == 0, compared.output
    reported = command("convert", flown, "-o", tmp_path / "out.csv")
    assert compared.stdout.splitlines()[0] == reported.stdout.splitlines()[0]
    assert compared.stdout.endswith(f"figure: {figure}\n")
