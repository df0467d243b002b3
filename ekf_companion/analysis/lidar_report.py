"""A report on the way of a lidar as one HTML file: track and map, sigmas, holds, innovations."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis.report_page import assembled
from ekf_companion.analysis.report_sheet import POINTS, TALL, Sheet, place_legend
from ekf_companion.errors import part_of
from ekf_companion.lidar.solution import Solution
from ekf_companion.lidar.state import ATT, POS, VEL
from ekf_companion.logs.writer import create
from ekf_companion.nav.arrays import Array, Stamps

_WAY, _MAP, _OPEN = "#c0392b", "#b2babb", "#dc7633"
_AXES = ("#c0392b", "#1e8449", "#2874a6")


def write(path: Path, solution: Solution) -> None:
    """Write the report.

    Raises:
        CompanionError: Bokeh is not installed.
        LogError: The file cannot be written.
    """
    text = page(solution)
    with create(path) as file:
        file.write(text.encode())


def page(solution: Solution) -> str:
    """Return the report on a solution with one estimate or more.

    Raises:
        MissingPackageError: Bokeh is not installed.
    """
    t_ns = np.round(solution.poses[:, 0] * 1e9).astype(np.int64)
    with part_of("report", "--report"):
        sheet = Sheet(int(t_ns[0]), (), int(t_ns[-1]))
    verdict = solution.verdict()
    sections = [
        ("Track and map", [_seen(solution, sheet, 0, 1), _seen(solution, sheet, 0, 2)]),
        ("Velocity, and sigmas since the first pose", _sigmas(solution, sheet, t_ns)),
        ("Directions without hold", _holds(solution, sheet, t_ns)),
        ("What the filter made of the scans", _matches(solution, sheet, t_ns)),
    ]
    span = float(solution.poses[-1, 0] - solution.poses[0, 0])
    said = escape("\n".join(solution.remarks()))
    return assembled(
        sheet,
        sections,
        name=solution.name,
        when=f"{span:.0f} s, {len(solution.track)} scans",
        grade=verdict.partition(":")[0],
        verdict=verdict,
        head="",
        tail=f"<h2>What was decided and found</h2><pre>{said}</pre>",
    )


def _seen(solution: Solution, sheet: Sheet, across: int, up: int) -> Any:
    """Return track and map as seen along the axis that is left."""
    names = ("x, m", "y, m", "z, m")
    title = "from above" if up == 1 else "from the side"
    options = {"match_aspect": True, "height": TALL}
    plot = sheet.figure(title, names[up], across=names[across], **options)
    points = solution.points[:: -(-len(solution.points) // POINTS) or 1]
    if len(points):
        look = {"size": 2, "color": _MAP, "legend_label": "map"}
        plot.scatter(points[:, across], points[:, up], **look)
    poses = solution.poses
    place = poses[:, 1:4]
    is_open = np.zeros(len(poses), dtype=bool)
    for one in solution.open_stretches():
        is_open |= (poses[:, 0] >= one.start) & (poses[:, 0] <= one.end)
    plot.line(place[:, across], place[:, up], line_color=_WAY, line_width=1.6, legend_label="way")
    if is_open.any():
        some = place[is_open]
        look = {"size": 4, "color": _OPEN, "legend_label": "without hold"}
        plot.scatter(some[:, across], some[:, up], **look)
    place_legend(plot)
    return plot


def _three(names: str, values: Array, t_ns: Stamps) -> list[tuple[str, Stamps, Array, str]]:
    """Return a line for each of three axes."""
    return [(name, t_ns, values[:, k], _AXES[k]) for k, name in enumerate(names.split())]


def _sigmas(solution: Solution, sheet: Sheet, t_ns: Stamps) -> list[Any]:
    vel = solution.track.vel_w @ solution.C_level.T
    return [
        *sheet.lines("velocity", "m/s", _three("x y z", vel, t_ns)),
        *sheet.lines("sigma of position", "m", _three("x y z", solution.sigmas(POS), t_ns)),
        *sheet.lines("sigma of velocity", "m/s", _three("x y z", solution.sigmas(VEL), t_ns)),
        *sheet.lines(
            "sigma of attitude",
            "deg",
            _three("roll pitch yaw", np.degrees(solution.sigmas(ATT)), t_ns),
        ),
    ]


def _holds(solution: Solution, sheet: Sheet, t_ns: Stamps) -> list[Any]:
    """Return what a scan by itself holds: of the three directions the least held one first."""
    track, names = solution.track, "least middle most"
    return [
        *sheet.lines("share that is more than noise", "", _three(names, track.hold, t_ns)),
        *sheet.lines("directions without hold", "", [("of three", t_ns, track.open_axes, _OPEN)]),
    ]


def _matches(solution: Solution, sheet: Sheet, t_ns: Stamps) -> list[Any]:
    track = solution.track
    return [
        *sheet.lines("points used", "", [("used", t_ns, track.used, _WAY)]),
        *sheet.lines("innovations in their sigmas, RMS", "", [("RMS", t_ns, track.rms, _WAY)]),
        *sheet.lines(
            "evaluations of the update", "", [("evaluations", t_ns, track.evaluations, _WAY)]
        ),
    ]
