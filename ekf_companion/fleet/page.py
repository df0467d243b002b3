"""A fleet in one HTML file: verdicts, distributions, faults by group and by log; no script."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import numpy as np

from ekf_companion.fleet.dataset import shown
from ekf_companion.fleet.questions import Answer, noise, worst
from ekf_companion.logs.writer import create
from ekf_companion.nav.arrays import Array

WIDTH, HEIGHT = 240, 80
"""Of a histogram, px."""
MOST_ROWS, MOST_COLUMNS = 40, 12
"""Of the map of faults: the most frequent."""
LISTED = 200
"""Flights of the list, the worst first."""
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.2em auto; max-width: 1340px; padding: 0 1em;
       color: #1c2833; background: #fdfefe; }
h1 { font-size: 1.25em; } h2 { font-size: 1.05em; margin: 1.6em 0 .3em; }
table { border-collapse: collapse; font-size: .85em; } .wide { overflow-x: auto; }
td, th { padding: .2em .6em; border-bottom: 1px solid #e5e8e8; text-align: left;
         overflow-wrap: anywhere; }
.plots { display: flex; flex-wrap: wrap; gap: 1em; } figure { margin: 0; font-size: .8em; }
"""


def write(path: Path, place: str, tables: Mapping[str, Any], reports: Path | None = None) -> None:
    """Write the page.

    Args:
        path: The .html file.
        place: Where the tables are from, for the heading.
        tables: ``logs``, ``events`` and ``histograms``, as :func:`.load.load` returns them.
        reports: Folder of the logs' own reports, ``NAME.html``, to link to; None: there is none.

    Raises:
        LogError: It cannot be written.
    """
    with create(path) as file:
        file.write(_page(path, place, tables, reports).encode())


def _page(path: Path, place: str, tables: Mapping[str, Any], reports: Path | None) -> str:
    bad = worst(tables["logs"], LISTED)
    title = f"Fleet: {escape(shown(place))}"
    builds = sorted({str(one) for one in tables["logs"].column("version").to_pylist()})
    parts = [
        f"<!DOCTYPE html><html lang=en><meta charset=utf-8><title>{title}</title>",
        f"<style>{_STYLE}</style><h1>{title}</h1>",
        *(f"<p>{escape(one)}</p>" for one in (*bad.notes, f"version {', '.join(builds)}")),
        "<h2>Faults by airframe</h2><p>Flights in which it was found; the darker, the larger the",
        "share of that airframe's flights.</p>",
        _map(tables["logs"], tables["events"]),
        "<h2>Innovations over their sigma, and learnt noise</h2><div class=plots>",
        *_histograms(tables["histograms"].to_pylist()),
        "</div><h2>Noise and delay</h2>",
        _table(noise(tables["logs"])),
        "<h2>The worst flights</h2>",
        _table(bad, lambda log: _link(log, path, reports)),
    ]
    return "\n".join(parts)


def _link(log: str, path: Path, reports: Path | None) -> str:
    """Return a log's name, with a link to its report where there is one."""
    if reports is not None:
        report = reports / f"{PurePosixPath(log).name}.html"
        if report.is_file():
            try:
                target = report.resolve().relative_to(path.resolve().parent).as_posix()
            except ValueError:
                target = report.resolve().as_uri()
                return f'<a href="{escape(target)}">{escape(log)}</a>'
            return f'<a href="{escape(quote(target))}">{escape(log)}</a>'
    return escape(log)


def _table(answer: Answer, first: Any = escape) -> str:
    head = "".join(f"<th>{escape(name)}" for name in answer.columns)
    rows = (
        f"<tr><td>{first(str(row[0]))}" + "".join(f"<td>{escape(_cell(one))}" for one in row[1:])
        for row in answer.rows
    )
    return f"<div class=wide><table><tr>{head}{''.join(rows)}</table></div>"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _map(logs: Any, events: Any) -> str:
    """Return a table of the faults by airframe."""
    airframe = {
        one["key"]: one["airframe"] or one["autopilot"] or "unknown"
        for one in logs.to_pylist()
        if one["outcome"] == "estimated"
    }
    flights = Counter(airframe.values())
    found: Counter[tuple[str, str]] = Counter()
    seen: set[tuple[str, str]] = set()
    for event in events.to_pylist():
        words = " ".join(filter(None, (event["kind"], event["subject"])))
        if event["kind"] == "status":
            words = f"{event['subject']}: {event['evidence']}"
        if event["kind"] == "fault" or event["key"] not in airframe:
            continue
        if (event["key"], words) not in seen:
            seen.add((event["key"], words))
            found[words, airframe[event["key"]]] += 1
    columns = [name for name, _ in flights.most_common(MOST_COLUMNS)]
    totals: Counter[str] = Counter()
    for (words, _), count in found.items():
        totals[words] += count
    rows = []
    for words, total in sorted(totals.items(), key=lambda one: (-one[1], one[0]))[:MOST_ROWS]:
        cells = [_shaded(found[words, name], flights[name]) for name in columns]
        rows.append(f"<tr><th>{escape(words)}<td>{total}{''.join(cells)}")
    head = "".join(f"<th>{escape(name)} ({flights[name]})" for name in columns)
    return f"<div class=wide><table><tr><th><th>all{head}{''.join(rows)}</table></div>"


def _shaded(count: int, of: int) -> str:
    share = count / max(of, 1)
    style = f' style="background: rgba(192, 57, 43, {0.7 * share:.2f})"' if count else ""
    return f"<td{style}>{count or ''}"


def _histograms(rows: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Yield the sum of all logs' histograms of each quantity as a picture."""
    sums: dict[str, Array] = {}
    edges: dict[str, tuple[float, float]] = {}
    for row in rows:
        counts, name = row["counts"] or [], row["quantity"]
        known = sums.get(name)
        if not counts or row["low"] is None or (known is not None and len(known) != len(counts)):
            continue  # of another version
        sums[name] = np.array(counts, dtype=float) + (0.0 if known is None else known)
        edges[name] = (row["low"], row["high"])
    for name in sorted(sums):
        yield _picture(name, sums[name], *edges[name])


def _picture(name: str, counts: Array, low: float, high: float) -> str:
    step, top = WIDTH / len(counts), max(float(counts.max()), 1.0)
    bars = "".join(
        f'<rect x="{i * step:.1f}" y="{HEIGHT * (1.0 - n / top):.1f}" width="{step:.1f}" '
        f'height="{HEIGHT * n / top:.1f}" fill="#2874a6"/>'
        for i, n in enumerate(counts.tolist())
    )
    is_log = not name.startswith("innovation")
    ends = (f"1e{low:g}", f"1e{high:g}") if is_log else (f"{low:g}", f"{high:g}")
    total = int(counts.sum())
    return (
        f'<figure><svg width="{WIDTH}" height="{HEIGHT}">{bars}</svg><figcaption>'
        f"{escape(name)}: {ends[0]} to {ends[1]}, {total} values</figcaption></figure>"
    )
