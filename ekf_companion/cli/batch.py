"""Examine many logs."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from ekf_companion.cli import terminal
from ekf_companion.cli.progress import progress_line


def batch(
    logs: Annotated[
        list[str], typer.Argument(help="Logs, folders with logs, patterns such as 'flights/*.bin'.")
    ],
    outs: Annotated[
        list[Path], typer.Option("--out", "-o", help="The table: .csv or .parquet; or both.")
    ],
    config: terminal.ConfigOption = None,
    jobs: terminal.JobsOption = 1,
    dask: terminal.DaskOption = None,
) -> None:
    """Estimate from many logs; write one table with a row for each."""
    from ekf_companion.fleet import run, table
    from ekf_companion.fleet.folder import left_out
    from ekf_companion.fleet.listing import Listing

    with terminal.exit_on_error():
        found = list(Listing(logs))
        inputs: dict[str, Path | None] = {f"the log {log.name}": Path(log.place) for log in found}
        outputs: list[tuple[str, Path | None]] = [("--out", out) for out in outs]
        terminal.check_outputs({**inputs, "the configuration": config}, outputs)
        for out in outs:
            table.check(out)
        journal = outs[0].with_name(f"{outs[0].name}.journal")
        executor = terminal.executor(jobs, dask)
        with progress_line(f"{len(found)} logs") as progress:
            rows = run.run(found, terminal.load(config), journal, executor, progress)
        for out in outs:
            table.write(out, rows)
        if all(row["outcome"] != "unread" for row in rows):
            journal.unlink()  # the table is complete
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for line in table.lines(rows, width):
        typer.echo(line)
    if words := left_out(logs, [*(Path(log.place) for log in found), *outs]):
        typer.echo(words)
