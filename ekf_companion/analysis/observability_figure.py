"""Figure of observability: sigmas and singular values over time, and the motion below them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis import figure_file
from ekf_companion.analysis.observability import OBSERVABLE, Observability
from ekf_companion.analysis.observability_report import summarise
from ekf_companion.nav import so3

_AXES = ("#d62728", "#2ca02c", "#1f77b4")
_BLOCKS = {
    "roll, pitch, heading": "#9467bd",
    "velocity": "#7f7f7f",
    "position": "#c7c7c7",
    "gyro bias": "#ff7f0e",
    "accelerometer bias": "#1f77b4",
}
"""Blocks of the error state, three elements each, and their colours."""
FLOOR = 1e-4
"""Least singular value that is drawn."""


def plot(path: Path, found: Observability, title: str = "") -> None:
    """Draw the figure into a PNG, PDF or SVG file.

    Raises:
        CompanionError: matplotlib is not installed, or the file cannot be written.
    """
    figure_file.write(path, title, lambda sheet: _draw(sheet, found), width=11.0, height=12.0)


def _draw(sheet: Any, found: Observability) -> None:
    axes = sheet.subplots(5, 1, sharex=True, height_ratios=(3, 3, 2, 3, 2))
    _draw_sigmas(axes[0], found, 12, "accelerometer bias")
    _draw_sigmas(axes[1], found, 9, "gyro bias")
    _draw_sigmas(axes[2], found, 0, "")
    _draw_singular(axes[3], found)
    _draw_motion(axes[4], found)
    for axis in axes:
        axis.grid(visible=True, alpha=0.3)
        axis.legend(loc="upper right", fontsize=8, ncols=5)
    axes[4].set(xlabel="time since the first inertial sample, s", xlim=(0.0, found.t[-1]))


def _draw_sigmas(axis: Any, found: Observability, first: int, name: str) -> None:
    """Draw the sigmas of three states, in units, and mark when each becomes observable."""
    known = {one.state: one.since for one in summarise(found)}
    names = [f"{name.split()[0]} {a} bias" for a in "xyz"] if name else ["roll", "pitch", "heading"]
    # Forward and right are often equal: the first is drawn wider
    looks = zip(names, _AXES, (3.0, 1.2, 1.2), strict=True)
    for column, (state, colour, width) in enumerate(looks, first):
        since = known[state]
        when = "never" if since is None else f"{since:.1f} s"
        look = {"color": colour, "linewidth": width}
        axis.plot(found.t, found.sigma[:, column], **look, label=f"{state}: {when}")
        axis.plot(found.t, found.window_sigma[:, column], **look, linestyle=":", alpha=0.8)
        if since is not None:
            axis.axvline(since, color=colour, linewidth=0.8, alpha=0.7)
    axis.axhline(OBSERVABLE, color="#7f7f7f", linestyle="--", linewidth=1.0)
    axis.set(yscale="log", ylabel="sigma over unit")
    axis.set_title(
        f"{name or 'attitude'}: by the flight until then (line), by the window of "
        f"{found.window:g} s before (dotted); dashed: observable",
        fontsize=9,
    )


def _draw_singular(axis: Any, found: Observability) -> None:
    """Draw the singular values, coloured by the block with the largest share of the direction."""
    shares = np.square(found.direction).reshape(*found.direction.shape[:2], 5, 3).sum(axis=3)
    block = np.argmax(np.nan_to_num(shares), axis=2)
    times = np.broadcast_to(found.t[:, None], found.singular.shape)
    for index, (name, colour) in enumerate(_BLOCKS.items()):
        chosen = (block == index) & np.isfinite(found.singular)
        values = np.maximum(found.singular[chosen], FLOOR)
        axis.plot(times[chosen], values, ".", color=colour, markersize=2.5, label=name)
    axis.axhline(1.0, color="#7f7f7f", linestyle="--", linewidth=1.0)
    axis.set(yscale="log", ylabel="singular value")
    axis.set_title(
        f"Gramian of the window of {found.window:g} s that ends then; 1: as much as was known "
        "before; colour: most of the direction",
        fontsize=9,
    )


def _draw_motion(axis: Any, found: Observability) -> None:
    motion = found.motion
    yaw = np.degrees(so3.wrap(motion.yaw))
    # No line across the panel where it goes from 180 to -180 degrees
    yaw[1:][np.abs(np.diff(yaw)) > 180.0] = np.nan
    axis.plot(motion.t, yaw, color="#9467bd", linewidth=1.0, label="yaw")
    axis.plot(motion.t, np.degrees(motion.tilt), color="#8c564b", label="tilt from the start")
    axis.set(ylabel="deg")
    right = axis.twinx()
    right.plot(motion.t, motion.speed, color="#2ca02c", linewidth=1.0, label="speed, m/s")
    right.plot(
        motion.t, motion.acceleration, color="#d62728", linewidth=0.8, label="acceleration, m/s²"
    )
    right.set(ylabel="m/s, m/s²")
    right.legend(loc="upper left", fontsize=8, ncols=2)
