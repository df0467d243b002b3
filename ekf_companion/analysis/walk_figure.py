"""Figure of walks: track and height with the stances, and each filter's stances over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis import closure, figure_file
from ekf_companion.errors import CompanionError
from ekf_companion.filters.solution import Solution
from ekf_companion.nav.state import POSITION, VELOCITY

_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#7f7f7f")
FASTEST = 0.5
"""Largest speed shown beside the stances, m/s: what matters is how close they come to 0."""


def plot(path: Path, solutions: Sequence[Solution], title: str) -> None:
    """Draw walks over each other into a PNG, PDF or SVG file, without solutions of attitude alone.

    Raises:
        CompanionError: matplotlib is not installed, the file cannot be written, or no solution has
            a position.
    """
    walks = [one for one in solutions if np.isfinite(one.table.column("pos_n")).any()]
    if not walks:
        raise CompanionError(f"{path}: none of the filters has a position to draw")
    figure_file.write(path, title, lambda sheet: _draw_all(sheet, walks))


def _draw_all(sheet: Any, walks: Sequence[Solution]) -> None:
    places = {
        "track": (slice(0, 2), 0, "north-east track, stances marked", "east, m", "north, m"),
        "height": (0, 1, "height, stances marked", "time, s", "above the start, m"),
        "stance": (1, 1, "stances of each filter, and its speed", "time, s", "m/s"),
    }
    axes = figure_file.panels(sheet, 2, 2, places)
    zero_ns = int(min(one.table.stamp_ns[0] for one in walks))
    for index, one in enumerate(walks):
        _draw(axes, one, zero_ns, index)
    axes["track"].set_aspect("equal", adjustable="datalim")
    axes["stance"].set_ylim(-0.08 * len(walks), FASTEST)
    sheet.legend(*axes["height"].get_legend_handles_labels(), loc="outside lower center", ncols=1)


def _draw(axes: dict[str, Any], one: Solution, zero_ns: int, index: int) -> None:
    colour = _COLOURS[index % len(_COLOURS)]
    line = {"color": colour, "linewidth": 1.0, "zorder": 10 - index}
    seconds = (one.table.stamp_ns - zero_ns) * 1e-9
    north, east, down = one.table.columns(POSITION).T
    speed = np.linalg.norm(one.table.columns(VELOCITY), axis=1)
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
