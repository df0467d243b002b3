"""Figure of walks: the track with its stances, the height, and when which filter saw the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis import closure
from ekf_companion.errors import CompanionError
from ekf_companion.filters.solution import Solution

_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#7f7f7f")
FASTEST = 0.5
"""Of the speeds shown beside the stances, m/s: what matters is how near nought they come."""


def plot(path: Path, solutions: Sequence[Solution], title: str) -> None:
    """Draw walks over each other into a PNG, PDF or SVG file; attitude alone is no walk.

    Raises:
        CompanionError: matplotlib is not installed, the file cannot be written, or no solution has
            a position.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise CompanionError(
            f"{path}: a figure needs matplotlib; install ekf-companion with the extra: plot"
        ) from None
    sheet = Figure(figsize=(12.0, 8.0), layout="constrained")
    FigureCanvasAgg(sheet)
    axes = dict(zip(("track", "height", "stance"), _panels(sheet), strict=True))
    solutions = [one for one in solutions if np.isfinite(one.table.column("pos_n")).any()]
    if not solutions:
        raise CompanionError(f"{path}: none of the filters has a position to draw")
    starts = [one.table.stamp_ns[0] for one in solutions]
    for index, one in enumerate(solutions):
        _draw(axes, one, int(min(starts)), index)
    labels = (
        ("track", "north-east track, stances marked", "east, m", "north, m"),
        ("height", "height, stances marked", "time, s", "above the start, m"),
        ("stance", "stances of each filter, and its speed", "time, s", "m/s"),
    )
    for name, said, across, up in labels:
        axes[name].set(title=said, xlabel=across, ylabel=up)
        axes[name].grid(visible=True, alpha=0.3)
    axes["track"].set_aspect("equal", adjustable="datalim")
    axes["stance"].set_ylim(-0.08 * max(len(solutions), 1), FASTEST)
    sheet.legend(*axes["height"].get_legend_handles_labels(), loc="outside lower center", ncols=1)
    sheet.suptitle(title)
    try:
        sheet.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise CompanionError(f"{path}: the figure cannot be written ({error})") from None


def _panels(sheet: Any) -> tuple[Any, Any, Any]:
    grid = sheet.add_gridspec(2, 2)
    return (
        sheet.add_subplot(grid[:, 0]),
        sheet.add_subplot(grid[0, 1]),
        sheet.add_subplot(grid[1, 1]),
    )


def _draw(axes: dict[str, Any], one: Solution, zero_ns: int, index: int) -> None:
    colour = _COLOURS[index % len(_COLOURS)]
    line = {"color": colour, "linewidth": 1.0, "zorder": 10 - index}
    seconds = (one.table.stamp_ns - zero_ns) * 1e-9
    north, east, down = (one.table.column(f"pos_{axis}") for axis in "ned")
    speed = np.linalg.norm([one.table.column(f"vel_{axis}") for axis in "ned"], axis=0)
    phases = closure.stances(one)
    middle = np.array([(first + last) // 2 for first, last in phases], dtype=np.int64)
    dots = {"color": colour, "marker": "o", "markersize": 3.5, "linestyle": "", "zorder": 20}
    end = closure.closure(one)
    name = f"{one.name}: closes to {end.horizontal:.3f} m, in space {end.distance:.3f} m"
    axes["track"].plot(east, north, **line)
    axes["track"].plot(east[middle], north[middle], **dots)
    axes["height"].plot(seconds, -down, label=name, **line)
    axes["height"].plot(seconds[middle], -down[middle], **dots)
    axes["stance"].plot(seconds, speed, **line)
    spans = [(seconds[first], seconds[last - 1] - seconds[first]) for first, last in phases]
    axes["stance"].broken_barh(spans, (-0.08 * index - 0.07, 0.06), facecolors=colour)
