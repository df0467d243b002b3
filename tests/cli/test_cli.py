"""What the command line refuses, in a sentence and with which exit code."""

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


@pytest.mark.parametrize("is_log", [True, False])
def test_the_summary_overwrites_neither_the_log_nor_the_estimates(flown, tmp_path, is_log):
    out = tmp_path / "out.csv"
    before = flown.read_bytes()
    result = command("convert", flown, "-o", out, "--json", flown if is_log else out)
    assert result.exit_code == 2
    other = "the log" if is_log else "what --out writes"
    assert f"is {other}; name another file" in result.stderr
    assert flown.read_bytes() == before
    assert not out.exists()


def test_a_link_that_is_none_is_a_wrong_command_line():
    result = command("run", "--link", "com3")
    assert result.exit_code == 2
    assert result.stderr.startswith("ekf-companion: com3: not a link; write for")
