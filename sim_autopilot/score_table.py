"""A score as a table and sentences."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table

from sim_autopilot import episodes

TITLES = {
    "horizontal_m": "horizontal, m",
    "vertical_m": "vertical, m",
    "velocity_mps": "velocity, m/s",
    "roll_deg": "roll, deg",
    "pitch_deg": "pitch, deg",
    "yaw_deg": "yaw, deg",
}
"""Of the errors of a score."""


def table(score: dict[str, Any], limits: Mapping[str, float]) -> Table:
    """Return the errors as a table, each beside its limit if it has one."""
    sheet = Table(pad_edge=False, box=None, header_style="bold")
    sheet.add_column("error")
    for title in ("RMS", "95 %", "max", "limit (RMS)"):
        sheet.add_column(title, justify="right", min_width=8)
    for key, title in TITLES.items():
        if key not in score:
            continue
        error, limit = score[key], limits.get(key)
        row = [title, *(f"{error[part]:.3f}" for part in ("rms", "p95", "max"))]
        if limit is not None:
            colour = "green" if error["rms"] <= limit else "bold red"
            row[1] = f"[{colour}]{row[1]}[/]"
            row.append(f"{limit:.2f}")
        sheet.add_row(*row)
    return sheet


def sentences(score: dict[str, Any]) -> list[str]:
    """Return what the errors are of, and the effect of each fault."""
    odometry, latency = score["odometry"], score["latency_ms"]
    found = [
        f"{score['scenario']}, seed {score['seed']}: {odometry['received']} ODOMETRY received; "
        f"{odometry['scored']} scored after {score['score_after_s']:g} s, "
        f"{odometry['rate_hz']:.1f} Hz, {odometry['resets']} resets",
        f"origin: {score['origin']}",
    ]
    if latency is not None:
        found.append(
            f"inertial sample out to its ODOMETRY in: {latency['p50']:.2f} ms in the median, "
            f"{latency['p99']:.2f} ms at 99 %"
        )
    if "autopilot" in score:
        found.append(reception(score["autopilot"]))
    found += [episodes.sentence(one) for one in score.get("faults", [])]
    return found


def reception(summary: Mapping[str, Any]) -> str:
    """Return what the autopilot did: ``odometry: accepted N, refused M: reason``."""
    refused = sum(summary["refused"].values())
    line = f"odometry: accepted {summary['accepted']}, refused {refused}"
    if summary["refused"]:
        line += ": " + "; ".join(f"{why} ({n})" for why, n in summary["refused"].items())
    return line
