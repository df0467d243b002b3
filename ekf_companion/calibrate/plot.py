"""One figure for each calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ekf_companion.errors import CompanionError

Draw = Callable[[Any], None]
"""Is given a matplotlib figure, and draws into it."""


def has_matplotlib() -> bool:
    """Whether figures can be drawn here."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        return False
    return True


def write(path: Path, title: str, draw: Draw) -> None:
    """Write a figure into a PNG, PDF or SVG file.

    Args:
        path: The file.
        title: Above the figure.
        draw: Is given a matplotlib figure, and draws into it.

    Raises:
        CompanionError: matplotlib is not installed, or the file cannot be written.
    """
    if not has_matplotlib():
        raise CompanionError(
            f"{path}: a figure needs matplotlib; install ekf-companion with the extra: plot"
        )
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(12.0, 8.0), layout="constrained")
    FigureCanvasAgg(sheet)
    draw(sheet)
    sheet.suptitle(title)
    try:
        sheet.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise CompanionError(f"{path}: the figure cannot be written ({error})") from None
