"""Figures as files: a matplotlib figure is opened, drawn into and saved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import chain
from pathlib import Path
from textwrap import wrap
from typing import Any

from ekf_companion.errors import CompanionError, MissingPackageError, remedy
from ekf_companion.logs.writer import create

LETTERS = 9
"""Of a title, to an inch: as many fit in the widest case."""
LINE = 0.25
"""By which each further line of a title makes a figure higher, inches."""

Draw = Callable[[Any], None]
"""Draws into a matplotlib figure."""


def has_matplotlib() -> bool:
    """Return whether figures can be drawn here."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        return False
    return True


def panels(
    sheet: Any, rows: int, columns: int, places: Mapping[str, tuple[Any, ...]]
) -> dict[str, Any]:
    """Return axes by name on a grid; each has its rows, its column, a title and two labels."""
    grid = sheet.add_gridspec(rows, columns)
    axes = {}
    for name, (row, column, title, across, up) in places.items():
        if column < columns:
            axes[name] = sheet.add_subplot(grid[row, column])
            axes[name].set(title=title, xlabel=across, ylabel=up)
            axes[name].grid(visible=True, alpha=0.3)
    return axes


def write(path: Path, title: str, draw: Draw, *, width: float = 12.0, height: float = 8.0) -> None:
    """Draw a figure into a PNG, PDF or SVG file; its size is in inches, a long title is wrapped.

    Raises:
        MissingPackageError: matplotlib is not installed.
        CompanionError: The file cannot be written.
    """
    if not has_matplotlib():
        raise MissingPackageError(
            f"{path}: a figure needs matplotlib, which is not installed: {remedy('plot')}"
        )
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wrapped = [wrap(line, int(LETTERS * width)) for line in title.splitlines()]
    lines = list(chain.from_iterable(wrapped))
    height += LINE * max(len(lines) - 1, 0)
    sheet = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(sheet)
    draw(sheet)
    sheet.suptitle("\n".join(lines))
    try:
        with create(path) as file:
            sheet.savefig(file, format=path.suffix[1:] or "png", dpi=110)
    except (OSError, ValueError) as error:
        raise CompanionError(f"{path}: the figure cannot be written ({error})") from None
