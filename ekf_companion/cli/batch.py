"""Examine many logs."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line
from ekf_companion.errors import ConfigError

if TYPE_CHECKING:
    from ekf_companion.fleet.executor import Executor


def batch(
    logs: Annotated[
        list[str], typer.Argument(help="Logs, folders with logs, patterns such as 'flights/*.bin'.")
    ],
    outs: Annotated[
        list[str],
        typer.Option(
            "--out",
            "-o",
            help="The table: .csv or .parquet, or both; or a data set: FOLDER/, s3://...",
        ),
    ],
    config: terminal.ConfigOption = None,
    jobs: terminal.JobsOption = 1,
    dask: terminal.DaskOption = None,
) -> None:
    """Estimate from many logs; write one table with a row for each."""
    from ekf_companion.fleet import dataset, run, table
    from ekf_companion.fleet.folder import left_out
    from ekf_companion.fleet.listing import Listing

    with terminal.exit_on_error():
        if any(map(dataset.is_place, outs)):
            _fill(logs, outs, config, terminal.executor(jobs, dask))
            return
        files = [Path(out) for out in outs]
        found = list(Listing(logs))
        inputs: dict[str, Path | None] = {f"the log {log.name}": Path(log.place) for log in found}
        outputs: list[tuple[str, Path | None]] = [("--out", file) for file in files]
        terminal.check_outputs({**inputs, "the configuration": config}, outputs)
        for file in files:
            table.check(file)
        journal = files[0].with_name(f"{files[0].name}.journal")
        executor = terminal.executor(jobs, dask)
        with progress_line(f"{len(found)} logs") as progress:
            rows = run.run(found, terminal.load(config), journal, executor, progress)
        for file in files:
            table.write(file, rows)
        if all(row["outcome"] != "unread" for row in rows):
            journal.unlink()  # the table is complete
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for line in table.lines(rows, width):
        typer.echo(line)
    if words := left_out(logs, [*(Path(log.place) for log in found), *files]):
        typer.echo(words)


def _fill(logs: list[str], outs: list[str], config: Path | None, executor: Executor) -> None:
    """Estimate into a data set."""
    from ekf_companion.fleet import campaign
    from ekf_companion.fleet.listing import Listing

    if len(outs) > 1:
        raise ConfigError(
            "--out: a data set is written alone; `ekf-companion fleet export` makes a table of it"
        )
    with progress_line("logs") as progress:
        account = campaign.run(Listing(logs), terminal.load(config), outs[0], executor, progress)
    for line in account.lines():
        typer.echo(line)
    if account.outcomes["unread"]:
        raise typer.Exit(3)
