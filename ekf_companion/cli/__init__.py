"""The commands. Only they print and exit. A command has an argument for each of its options.

Exit codes: 0 done, 1 a package of an extra is missing or a bug, 2 the command line or the
configuration is wrong, 3 the log cannot be read, or holds nothing to estimate or to calibrate from,
or an output cannot be written, 4 ``status`` finds no daemon (and 1 one that is not healthy), 5 the
doctor has found a stage that fails, or ``preflight`` a reason against a take-off, 6 ``preflight``
finds the vehicle armed.
"""

from __future__ import annotations

from difflib import get_close_matches
from importlib import import_module
from typing import Annotated, Any, NamedTuple, cast

import typer

from ekf_companion.cli.command import Command, Group
from ekf_companion.errors import MissingPackageError, NotCompiledError
from ekf_companion.version import __version__


class _Entry(NamedTuple):
    """A command, not imported yet."""

    module: str
    function: str
    help: str
    """The first line of its docstring."""


COMMANDS = {
    "run": _Entry("service", "run", "Run the daemon until SIGTERM."),
    "status": _Entry(
        "status",
        "status",
        "Show the daemon's state. Exit code: 0 ok, 1 no current estimate or invalid, 4 no answer.",
    ),
    "preflight": _Entry(
        "preflight",
        "preflight",
        "Report if the vehicle may take off. Exit code: 0 ready, 5 not, 6 armed, 4 no answer.",
    ),
    "reload": _Entry(
        "reload",
        "reload",
        "Reload the daemon's configuration; rates, gates and noise change in flight.",
    ),
    "convert": _Entry(
        "convert", "convert", "Re-run the estimator, or another filter, over a recorded flight."
    ),
    "compare": _Entry(
        "compare",
        "compare",
        "Compare our estimate, or several filters', with a truth or the autopilot's own.",
    ),
    "report": _Entry(
        "report",
        "report",
        "Show a flight in one HTML file: a verdict, tracks, innovations, biases, spectra.",
    ),
    "view": _Entry(
        "view",
        "view",
        "Show a flight in the browser: a slider over time, both estimates; until Ctrl-C.",
    ),
    "batch": _Entry(
        "batch", "batch", "Estimate from many logs; write one table with a row for each."
    ),
    "fleet": _Entry(
        "fleet",
        "fleet",
        "Ask the results of many logs: the worst, noise, two versions, SQL, a report; tune.",
    ),
    "calibrate": _Entry(
        "calibrate",
        "calibrate",
        "Measure numbers of the configuration from your own logs: YAML to paste, and a figure.",
    ),
    "observability": _Entry(
        "observability",
        "observability",
        "Show when each bias, tilt and heading becomes observable in a flight, and why not before.",
    ),
    "lidar": _Entry(
        "lidar",
        "lidar",
        "Estimate the way of a lidar or a radar, with covariance, from scans and inertial samples.",
    ),
    "run-lidar": _Entry(
        "run_lidar",
        "run_lidar",
        "Run a lidar's odometry until SIGTERM, and send it to the daemon on this board.",
    ),
    "run-ros2": _Entry(
        "run_ros2",
        "run_ros2",
        "Pass odometry of ROS 2 to the daemon on this board until SIGTERM, and its estimates back.",
    ),
    "doctor": _Entry(
        "doctor", "doctor", "Find the stage that loses the data, and the parameter to change."
    ),
    "check-config": _Entry(
        "service", "check_config", "Check a configuration and print it with all its defaults."
    ),
}


_PORTS = ("--port", "--device", "--baud", "--baudrate", "--url", "--connect")
OTHER_OPTIONS = {
    "--link": (_PORTS, "serial:/dev/ttyACM0:921600 or udpin:0.0.0.0:14540 names the autopilot"),
    "--out": (("--output", "--out-file"), "-o FILE names a file to write"),
}
"""Our options by name: how other programs call them, and their argument."""


_OF_ONE_LOG = ("convert", "report", "view")
"""Commands that take one log: batch takes many."""
_USAGE_ERROR = cast("type[Exception]", typer.BadParameter.__bases__[0])
"""Exit code of any wrong command line, which typer does not name."""


class _Command(Command):
    """A command that names the right option where one is missing or unknown."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments of the command line.

        Raises:
            typer.BadParameter: One is missing, unknown or wrong; the command line prints it.
        """
        own = {name for parameter in self.params for name in parameter.opts}
        given = {arg.partition("=")[0] for arg in args} - own
        for option, (others, advice) in OTHER_OPTIONS.items():
            if option in own and not ctx.resilient_parsing and (wrong := given & {*others}):
                ctx.fail(f"No such option: {sorted(wrong)[0]}; did you mean {option}? {advice}")
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            # Of a parameter that is missing; its help says what to give
            if error.message:
                raise
            advice = getattr(error.param, "help", None) or ""
            raise type(error)(advice, ctx=error.ctx, param=error.param) from None
        except _USAGE_ERROR as error:
            message = getattr(error, "message", "")
            if ctx.info_name in _OF_ONE_LOG and message.startswith("Got unexpected extra argument"):
                ctx.fail(f"{message}; {ctx.info_name} takes one log, batch takes several")
            raise


class _Commands(Group):
    """The commands, each imported when it is called, so that the help starts quickly."""

    def list_commands(self, ctx: object) -> list[str]:
        """Return the names in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: object, cmd_name: str) -> Any:
        """Import a command; return None where there is none of that name."""
        if (entry := COMMANDS.get(cmd_name)) is None:
            return None
        found = getattr(import_module(f"ekf_companion.cli.{entry.module}"), entry.function)
        if not isinstance(found, typer.Typer):
            alone = typer.Typer(add_completion=False, rich_markup_mode=None)
            alone.command(cmd_name, cls=_Command)(found)
            found = alone
        return typer.main.get_command(found)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command; where there is none of that name, name the nearest."""
        near = get_close_matches(args[0], COMMANDS) if args and args[0] not in COMMANDS else []
        if near and not ctx.resilient_parsing:
            ctx.fail(f"No such command '{args[0]}'; did you mean {' or '.join(near)}?")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; print a sentence where an import is not installed or compiled."""
        try:
            return super().invoke(ctx)
        except (MissingPackageError, NotCompiledError) as error:
            typer.echo(f"ekf-companion: {error}", err=True)
            raise typer.Exit(1) from error

    def format_commands(self, ctx: object, formatter: Any) -> None:
        """Write the list of commands."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.help) for name, entry in COMMANDS.items()])


app = typer.Typer(
    name="ekf-companion",
    cls=_Commands,
    help="State estimation on a drone's companion computer: MAVLink in, ODOMETRY out.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
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
