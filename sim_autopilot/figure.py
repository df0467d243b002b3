"""The figure of a flight: the estimate over the truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.logs.writer import create
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array
from sim_autopilot.flight import Flight
from sim_autopilot.score import Estimate, Witness
from sim_autopilot.truth import Truth

_TRUTH = {"color": "#9aa5b1", "linewidth": 4.0, "solid_capstyle": "round", "label": "truth"}
_ESTIMATE = {"color": "#d1495b", "linewidth": 1.3, "label": "ODOMETRY received"}
_FIXES = {"color": "#2e86ab", "marker": ".", "markersize": 3.5, "linestyle": "", "alpha": 0.55}


def draw(path: Path, flight: Flight, witness: Witness, score: dict[str, Any]) -> None:
    """Draw track, altitude, speed, roll, pitch and yaw into a file.

    Raises:
        ImportError: matplotlib is not installed (the extra ``plot``).
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    truth = flight.trajectory.at(flight.imu.t[::5])
    t = truth.t - flight.imu.t[0]
    estimate = witness.estimate()

    figure = Figure(figsize=(13.0, 7.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    for axis in axes.flat:
        axis.grid(color="#e4e7eb", linewidth=0.8)
        axis.set_axisbelow(True)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(color="#9aa5b1", labelcolor="#3e4c59")

    _draw_track(axes[0, 0], flight, truth, estimate)
    axes[0, 0].set_title(_title("Track", score, "horizontal_m", "m"), loc="left", fontsize=11)
    for axis, (key, title, unit, true, seen) in zip(
        axes.flat[1:], _panels(flight, truth, estimate), strict=True
    ):
        axis.plot(t, _broken(true, unit), **_TRUTH)
        axis.plot(estimate.t, _broken(seen, unit), **_ESTIMATE)
        axis.set_title(_title(title, score, key, unit), loc="left", fontsize=11)
        axis.set_xlabel("time, s")
        axis.set_ylabel(unit)
        axis.set_xlim(0.0, float(t[-1]))

    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle(
        f"{flight.scenario.name}: {flight.duration:.0f} s over UDP, "
        f"IMU {flight.config.imu.rate:.0f} Hz, GNSS {flight.config.gnss.rate:.0f} Hz",
        x=0.01,
        ha="left",
        fontsize=13,
        fontweight="bold",
    )
    with create(path) as file:
        figure.savefig(file, format=path.suffix[1:] or "png", dpi=110)


def _draw_track(axis: Any, flight: Flight, truth: Truth, estimate: Estimate) -> None:
    fixes = flight.trajectory.frame.to_ned(flight.gnss.lat, flight.gnss.lon, flight.gnss.alt)
    axis.plot(fixes[:, 1], fixes[:, 0], **_FIXES, label="GNSS fixes")
    axis.plot(truth.pos_n[:, 1], truth.pos_n[:, 0], **_TRUTH)
    axis.plot(estimate.pos_n[:, 1], estimate.pos_n[:, 0], **_ESTIMATE)
    axis.set_aspect("equal", adjustable="datalim")
    axis.set_xlabel("east, m")
    axis.set_ylabel("north, m")


def _panels(
    flight: Flight, truth: Truth, estimate: Estimate
) -> Iterator[tuple[str, str, str, Array, Array]]:
    """Yield key of the score, title, unit, truth and estimate of each panel over time."""
    alt = flight.trajectory.frame.alt - estimate.pos_n[:, 2]
    yield "vertical_m", "Altitude", "m", truth.alt, alt
    true, seen = (np.linalg.norm(one.vel_n, axis=1) for one in (truth, estimate))
    yield "velocity_mps", "Speed", "m/s", true, seen
    true, seen = np.degrees(so3.wrap(truth.euler)), np.degrees(so3.to_euler(estimate.q_nb))
    for index, name in enumerate(("roll", "pitch", "yaw")):
        yield f"{name}_deg", name.capitalize(), "deg", true[:, index], seen[:, index]


def _title(name: str, score: dict[str, Any], key: str, unit: str) -> str:
    return f"{name}   RMS error {score[key]['rms']:.2f} {unit}" if key in score else name


def _broken(values: Array, unit: str) -> Array:
    """Leave a gap where an angle wraps, so that no line crosses the panel."""
    values = values.copy()
    if unit == "deg" and len(values) > 1:
        values[np.flatnonzero(np.abs(np.diff(values)) > 180.0) + 1] = np.nan
    return values
