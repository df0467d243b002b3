"""What a command imports is what its start costs."""

import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from ekf_companion.cli import COMMANDS, app
from tests.daemon.waiting import LIMIT

runner = CliRunner()
CSV = "time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2\n"


def imported(*arguments):
    """Return the top-level packages and our rooms that a command has imported when it ends."""
    code = (
        "import sys\nfrom ekf_companion.cli import app\n"
        f"try:\n    app({list(arguments)!r})\nexcept SystemExit as end:\n    assert not end.code\n"
        "print(*{'.'.join(name.split('.')[:2]) for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=LIMIT
    )
    return {*done.stdout.splitlines()[-1].split()}


def test_the_help_needs_none_of_the_commands():
    found = imported("--help")
    assert not {"numpy", "yaml", "rich", "pydantic", "pymavlink", "ekf_companion.config"} & found


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_all_commands_says_what_each_says_itself(name):
    entry = COMMANDS[name]
    module = __import__(f"ekf_companion.cli.{entry.module}", fromlist=[entry.function])
    found = getattr(module, entry.function)
    said = found.info.help if isinstance(found, typer.Typer) else found.__doc__.splitlines()[0]
    assert entry.help == said
    assert entry.help.split()[0] in runner.invoke(app, ["--help"]).output
    assert runner.invoke(app, [name, "--help"]).exit_code == 0


def test_a_log_of_columns_is_converted_without_mavlink_and_without_scipy(tmp_path):
    log = tmp_path / "log.csv"
    rows = (f"{4000 * index},0.001,0,0,0,{0.001 * (index % 3)},-9.8\n" for index in range(1000))
    log.write_text(CSV + "".join(rows))
    found = imported("convert", str(log), "-o", str(tmp_path / "out.csv"))
    assert "numpy" in found
    assert (
        not {"pymavlink", "scipy", "rich", "pyarrow", "pydantic", "ekf_companion.mavlink"} & found
    )


def test_the_daemon_needs_none_of_the_large_packages():
    code = "import sys, ekf_companion.daemon.daemon\nprint(*{n.split('.')[0] for n in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = {*done.stdout.split()}
    assert "numpy" in found
    assert not {"scipy", "pymavlink", "pandas", "pyarrow", "bokeh", "matplotlib", "vqf"} & found


def test_an_unknown_command_is_refused_by_a_sentence():
    result = runner.invoke(app, ["covnert"])
    assert result.exit_code == 2
    assert "No such command 'covnert'; did you mean convert?" in result.output
    assert runner.invoke(app, ["fly"]).output.rstrip().endswith("No such command 'fly'.")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("run --port /dev/ttyACM0", "No such option: --port; did you mean --link? serial:/dev/tty"),
        ("doctor --baud=57600", "No such option: --baud; did you mean --link? serial:/dev/tty"),
        ("convert a.tlog --output b.csv", "--output; did you mean --out? -o FILE names a file"),
        ("convert a.tlog --port 5", "No such option: --port"),
        ("convert a.tlog", "Missing option '--out' / '-o'. .csv, .tlog, .mcap"),
        ("batch a.tlog", "Missing option '--out' / '-o'. The table: .csv or .parquet"),
    ],
)
def test_an_option_that_is_unknown_or_missing_is_named_with_what_to_give(line, sentence):
    result = runner.invoke(app, line.split())
    assert result.exit_code == 2
    assert sentence in result.output
    assert "--link" not in result.output or not line.startswith("convert")


def test_the_page_s_own_port_is_no_mistake():
    result = runner.invoke(app, ["view", "none.tlog", "--port", "0", "--no-browser"])
    assert result.exit_code == 3
