"""The seed article's figure: track, altitude, speed, roll, pitch and yaw, estimate on reference.

Where several estimates lie on each other a third row shows how far each is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ekf_companion.errors import CompanionError
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.pairing import Pair, pair
from ekf_companion.nav.state import Trajectory

POINTS = 20000
"""Of each line at most: more than a picture can show."""
_COLOURS = ("#d62728", "#1f77b4", "#7f7f7f", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b")
_STYLES = ("-", "--", ":", "-.")


def plot(
    path: Path, trajectories: Sequence[Trajectory], title: str = "", *, with_errors: bool = False
) -> None:
    """Draw trajectories over each other, the estimate first, into a PNG, PDF or SVG file.

    North and east are about the first position of the last trajectory: of the reference.

    Args:
        path: The figure; its suffix says what it is.
        trajectories: The reference last.
        title: Of the figure.
        with_errors: Add a row with the distance of each from the last.

    Raises:
        CompanionError: matplotlib is not installed, or the file cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise CompanionError(
            f"{path}: a figure needs matplotlib; install ekf-companion with the extra: plot"
        ) from None
    rows = 3 if with_errors else 2
    sheet = Figure(figsize=(12.0, 4.0 * rows), layout="constrained")
    FigureCanvasAgg(sheet)
    axes = sheet.subplots(rows, 3)
    ends = [one for one in reversed(trajectories) if len(one.pos_t_ns)]
    frame = LocalFrame(float(ends[0].lat[0]), float(ends[0].lon[0]), 0.0) if ends else None
    starts = [t[0] for one in trajectories for t in (one.pos_t_ns, one.att_t_ns) if len(t)]
    for index, one in enumerate(trajectories):
        look = {
            "color": _COLOURS[index % len(_COLOURS)],
            "linestyle": _STYLES[index % len(_STYLES)],
            "linewidth": 1.2,
            # The estimate stays on top of what it is compared with.
            "zorder": 10 - index,
            "label": one.name,
        }
        _draw(axes, one, frame, min(starts), look)
        if with_errors and one is not trajectories[-1]:
            _draw_errors(axes[2], one, trajectories[-1], min(starts), look)
    labels = (
        ("north-east track", "east, m", "north, m"),
        ("altitude", "time, s", "above mean sea level, m"),
        ("speed", "time, s", "m/s"),
        ("roll", "time, s", "deg"),
        ("pitch", "time, s", "deg"),
        ("yaw", "time, s", "deg"),
        ("horizontal error", "time, s", "m"),
        ("velocity error", "time, s", "m/s"),
        ("attitude error", "time, s", "deg"),
    )
    for axis, (name, across, up) in zip(axes.flat, labels, strict=False):
        axis.set(title=name, xlabel=across, ylabel=up)
        axis.grid(visible=True, alpha=0.3)
    axes[0, 0].set_aspect("equal", adjustable="datalim")
    handles, names = axes[1, 0].get_legend_handles_labels()
    sheet.legend(handles, names, loc="outside lower center", ncols=1)
    sheet.suptitle(title)
    try:
        sheet.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise CompanionError(f"{path}: the figure cannot be written ({error})") from None


def _draw(
    axes: Any, one: Trajectory, frame: LocalFrame | None, zero_ns: int, look: dict[str, Any]
) -> None:
    if frame is not None and len(one.pos_t_ns):
        some = _some(one.pos_t_ns)
        ned = frame.to_ned(one.lat[some], one.lon[some], one.alt[some])
        axes[0, 0].plot(ned[:, 1], ned[:, 0], **look)
        axes[0, 1].plot((one.pos_t_ns[some] - zero_ns) * 1e-9, one.alt[some], **look)
    some = _some(one.vel_t_ns)
    speed = np.linalg.norm(np.nan_to_num(one.vel_n[some]), axis=1)
    axes[0, 2].plot((one.vel_t_ns[some] - zero_ns) * 1e-9, speed, **look)
    some = _some(one.att_t_ns)
    seconds = (one.att_t_ns[some] - zero_ns) * 1e-9
    angles = np.rad2deg(so3.to_euler(one.q_nb[some]))
    for axis in range(3):
        # No line across the picture where an angle goes from 180 to -180 degrees.
        turned = np.append(np.abs(np.diff(angles[:, axis])) > 180.0, False)
        axes[1, axis].plot(seconds, np.where(turned, np.nan, angles[:, axis]), **look)


def _draw_errors(
    axes: Any, one: Trajectory, other: Trajectory, zero_ns: int, look: dict[str, Any]
) -> None:
    end = np.iinfo(np.int64).max
    errors: list[tuple[Pair | None, Any]] = []
    if found := pair(one.pos_t_ns, other.pos_t_ns, 0, end):
        frame = LocalFrame(float(other.lat[0]), float(other.lon[0]), 0.0)
        mine, theirs = (frame.to_ned(each.lat, each.lon, each.alt) for each in (one, other))
        errors.append((found, np.linalg.norm(found.difference(mine, theirs)[:, :2], axis=1)))
    else:
        errors.append((None, None))
    found = pair(one.vel_t_ns, other.vel_t_ns, 0, end)
    size = found and np.linalg.norm(np.nan_to_num(found.difference(one.vel_n, other.vel_n)), axis=1)
    errors.append((found, size))
    if found := pair(one.att_t_ns, other.att_t_ns, 0, end):
        mine, theirs = found.rotations(one.q_nb, other.q_nb)
        turn = so3.log(so3.multiply(so3.conjugate(mine), theirs))
        errors.append((found, np.rad2deg(np.linalg.norm(turn, axis=1))))
    for axis, (at, size) in zip(axes, errors, strict=False):
        if at is not None:
            some = _some(at.at_ns)
            axis.plot((at.at_ns[some] - zero_ns) * 1e-9, size[some], **look)
            axis.set_yscale("log")


def _some(t_ns: npt.NDArray[np.int64]) -> slice:
    return slice(None, None, max(1, len(t_ns) // POINTS))
