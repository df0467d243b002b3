"""Figures as files: a matplotlib figure is opened, drawn into and saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ekf_companion.errors import CompanionError

Draw = Callable[[Any], None]
"""Draws into a matplotlib figure."""


def has_matplotlib() -> bool:
    """Return whether figures can be drawn here."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        return False
    return True


def write(path: Path, title: str, draw: Draw, *, width: float = 12.0, height: float = 8.0) -> None:
    """Draw a figure into a PNG, PDF or SVG file; its size is in inches.

    Raises:
        CompanionError: matplotlib is not installed, or the file cannot be written.
    """
    if not has_matplotlib():
        raise CompanionError(
            f"{path}: a figure needs matplotlib; install ekf-companion with the extra: plot"
        )
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(sheet)
    draw(sheet)
    sheet.suptitle(title)
    try:
        sheet.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise CompanionError(f"{path}: the figure cannot be written ({error})") from None
