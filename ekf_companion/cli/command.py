"""Checks that every command of ours and of the fake autopilot makes."""

from __future__ import annotations

import errno
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup


class Command(TyperCommand):
    """A command whose numeric options refuse NaN, which no range of an option does."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments of the command line.

        Raises:
            typer.BadParameter: One is wrong, or nan; the command line prints it.
        """
        left = super().parse_args(ctx, args)
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if isinstance(value, float) and math.isnan(value):
                raise typer.BadParameter("nan is no number", ctx=ctx, param=parameter)
        return left


class Group(TyperGroup):
    """Commands that end with a sentence if the standard output cannot be written."""

    def main(self, *args: Any, **options: Any) -> Any:
        """Run the command line."""
        with _exit_without_output(str(self.name or options.get("prog_name") or "")):
            return super().main(*args, **options)


@contextmanager
def _exit_without_output(name: str) -> Iterator[None]:
    """Exit with 3 and a sentence where the standard output has no room, as for any output."""
    try:
        try:
            yield
        finally:  # not at the end of the process, which names no cause
            if sys.stdout is not None:
                sys.stdout.flush()
    except OSError as error:
        if error.errno != errno.EPIPE and not _is_output_failing():
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # takes what is left in the buffer
        if error.errno == errno.EPIPE:  # its reader has seen enough
            raise SystemExit(1) from error
        with suppress(OSError):
            typer.echo(f"{name}: the standard output cannot be written: {error.strerror}", err=True)
        raise SystemExit(3) from error


def _is_output_failing() -> bool:
    """Return whether the standard output refuses even an empty line: errors do not name it."""
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False
