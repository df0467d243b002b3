"""Ask questions of the results of many logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError

if TYPE_CHECKING:
    from ekf_companion.fleet.questions import Answer

fleet = typer.Typer(
    help="Ask the results of many logs: the worst, noise, two versions, SQL, a report; tune.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)
TableArgument = Annotated[
    str, typer.Argument(help="What batch wrote: a data set (folder or URL), .csv or .parquet.")
]
OfOption = Annotated[
    str, typer.Option("--of", help="VERSION/CONFIG of a data set that has several, or its begin.")
]
OutOption = Annotated[
    Path | None, typer.Option("--out", "-o", help="Write the answer as .csv or .parquet instead.")
]


@fleet.command("worst")
def fleet_worst(
    table: TableArgument,
    count: Annotated[int, typer.Option(min=1, help="Flights.")] = 20,
    of: OfOption = "",
    out: OutOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """List the flights with the worst verdicts, and why."""
    from ekf_companion.fleet import questions
    from ekf_companion.fleet.load import load

    with terminal.exit_on_error():
        _answer(questions.worst(load(table, of=of), count), out, as_json)


@fleet.command("noise")
def fleet_noise(
    table: TableArgument,
    by: Annotated[
        list[str] | None, typer.Option(help="Column to group by; repeatable. Default: three.")
    ] = None,
    of: OfOption = "",
    out: OutOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Show learnt noise and delays by airframe, receiver and firmware."""
    from ekf_companion.fleet import questions
    from ekf_companion.fleet.load import load

    with terminal.exit_on_error():
        groups = tuple(by) if by else questions.GROUPS[:3]
        _answer(questions.noise(load(table, of=of), groups), out, as_json)


@fleet.command("compare")
def fleet_compare(
    table: TableArgument,
    before: Annotated[str, typer.Argument(help="VERSION/CONFIG in it, or another table.")],
    after: Annotated[str, typer.Argument(help="Likewise, the one that may be better.")],
    out: OutOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Compare two versions or configurations over the same logs: better, worse, by chance."""
    from ekf_companion.fleet import dataset, questions
    from ekf_companion.fleet.load import load

    def of(name: str) -> Any:
        is_table = dataset.is_place(name) or Path(name).is_file()
        return load(name) if is_table else load(table, of=name)

    with terminal.exit_on_error():
        _answer(questions.compare(of(before), of(after)), out, as_json)


@fleet.command("sql")
def fleet_sql(
    table: TableArgument,
    query: Annotated[str, typer.Argument(help="SELECT ... FROM logs, events, histograms.")],
    of: OfOption = "",
    out: OutOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Answer a question in SQL."""
    from ekf_companion.fleet import sql
    from ekf_companion.fleet.load import load

    with terminal.exit_on_error():
        _answer(sql.run(query, lambda name: load(table, name, of)), out, as_json)


@fleet.command("export")
def fleet_export(
    table: TableArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="A .csv or .parquet.")],
    name: Annotated[str, typer.Option("--table", help="logs, events or histograms.")] = "logs",
    of: OfOption = "",
) -> None:
    """Write a table of a data set as one file, ordered by log."""
    from ekf_companion.fleet.dataset import TABLES
    from ekf_companion.fleet.load import export, load

    with terminal.exit_on_error():
        if name not in TABLES:
            raise ConfigError(f"--table: {name}: is none of {', '.join(TABLES)}")
        export(load(table, name, of), out)


@fleet.command("report")
def fleet_report(
    table: TableArgument,
    out: Annotated[Path, typer.Option("--out", "-o", help="The .html file.")],
    reports: Annotated[
        Path | None, typer.Option(help="Folder of the logs' reports, LOG.html, to link to.")
    ] = None,
    of: OfOption = "",
) -> None:
    """Show a fleet in one HTML file: verdicts, distributions, faults by group and log."""
    from ekf_companion.fleet import page
    from ekf_companion.fleet.dataset import TABLES
    from ekf_companion.fleet.load import load

    with terminal.exit_on_error():
        terminal.check_outputs({}, [("--out", out)])
        page.write(out, table, {name: load(table, name, of) for name in TABLES}, reports)


@fleet.command("tune")
def fleet_tune(
    logs: Annotated[
        list[str], typer.Argument(help="Flights of one vehicle: logs, folders, lists, as in batch.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the keys to this .yaml instead.")
    ] = None,
    config: terminal.ConfigOption = None,
    jobs: terminal.JobsOption = 1,
    dask: terminal.DaskOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Tune noise, GNSS delay and lever arm to the flights of one vehicle: YAML to paste."""
    from ekf_companion.calibrate.result import lines
    from ekf_companion.fleet import tune, tuned_settings
    from ekf_companion.fleet.listing import Listing
    from ekf_companion.logs.writer import create

    with terminal.exit_on_error():
        found = list(Listing(logs))
        inputs: dict[str, Path | None] = {f"the log {log.name}": Path(log.place) for log in found}
        terminal.check_outputs({**inputs, "the configuration": config}, [("--out", out)])
        settings = terminal.load(config)
        with progress_line(f"{len(found)} flights") as progress:
            fit = tune.tune(found, settings, terminal.executor(jobs, dask), progress)
        title = f"ekf-companion fleet tune, {fit.flights} of {len(found)} flights"
        result = tuned_settings.result(fit, settings)
        text = lines(title, result)
        if out is None or as_json:
            terminal.show(as_json, result.to_dict(title), text)
        if out is not None:
            with create(out) as file:
                file.write("\n".join([*text, ""]).encode())


def _answer(answer: Answer, out: Path | None, as_json: bool) -> None:
    """Print an answer, or write it as a table."""
    if out is None:
        terminal.show(as_json, answer.to_dict(), answer.lines())
        return
    from ekf_companion.fleet.load import export
    from ekf_companion.fleet.questions import to_arrow

    export(to_arrow(answer), out)
    for line in answer.notes:
        typer.echo(line)
