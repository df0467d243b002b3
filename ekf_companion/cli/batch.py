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
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 1,
) -> None:
    """Estimate from many logs; write one table with a row for each."""
    from ekf_companion.analysis import batch as examination
    from ekf_companion.analysis import batch_run, batch_table

    with terminal.exit_on_error():
        found = examination.find_logs(logs)
        inputs: dict[str, Path | None] = {f"the log {log}": log for log in found}
        outputs: list[tuple[str, Path | None]] = [("--out", out) for out in outs]
        terminal.check_outputs({**inputs, "the configuration": config}, outputs)
        for out in outs:
            batch_table.check(out)
        journal = outs[0].with_name(f"{outs[0].name}.journal")
        with progress_line(f"{len(found)} logs") as progress:
            executor = batch_run.Processes(jobs)
            rows = batch_run.run(found, terminal.load(config), journal, executor, progress)
        for out in outs:
            batch_table.write(out, rows)
        journal.unlink()  # the table is complete
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    for line in batch_table.lines(rows, width):
        typer.echo(line)
    if words := examination.left_out(logs, [*found, *outs]):
        typer.echo(words)
