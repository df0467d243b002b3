"""What every command of ours and of the fake autopilot refuses."""

from __future__ import annotations

import math
from typing import Any

import typer
from typer.core import TyperCommand


class Command(TyperCommand):
    """A command whose numbers are numbers: no range of an option refuses nan."""

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
