"""Figure of trajectories, as in the seed article: track, altitude, speed; roll, pitch, yaw.

It shows estimates over the reference and over the fixes. A third column, for several estimates that
would hide each other, shows the error of each.

Source of the layout: BasicEKF, run_state_estimation_ins_euler_directEKF_method.m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis import figure_file
from ekf_companion.analysis.gaps import parted, thinned
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps, known_rows
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import EULER, Trajectory
from ekf_companion.review import difference

POINTS = 20000
"""Largest number of points of a line: more than a figure can show."""
_COLOURS = ("#d62728", "#1f77b4", "#7f7f7f", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b")
_STYLES = ("-", "--", ":", "-.")
_FIXES = {"color": "#b0b0b0", "marker": ".", "linestyle": "", "markersize": 3, "label": "fixes"}
_PANELS = {
    "track": (slice(0, 6), 0, "north-east track", "east, m", "north, m"),
    "altitude": (slice(6, 9), 0, "altitude", "time, s", "above mean sea level, m"),
    "speed": (slice(9, 12), 0, "speed", "time, s", "m/s"),
    "roll": (slice(0, 4), 1, "roll", "time, s", "deg"),
    "pitch": (slice(4, 8), 1, "pitch", "time, s", "deg"),
    "yaw": (slice(8, 12), 1, "yaw", "time, s", "deg"),
    "position error": (slice(0, 4), 2, "horizontal error", "time, s", "m"),
    "velocity error": (slice(4, 8), 2, "velocity error", "time, s", "m/s"),
    "attitude error": (slice(8, 12), 2, "attitude error", "time, s", "deg"),
}
"""Of each panel: rows of twelve, column, title and labels."""
_ATTITUDE_PANELS = {
    "roll": (slice(0, 6), 0, *_PANELS["roll"][2:]),
    "pitch": (slice(0, 6), 1, *_PANELS["pitch"][2:]),
    "yaw": (slice(6, 12), 0, *_PANELS["yaw"][2:]),
    "attitude error": (slice(6, 12), 1, *_PANELS["attitude error"][2:]),
}
"""The panels for attitude alone."""


@dataclass(frozen=True, slots=True, eq=False)
class _Scale:
    """Origin of the axes."""

    frame: LocalFrame | None
    """None: no trajectory has a position."""
    zero_ns: int

    def seconds(self, t_ns: Stamps) -> Array:
        return np.asarray((t_ns - self.zero_ns) * 1e-9)


def plot(
    path: Path,
    trajectories: Sequence[Trajectory],
    title: str = "",
    *,
    events: Events | None = None,
    with_errors: bool = False,
    jumps_ns: Sequence[int] = (),
) -> None:
    """Draw trajectories over each other into a PNG, PDF or SVG file, the reference last.

    North and east are from the first position of the last trajectory that has one. The fixes among
    the events are drawn as points; a further column shows the distance of each from the last.
    No line is drawn through a gap, nor is the first one's track where it jumped.

    Raises:
        CompanionError: matplotlib is not installed, or the file cannot be written.
    """
    placed = [one for one in trajectories if len(one.pos_t_ns)]
    frame = LocalFrame(float(placed[-1].lat[0]), float(placed[-1].lon[0]), 0.0) if placed else None
    starts = [t[0] for one in trajectories for t in (one.pos_t_ns, one.att_t_ns) if len(t)]
    scale = _Scale(frame, int(min(starts)))
    columns = 3 if with_errors and frame is not None else 2

    def draw(sheet: Any) -> None:
        places = _ATTITUDE_PANELS if frame is None else _PANELS
        axes = figure_file.panels(sheet, 12, columns, places)
        if events is not None and frame is not None:
            _draw_fixes(axes, events, scale)
        for index, one in enumerate(trajectories):
            # The estimate is drawn on top of what it is compared with
            look = {
                "color": _COLOURS[index % len(_COLOURS)],
                "linestyle": _STYLES[index % len(_STYLES)],
                "linewidth": 1.2,
                "zorder": 20 - index,
                "label": one.name,
            }
            _draw(axes, one, scale, look, jumps_ns if index == 0 else ())
            if with_errors and one is not trajectories[-1]:
                _draw_errors(axes, one, trajectories[-1], scale, look)
        if "track" in axes:
            axes["track"].set_aspect("equal", adjustable="datalim")
        handles, names = axes["track" if "track" in axes else "roll"].get_legend_handles_labels()
        sheet.legend(handles, names, loc="outside lower center", ncols=min(4, len(names)))

    figure_file.write(path, title, draw, width=6.0 * columns, height=10.0)


def _draw_fixes(axes: dict[str, Any], events: Events, scale: _Scale) -> None:
    assert scale.frame is not None
    is_known = known_rows(events.values[:, :3])
    fixes = events.take((events.kind == Kind.GNSS) & is_known)
    seconds, values = scale.seconds(fixes.t_ns), fixes.values
    ned = scale.frame.to_ned(values[:, 0], values[:, 1], values[:, 2])
    axes["track"].plot(ned[:, 1], ned[:, 0], **_FIXES)
    axes["altitude"].plot(seconds, values[:, 2], **_FIXES)
    speed = np.linalg.norm(np.nan_to_num(values[:, 3:6]), axis=1)
    # Without the vertical part it would be the horizontal speed
    is_whole = known_rows(values[:, 3:6])
    axes["speed"].plot(seconds, np.where(is_whole, speed, np.nan), **_FIXES)


def _draw(
    axes: dict[str, Any],
    one: Trajectory,
    scale: _Scale,
    look: dict[str, Any],
    jumps_ns: Sequence[int],
) -> None:
    if scale.frame is not None and len(one.pos_t_ns):
        rows, is_end = thinned(one.pos_t_ns, POINTS, jumps_ns)
        ned = scale.frame.to_ned(one.lat[rows], one.lon[rows], one.alt[rows])
        axes["track"].plot(*parted(is_end, ned[:, 1], ned[:, 0]), **look)
        _draw_line(axes["altitude"], one.pos_t_ns, one.alt, scale, look)
    if "speed" in axes:
        speed = np.linalg.norm(np.nan_to_num(one.vel_n), axis=1)
        _draw_line(axes["speed"], one.vel_t_ns, speed, scale, look)
    angles = np.rad2deg(so3.to_euler(one.q_nb))
    for column, name in enumerate(EULER):
        # No line across the panel where an angle goes from 180 to -180 degrees
        turns = np.flatnonzero(np.abs(np.diff(angles[:, column])) > 180.0) + 1
        turned_ns = one.att_t_ns[turns].tolist()
        _draw_line(axes[name], one.att_t_ns, angles[:, column], scale, look, turned_ns)


def _draw_line(
    panel: Any,
    t_ns: Stamps,
    values: Array,
    scale: _Scale,
    look: dict[str, Any],
    jumps_ns: Sequence[int] = (),
) -> None:
    """Draw a line over time, with an end at each gap and jump."""
    rows, is_end = thinned(t_ns, POINTS, jumps_ns)
    x, y = parted(is_end, scale.seconds(t_ns[rows]), values[rows])
    panel.plot(x, y, **look)


def _draw_errors(
    axes: dict[str, Any], one: Trajectory, other: Trajectory, scale: _Scale, look: dict[str, Any]
) -> None:
    def draw(name: str, t_ns: Stamps, size: Array) -> None:
        if name in axes:
            axes[name].set_yscale("log")
            _draw_line(axes[name], t_ns, size, scale, look)

    if scale.frame and (found := difference.in_position(one, other, frame=scale.frame)):
        draw("position error", found[0], np.hypot(found[1][:, 0], found[1][:, 1]))
    if found := difference.in_velocity(one, other):
        draw("velocity error", found[0], np.linalg.norm(np.nan_to_num(found[1]), axis=1))
    if turned := difference.in_attitude(one, other):
        t_ns, mine, theirs = turned
        turn = so3.log(so3.multiply(so3.conjugate(mine), theirs))
        draw("attitude error", t_ns, np.rad2deg(np.linalg.norm(turn, axis=1)))
