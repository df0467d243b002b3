"""The pictures of docs/FLEET.md: three questions, asked of the recorded flights.

``python -m benchmarks.fleet_figures`` estimates from all of them by the defaults, and by fault
hypotheses that decide, and draws the answers of ``fleet worst``, ``fleet noise`` and ``fleet
compare`` into docs/images.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.fleet import link_recorded
from ekf_companion.config.config import Config
from ekf_companion.fleet import campaign, questions
from ekf_companion.fleet.executor import Processes
from ekf_companion.fleet.listing import Listing
from ekf_companion.fleet.load import load

LONGEST = 60
"""Characters of a verdict."""
COLORS = {"good": "#4c8c4a", "fair": "#d9a441", "poor": "#b3432f"}


def draw_worst(axes: Axes, answer: questions.Answer) -> None:
    """Draw how long the worst flights were not good."""
    rows = [dict(zip(answer.columns, row, strict=True)) for row in answer.rows][::-1]
    names = [Path(row["log"]).stem for row in rows]
    colors = [COLORS.get(row["grade"], "#777777") for row in rows]
    axes.barh(names, [row["not_ok_s"] for row in rows], color=colors)
    for place, row in enumerate(rows):
        words = row["verdict"].split(": ", 1)[-1]
        words = words if len(words) <= LONGEST else f"{words[:LONGEST].rstrip(' ,;(')}..."
        axes.text(row["not_ok_s"] + 0.3, place, words, va="center", fontsize=6)
    axes.set_xlim(0.0, 2.4 * max(1.0, *(row["not_ok_s"] for row in rows)))
    axes.set_xlabel("not OK, s")


def draw_noise(axes: Axes, answer: questions.Answer, name: str, label: str) -> None:
    """Draw median and 90 % of the flights of a quantity, by airframe."""
    rows = [dict(zip(answer.columns, row, strict=True)) for row in answer.rows]
    for place, row in enumerate(rows):
        if row[name] is None:
            continue
        axes.plot([row[f"{name}_p05"], row[f"{name}_p95"]], [place, place], color="#7a9cc6", lw=5)
        axes.plot(row[name], place, "o", color="#1f3b63")
    axes.set_yticks(range(len(rows)), [row["airframe"] for row in rows])
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.set_xlabel(label)


def draw_compare(axes: Axes, before: object, after: object, answer: questions.Answer) -> None:
    """Draw an error of each flight before and after."""
    column = "autopilot_horizontal_m"
    old, new = (
        {row["log"]: row[column] for row in one.to_pylist()}  # type: ignore[attr-defined]
        for one in (before, after)
    )
    logs = [log for log in new if old.get(log) and new[log]]
    a, b = (np.array([one[log] for log in logs]) for one in (old, new))
    ends = [0.8 * min(a.min(), b.min()), 1.2 * max(a.max(), b.max())]
    axes.plot(ends, ends, color="#999999", lw=1)
    axes.loglog(a, b, "o", color="#1f3b63", ms=4)
    row = next(dict(zip(answer.columns, r, strict=True)) for r in answer.rows if r[0] == column)
    axes.set_title(
        f"{row['better']} better, {row['worse']} worse, {row['equal']} equal, p = {row['p']:.2g}",
        fontsize=8,
    )
    axes.set_xlabel("from the autopilot, by the defaults, m")
    axes.set_ylabel("with weigh_faults: act, m")


def save(figure: Figure, path: Path) -> None:
    """Write a figure, the same bytes for the same flights."""
    figure.savefig(path, dpi=100, metadata={"Software": None})
    print(path)


def main() -> None:
    """Draw what the command line asks for."""
    parser = argparse.ArgumentParser(prog="benchmarks.fleet_figures", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--jobs", type=int, default=2)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        logs, tables = Path(name) / "logs", []
        logs.mkdir()
        link_recorded(logs)
        for config in (Config(), replace(Config(), weigh_faults="act")):
            place = f"{name}/{config.weigh_faults}"
            campaign.run(Listing([str(logs)]), config, place, Processes(asked.jobs))
            tables.append(load(place))
    first, second = tables
    figure = Figure(figsize=(7.0, 2.6), layout="constrained")
    draw_worst(figure.subplots(), questions.worst(first, 8))
    save(figure, asked.out / "fleet-worst.png")
    known = first.filter([bool(one) for one in first.column("airframe").to_pylist()])
    answer = questions.noise(known, ["airframe"])
    figure = Figure(figsize=(7.0, 2.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3, sharey=True)
    draw_noise(left, answer, "gyro_noise_rps", "gyro, rad/s/√Hz")
    draw_noise(middle, answer, "accel_noise_mps2", "accel, m/s²/√Hz")
    draw_noise(right, answer, "gnss_delay_s", "delay learnt, s")
    save(figure, asked.out / "fleet-noise.png")
    figure = Figure(figsize=(3.6, 3.2), layout="constrained")
    draw_compare(figure.subplots(), first, second, questions.compare(first, second))
    save(figure, asked.out / "fleet-compare.png")


if __name__ == "__main__":
    main()
