"""The picture of docs/INTEGRITY.md: a receiver whose position slides, and what is thought of it.

``python -m benchmarks.integrity_figure`` simulates the flight, estimates it with
``weigh_faults: act`` and by the defaults, and draws into docs/images/integrity.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ekf_companion.core.settings.settings import FilterSettings, GnssSettings
from ekf_companion.engine.faults import SOURCES, FaultEvidence, FoundFault
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.nav.arrays import Array
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.measurements import Events, Kind
from ekf_companion.nav.state import Status, Table, Trajectory
from sim_autopilot import events as wire
from sim_autopilot.config import SimConfig
from sim_autopilot.flight import Flight

BEGIN, END, DURATION = 40.0, 80.0, 110.0
"""The slide, and the flight, s."""
SPEED = 0.3
"""Of the slide, m/s, northward; the receiver's velocity stays true."""
MOST = 4.0
"""Decades of odds that are drawn, both ways."""
SHOWN = 5
"""Sources that are drawn: those that were the most probable at any time."""
COLORS = ("#b3432f", "#1f3b63", "#d9a441", "#4c8c4a", "#7a5195")
STATUS = {Status.OK: "#4c8c4a", Status.DEGRADED: "#d9a441", Status.DEAD_RECKONING: "#b3632f"}


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight by one choice of ``weigh_faults``."""

    table: Table
    evidence: FaultEvidence
    found: list[FoundFault]
    error: Array
    """Horizontal, m, shape (n,)."""


def slide() -> tuple[Events, Trajectory]:
    """Return a flight in which the receiver's position slides, and its truth."""
    flown = Flight.plan("figure-eight", SimConfig(), seed=1, duration=DURATION)
    events, truth = wire.events(flown, has_vel_down=True), wire.truth(flown)
    since = (events.t_ns - events.t_ns[0]) * 1e-9 - BEGIN
    rows = (events.kind == Kind.GNSS) & (since > 0.0) & (since < END - BEGIN)
    metre = 1.0 / LocalFrame(float(truth.lat[0]), float(truth.lon[0]), 0.0).scale[0]
    values = events.values.copy()
    values[rows, 0] += SPEED * since[rows] * metre
    return replace(events, values=values), truth


def fly(events: Events, truth: Trajectory, settings: FilterSettings) -> Flown:
    """Estimate a flight."""
    pipeline = Pipeline(settings)
    table = pipeline.run(events)
    frame = LocalFrame(float(truth.lat[0]), float(truth.lon[0]), 0.0)
    t_ns = table.stamp_ns
    lat, lon = (np.interp(t_ns, truth.pos_t_ns, one) for one in (truth.lat, truth.lon))
    ours = np.deg2rad(table.columns(("lat_deg", "lon_deg")))
    nothing = np.zeros(len(t_ns))
    apart = frame.to_ned(ours[:, 0], ours[:, 1], nothing) - frame.to_ned(lat, lon, nothing)
    error = np.hypot(apart[:, 0], apart[:, 1])
    return Flown(table, pipeline.fault_evidence(), pipeline.found_faults(), error)


def draw_evidence(axes: Axes, flown: Flown, zero_ns: int) -> None:
    """Draw the odds of each source that it is wrong."""
    found = flown.evidence
    t = (found.t_ns - zero_ns) * 1e-9
    late = found.probability[t > BEGIN / 2]
    ranked = sorted(SOURCES, key=lambda one: -float(late[:, one].max()))[:SHOWN]
    for one, color in zip(ranked, COLORS, strict=True):
        p = np.clip(found.probability[:, one], 1e-9, 1.0 - 1e-9)
        odds = np.clip(np.log10(p / (1.0 - p)), -MOST, MOST)
        axes.plot(t, odds, color=color, lw=1.2, label=SOURCES[one][1])
    axes.axhline(0.0, color="#999999", lw=0.7)
    axes.axhline(np.log10(99.0), color="#999999", lw=0.7, ls=":")
    axes.text(1.0, np.log10(99.0) + 0.15, "0.99: named after three fixes", fontsize=6)
    axes.text(1.0, 0.15, "as likely wrong as right", fontsize=6)
    marks = (-4, -2, 0, 2, 4)
    axes.set_yticks(marks, [f"{10**mark}:1" if mark >= 0 else f"1:{10**-mark}" for mark in marks])
    axes.set_ylabel("odds that it is wrong")
    axes.legend(fontsize=6, loc="upper right", ncols=2)


