"""The commands. Only they print and exit. A command has an argument for each of its options.

Exit codes: 0 done, 1 a figure cannot be drawn or a bug, 2 the command line or the configuration is
wrong, 3 the log cannot be read, or holds nothing to estimate or to calibrate from, 4 ``status``
finds no daemon (and 1 one that is not healthy), 5 the doctor has found a stage that fails.
"""

from __future__ import annotations

from typing import Annotated

import typer

from ekf_companion.cli.calibrate import calibrate
from ekf_companion.cli.compare import compare
from ekf_companion.cli.convert import convert
from ekf_companion.cli.doctor import doctor
from ekf_companion.cli.observability import observability
from ekf_companion.cli.reload import reload
from ekf_companion.cli.report import report
from ekf_companion.cli.service import check_config, run
from ekf_companion.cli.status import status
from ekf_companion.version import __version__

app = typer.Typer(
    help="State estimation on a drone's companion computer: MAVLink in, ODOMETRY out.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _show_version(value: bool) -> None:
    if value:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Take the options that are common to all commands."""


app.command()(run)
app.command()(status)
app.command()(reload)
app.command()(convert)
app.command()(compare)
app.command()(report)
app.add_typer(calibrate, name="calibrate")
app.command()(observability)
app.command()(doctor)
app.command("check-config")(check_config)
