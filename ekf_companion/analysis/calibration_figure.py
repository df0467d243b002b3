"""Figures of calibrations: the likelihood of delays, the field and its iron, the noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ekf_companion.calibrate.delay import DROP, Delay
from ekf_companion.calibrate.mag import AXES, Iron
from ekf_companion.calibrate.noise import SENSORS, Inertial, Noises
from ekf_companion.calibrate.scatter import Scatter

SMALLEST = 1e-4
"""Smallest scatter drawn, m."""
RED, BLUE, GREEN, GREY = "#d62728", "#1f77b4", "#2ca02c", "#7f7f7f"


def draw_delay(found: Delay, sheet: Any) -> None:
    """Draw the log-likelihood by delay, all of it and near the best, into a matplotlib figure."""
    whole, near = sheet.subplots(1, 2)
    reach = 3.0 * max(found.best - found.low, found.high - found.best, 0.005)
    for axis in (whole, near):
        axis.plot(found.delays, found.gain, ".-", color=BLUE, linewidth=1.0, markersize=3)
        axis.axvspan(found.low, found.high, color=RED, alpha=0.15, label="95 %")
        axis.axvline(found.best, color=RED, label=f"{found.best:.3f} s")
        axis.set(xlabel="gnss.delay, s", ylabel="log-likelihood over the best")
        axis.grid(visible=True, alpha=0.3)
    inside = np.abs(found.delays - found.best) <= reach
    lowest = float(found.gain[inside].min(initial=-3.0 * DROP))
    near.set(xlim=(found.best - reach, found.best + reach), ylim=(1.05 * lowest, -0.03 * lowest))
    near.axhline(-DROP * found.widening, color=GREY, linestyle=":", linewidth=1.0)
    whole.set_title("all delays tried")
    near.set_title("near the best")
    near.legend()


def draw_mag(found: Iron, sheet: Any) -> None:
    """Draw the field by pairs of axes and its strength, before and after, into a figure."""
    axes = sheet.subplots(2, 2)
    after = found.fit.apply(found.mag_b)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    ring = found.strength * np.stack([np.cos(angle), np.sin(angle)])
    for axis, (i, j) in zip(axes.flat, ((0, 1), (0, 2), (1, 2)), strict=False):
        axis.plot(*found.mag_b[:, [i, j]].T, ".", color=GREY, markersize=2, label="as it is")
        axis.plot(*after[:, [i, j]].T, ".", color=BLUE, markersize=2, label=found.method)
        axis.plot(*ring, color=RED, linewidth=1.0, label="strength of the field")
        axis.set(xlabel=f"{AXES[i]}, gauss", ylabel=f"{AXES[j]}, gauss")
        axis.set_aspect("equal", adjustable="datalim")
        axis.grid(visible=True, alpha=0.3)
    last = axes[1, 1]
    last.plot(np.linalg.norm(found.mag_b, axis=1), ".", color=GREY, markersize=2)
    last.plot(np.linalg.norm(after, axis=1), ".", color=BLUE, markersize=2)
    last.axhline(found.strength, color=RED, linewidth=1.0)
    last.set(xlabel="sample", ylabel="strength, gauss")
    last.grid(visible=True, alpha=0.3)
    axes[0, 0].legend(loc="upper right")


def draw_noise(found: Noises, sheet: Any) -> None:
    """Draw Allan deviations and structure functions into a matplotlib figure."""
    axes = sheet.subplots(2, 2)
    for axis, (sensor, (unit, part)) in zip(axes[0], SENSORS.items(), strict=True):
        axis.set(title=f"{sensor}: Allan deviation", xlabel="time, s", ylabel=unit)
        if found.inertial is not None:
            _draw_allan(axis, found.inertial, part)
        else:
            axis.text(0.5, 0.5, "no rest", ha="center", transform=axis.transAxes)
    for axis, name in zip(axes[1], ("horizontal", "height"), strict=True):
        axis.set(title=f"receiver, {name}: scatter by lag", xlabel="lag, s", ylabel="m")
        _draw_scatter(axis, [(one.state, getattr(one, name)) for one in found.receivers])


def _draw_allan(axis: Any, found: Inertial, part: slice) -> None:
    named = zip("xyz", found.curves[part], found.axes[part], strict=True)
    for colour, (name, curve, noise) in zip((RED, BLUE, GREEN), named, strict=True):
        axis.loglog(curve.tau, curve.deviation, "o-", color=colour, markersize=3, label=name)
        white = noise.white / np.sqrt(curve.tau)
        axis.loglog(curve.tau, white, color=colour, linestyle=":", linewidth=1.0)
    axis.axvline(max(noise.white_from for noise in found.axes[part]), color=GREY, linewidth=0.8)
    axis.grid(visible=True, which="both", alpha=0.3)
    axis.legend()


def _draw_scatter(axis: Any, scatters: Sequence[tuple[str, Scatter | None]]) -> None:
    known = [(state, one) for state, one in scatters if one is not None]
    for colour, (state, one) in zip((RED, BLUE, GREEN), known, strict=False):
        axis.loglog(
            one.lag,
            np.maximum(np.sqrt(one.structure), SMALLEST),
            "o-",
            color=colour,
            markersize=3,
            label=state,
        )
        axis.axhline(max(one.white, SMALLEST), color=colour, linestyle="--", linewidth=0.8)
        if one.time is not None:
            axis.loglog(one.lag, np.sqrt(one.model(one.time)), color=colour, linestyle=":")
    axis.grid(visible=True, which="both", alpha=0.3)
    if known:
        low, high = axis.get_ylim()
        axis.set_ylim(0.5 * low, 2.0 * high)  # noise alone would fill any narrower range
        axis.legend()
    else:
        axis.text(0.5, 0.5, "no fixes", ha="center", transform=axis.transAxes)