def draw_levels(axes: Axes, act: Flown, usual: Flown, zero_ns: int) -> None:
    """Draw error, sigma and protection level."""
    t = (act.table.stamp_ns - zero_ns) * 1e-9
    north, east = (act.table.column(name) for name in ("sd_pos_n", "sd_pos_e"))
    levels = act.evidence
    axes.plot((levels.t_ns - zero_ns) * 1e-9, levels.protection[:, 0], color="#1f3b63", lw=1.4)
    axes.plot(t, np.hypot(north, east), color="#d9a441", lw=1.2)
    axes.plot(t, act.error, color="#b3432f", lw=1.0)
    axes.plot((usual.table.stamp_ns - zero_ns) * 1e-9, usual.error, color="#999999", lw=0.8)
    slid = np.array([[BEGIN, 0.0], [END, SPEED * (END - BEGIN)], [END, 0.0]])
    axes.plot(slid[:, 0], slid[:, 1], color="#000000", lw=0.6, ls="--")
    names = ("protection level", "sigma", "error", "error by the defaults", "the slide")
    axes.legend(axes.get_lines(), names, fontsize=6, loc=(0.13, 0.5))
    axes.set_ylim(0.0, 1.3 * SPEED * (END - BEGIN))
    axes.set_ylabel("horizontal, m")


def draw_status(axes: Axes, rows: Mapping[str, Flown], zero_ns: int) -> None:
    """Draw the status of each over time."""
    for place, flown in enumerate(rows.values()):
        t = (flown.table.stamp_ns - zero_ns) * 1e-9
        status = flown.table.column("status")
        for one, color in STATUS.items():
            axes.fill_between(
                t, place - 0.35, place + 0.35, where=status == one, color=color, lw=0, zorder=2
            )
    axes.set_yticks(range(len(rows)), list(rows))
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlabel("time, s (status: green ok, yellow degraded)")


def main() -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(prog="benchmarks.integrity_figure", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    asked = parser.parse_args()
    events, truth = slide()
    usual = FilterSettings(gnss=GnssSettings(delay=0.12))
    act, default = (
        fly(events, truth, replace(usual, weigh_faults=mode)) for mode in ("act", "off")
    )
    zero_ns = int(events.t_ns[0])
    figure = Figure(figsize=(7.0, 5.4), layout="constrained")
    axes = figure.subplots(3, sharex=True, height_ratios=(4, 4, 1))
    draw_evidence(axes[0], act, zero_ns)
    draw_levels(axes[1], act, default, zero_ns)
    draw_status(axes[2], {"act": act, "default": default}, zero_ns)
    for one in axes:
        one.axvspan(BEGIN, END, color="#f2f2f2", lw=0, zorder=0)
        one.set_xlim(0.0, DURATION)
        one.tick_params(labelsize=7)
        one.yaxis.label.set_size(8)
        one.xaxis.label.set_size(8)
    for fault in act.found:
        at = (fault.until_ns - zero_ns) * 1e-9
        axes[0].axvline(at, color="#b3432f", lw=0.6, ls=":")
        axes[1].axvline(at, color="#b3432f", lw=0.6, ls=":")
    path = asked.out / "integrity.png"
    figure.savefig(path, dpi=100, metadata={"Software": None})
    print(path)
    for fault in act.found:
        print(fault.words(zero_ns))


if __name__ == "__main__":
    main()
