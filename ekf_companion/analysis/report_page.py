"""A report on a flight as one HTML file, which opens from the disk without a network.

Bokeh draws it; its script is taken from the installed package.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis import map_tiles, report_tables
from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.analysis.gaps import GAP_NS, parted, thinned
from ekf_companion.analysis.report_sheet import POINTS, TALL, Sheet, place_legend
from ekf_companion.analysis.status_bands import spans
from ekf_companion.engine.faults import EVEN, SHARE, SOURCES
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.errors import part_of
from ekf_companion.logs.recording import LATEST_S
from ekf_companion.logs.writer import create
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import EULER, Status, Trajectory
from ekf_companion.review.report import summary

_OURS, _TRUTH, _AUTOPILOT = "#c0392b", "#1c2833", "#2874a6"
_AXIS_COLOURS = ("#c0392b", "#1e8449", "#2874a6")
_REFUSED = {
    Verdict.GATED: "refused by gates, per second",
    Verdict.SUSPECT: "not used: the receiver reports interference, per second",
    Verdict.DISTURBED: "not used as the magnetic field is disturbed, per second",
    Verdict.DENIED: "within their gates and contradicted by other evidence, per second",
}
"""Titles of the charts of refusals, by reason."""
_BANDS: dict[Status | None, str] = {
    **dict.fromkeys((Status.INIT, Status.ALIGNING), "#aab7b8"),
    Status.ATTITUDE: "#5dade2",
    Status.OK: "#52be80",
    Status.DEGRADED: "#f5b041",
    Status.DEAD_RECKONING: "#dc7633",
    Status.INVALID: "#c0392b",
    None: "#566573",
}
"""Colours of the statuses, and of times without estimates."""
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.2em auto; max-width: 1340px; padding: 0 1em;
       color: #1c2833; background: #fdfefe; }
h1 { font-size: 1.25em; margin: 0; } h2 { font-size: 1.05em; margin: 1.6em 0 .3em; }
.verdict { font-size: 1.35em; padding: .5em .7em; border-left: .5em solid; margin: .6em 0; }
.good { border-color: #1e8449; background: #e9f7ef; }
.fair, .slow, .short { border-color: #d68910; background: #fef5e7; }
.poor { border-color: #c0392b; background: #fdedec; }
.attitude { border-color: #2874a6; background: #ebf5fb; }
.plots { display: grid; gap: .6em;
         grid-template-columns: repeat(auto-fit, minmax(min(100%, 520px), 1fr)); }
pre { white-space: pre-wrap; overflow-wrap: anywhere; background: #f4f6f6; padding: .7em;
      font-size: .85em; }
.plots { overflow-x: clip; } .plots > div { min-width: 0; }
.when { color: #566573; margin: .1em 0; overflow-wrap: anywhere; } h1 { overflow-wrap: anywhere; }
button { font: inherit; padding: .3em .9em; border: 1px solid #aeb6bf; border-radius: 4px;
         background: #fdfefe; color: inherit; cursor: pointer; }
@media (max-width: 560px) {
  body { padding: 0 .5em; margin: .6em auto; } .verdict { font-size: 1.1em; }
}
"""
_SCRIPT = """
const cuts = %s;
const button = document.getElementById("outliers");
let isWhole = false;
button?.addEventListener("click", () => {
  isWhole = !isWhole;
  button.textContent = isWhole ? "Cut peaks off" : "Show all peaks";
  const page = Bokeh.documents[0];
  for (const { id, title, usual, whole } of cuts) {
    const [model, span] = [page.get_model_by_id(id), isWhole ? whole : usual];
    if (Array.isArray(span)) model.setv({ start: span[0], end: span[1] });
    else model.data = span;
    const [head, cut] = [page.get_model_by_id(title), " (peaks cut off)"];
    head.text = isWhole ? head.text.replace(cut, "") : head.text + cut;
  }
});
// A finger that drags over a figure moves the page
document.addEventListener("DOMContentLoaded", () => setTimeout(() => {
  if (!matchMedia("(pointer: coarse)").matches) return;
  for (const id of %s) {
    const bar = Bokeh.documents[0].get_model_by_id(id);
    bar.gestures.pan.active && (bar.gestures.pan.active.active = false);
  }
}));
"""


def page(review: FlightReview) -> str:
    """Return the report.

    Raises:
        MissingPackageError: Bokeh is not installed.
    """
    stamp_ns = review.table.stamp_ns
    with part_of("report", "report"):
        sheet = Sheet(int(stamp_ns[0]), review.begins_ns, int(stamp_ns[-1]))
    judgement, text = review.judgement, "\n".join(summary(review.report))
    return assembled(
        sheet,
        _sections(review, sheet),
        name=review.name,
        when=_when(review),
        grade=judgement.grade,
        verdict=judgement.sentence,
        head=report_tables.head(review),
        tail=f"{_tables(review, sheet)}"
        f"<h2>What was found, used and refused</h2><pre>{escape(text)}</pre>",
    )


def assembled(
    sheet: Sheet,
    sections: Sequence[tuple[str, list[Any]]],
    *,
    name: str,
    when: str,
    grade: str,
    verdict: str,
    head: str,
    tail: str,
) -> str:
    """Return a page of figures under their headings, between two parts in HTML."""
    from bokeh.document import Document
    from bokeh.embed import components
    from bokeh.resources import Resources

    figures = [one for _, plots in sections for one in plots]
    # Of one document, which is searched for models once, not again for each figure
    document = Document()
    with document.models.freeze():
        for one in figures:
            document.add_root(one)
    script, places = components(figures)
    waiting = iter(places)
    body = [
        f"<h2>{escape(title)}</h2><div class=plots>{''.join(next(waiting) for _ in plots)}</div>"
        for title, plots in sections
        if plots
    ]
    resources = Resources(mode="inline", components=["bokeh"])
    button = "<p><button id=outliers type=button>Show all peaks</button></p>" if sheet.cuts else ""
    bars = [one.toolbar.id for one in figures]
    own_script = _SCRIPT % (json.dumps(sheet.cuts), json.dumps(bars))
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{escape(name)}: {escape(grade)}</title>"
        f"<style>{_STYLE}{report_tables.STYLE}</style>"
        f"{resources.render_js()}</head><body><h1>{escape(name)}</h1>"
        f"<p class=when>{escape(when)}</p>"
        f"<div class='verdict {grade.partition(' ')[0]}'>{escape(verdict)}</div>"
        f"{head}{button}{''.join(body)}{tail}"
        f"{script}<script>{own_script}</script></body></html>"
    )


def _tables(review: FlightReview, sheet: Sheet) -> str:
    """Return the tables below the figures, each with its heading."""
    return "".join(
        report_tables.title(title) + table
        for title, table in (
            (
                "Faults that were found",
                report_tables.faults(review.report.faults, sheet.second),
            ),
            (
                "Vibration and clipping",
                report_tables.vibration(review.numbers.vibration, sheet.second),
            ),
            ("Version and settings", report_tables.settings(review)),
            ("Parameters", report_tables.parameters(review.onboard)),
            ("Messages of the log", report_tables.messages(review.onboard, sheet.second)),
        )
        if table
    )


def _when(review: FlightReview) -> str:
    """Return time, duration and vehicle of the flight."""
    words = []
    if review.began_s is not None and 0.0 < review.began_s < LATEST_S:
        began = datetime.fromtimestamp(review.began_s, timezone.utc)
        words.append(f"{began:%Y-%m-%d %H:%M} UTC")
    minutes, seconds = divmod(round(review.duration), 60)
    words.append(f"{minutes} min {seconds} s" if minutes else f"{seconds} s")
    if review.report.family != "unknown":
        words.append({"px4": "PX4", "ardupilot": "ArduPilot"}[review.report.family])
    if review.begins_ns:
        times = "once" if len(review.begins_ns) == 1 else f"{len(review.begins_ns)} times"
        words.append(f"the autopilot's clock restarted {times}")
    return " \u00b7 ".join(words)


def write(path: Path, review: FlightReview) -> None:
    """Write the report.

    Raises:
        CompanionError: Bokeh is not installed.
        LogError: The file cannot be written.
    """
    text = page(review)
    with create(path) as file:
        file.write(text.encode())


def _short(name: str) -> str:
    """Return a trajectory's name without its messages, since a legend is narrow."""
    return name.partition(" (")[0]


def _sections(review: FlightReview, sheet: Sheet) -> list[tuple[str, list[Any]]]:
    return [
        ("Status, and why", _bands(review, sheet)),
        ("Track, height, velocity", [*_track(review, sheet), *_motion(review, sheet)]),
        ("Attitude", _attitude(_coloured(review), sheet)),
        (
            "Fixes less the estimate that did not know them, with three sigmas",
            _fixes(review, sheet),
        ),
        ("What the filter made of the measurements", _looks(review, sheet)),
        ("What may have begun to be wrong", _faults(review, sheet)),
        ("Biases and sigmas", _biases(review, sheet)),
        ("Spectra of the inertial samples", _spectra(review, sheet)),
    ]


def _bands(review: FlightReview, sheet: Sheet) -> list[Any]:
    """Return a figure of the statuses, and of their reasons below them."""
    rows = [
        (words, _BANDS[one.status], one.spans_ns)
        for one, words in zip(review.bands, report_tables.band_words(review.bands), strict=True)
    ]
    return [sheet.bands("status over time", rows)] if rows else []


def _coloured(review: FlightReview) -> list[tuple[Trajectory, str]]:
    """Return all trajectories with their colours, the same in all figures."""
    colours = [_AUTOPILOT] if review.report.truth is None else [_TRUTH, _AUTOPILOT]
    return [(review.ours, _OURS), *zip(review.others, colours, strict=False)]


def _track(review: FlightReview, sheet: Sheet) -> list[Any]:
    placed = [one for one in _coloured(review) if len(one[0].pos_t_ns)]
    if not placed:
        return []
    first = placed[0][0]
    frame = LocalFrame(float(first.lat[0]), float(first.lon[0]), 0.0)
    options = {"match_aspect": True, "height": TALL}
    plot = sheet.figure("track", "north, m", across="east, m", **options)
    for axis in plot.axis:
        axis.formatter.power_limit_high = 7  # 1000000 m rather than 1.000e+6
    if len(review.fixes):
        values = review.fixes.values
        some = slice(None, None, -(-len(values) // POINTS))
        ned = frame.to_ned(values[some, 0], values[some, 1], values[some, 2])
        plot.scatter(
            ned[:, 1], ned[:, 0], size=3, color="#b2babb", legend_label="fixes", name="fixes"
        )
    tracks = []
    for one, colour in reversed(placed):
        rows, is_end = thinned(one.pos_t_ns, POINTS, review.jumps_ns if one is review.ours else ())
        ned = frame.to_ned(one.lat[rows], one.lon[rows], np.nan_to_num(one.alt[rows]))
        tracks.append(ned)
        north, east = parted(is_end, ned[:, 0], ned[:, 1])
        plot.line(east, north, line_color=colour, line_width=1.6, legend_label=_short(one.name))
    sheet.limit_map(plot, tracks)
    if review.tiles:
        map_tiles.draw(plot, review.tiles, review.tiles_credit, frame, [one for one, _ in placed])
    place_legend(plot)
    return [plot]


def _motion(review: FlightReview, sheet: Sheet) -> list[Any]:
    trajectories = _coloured(review)
    heights = [(_short(one.name), one.pos_t_ns, one.alt, colour) for one, colour in trajectories]
    where = "above mean sea level" if review.has_sea_level else "as the file counts it"
    plots = sheet.lines(f"height {where}", "m", heights)
    for axis, name in enumerate(("north", "east", "down")):
        series = [
            (_short(one.name), one.vel_t_ns, one.vel_n[:, axis], colour)
            for one, colour in trajectories
        ]
        plots += sheet.lines(f"velocity {name}", "m/s", series)
    return plots


def _attitude(trajectories: Sequence[tuple[Trajectory, str]], sheet: Sheet) -> list[Any]:
    plots = []
    for axis, name in enumerate(EULER):
        series = []
        for one, colour in trajectories:
            angle = np.rad2deg(so3.to_euler(one.q_nb)[:, axis]) if len(one.q_nb) else np.zeros(0)
            turned = np.abs(np.diff(angle, append=angle[-1:])) > 180.0
            series.append((_short(one.name), one.att_t_ns, np.where(turned, np.nan, angle), colour))
        plots += sheet.lines(name, "deg", series)
    return plots


def _fixes(review: FlightReview, sheet: Sheet) -> list[Any]:
    found, plots = review.innovations, []
    if found is None:
        return []
    names = [
        f"{what} {axis}" for what in ("position", "velocity") for axis in ("north", "east", "down")
    ]
    for column, name in enumerate(names):
        if not np.isfinite(found.values[:, column]).any():
            continue
        plot = sheet.figure(name, "m" if column < 3 else "m/s")
        bound = found.bounds[:, column]
        for sign in (1.0, -1.0):
            look = {"line_color": "#85929e", "line_dash": "dashed"}
            sheet.line(plot, found.t_ns, sign * bound, dots=2, **look)
        sheet.line(plot, found.t_ns, found.values[:, column], dots=3, line_color=_OURS)
        sheet.limit(plot, [found.values[:, column], bound, -bound])
        plots.append(plot)
    return plots


COLOURS = (
    *("#c0392b", "#d68910", "#1e8449", "#2874a6", "#7d3c98", "#566573"),
    *("#0e7c7b", "#a04000"),
)
"""Of the aids, in turn."""


def _looks(review: FlightReview, sheet: Sheet) -> list[Any]:
    looks = [look for look in review.looks if look.t_ns >= review.table.stamp_ns[0]]
    if not looks:
        return []
    t_ns = np.array([look.t_ns for look in looks], dtype=np.int64)
    palette = dict(zip(Aid, COLOURS, strict=False))

    def series(values: Mapping[Aid, Array]) -> list[tuple[str, Stamps, Array, str]]:
        return [
            (aid.name.lower(), t_ns, value, palette.get(aid, "#000000"))
            for aid, value in values.items()
            if (np.nan_to_num(value) != 0.0).any()
        ]

    plots = []
    for why, title in _REFUSED.items():
        refused = {aid: np.array([float(look.refused[aid, why]) for look in looks]) for aid in Aid}
        plots += sheet.lines(title, "1/s", series(refused))
    fused = {aid: np.array([float(look.fused[aid]) for look in looks]) for aid in Aid}
    nis = {aid: np.array([look.nis[aid] for look in looks]) for aid in Aid}
    plots += sheet.lines("fused, per second", "1/s", series(fused))
    plots += sheet.lines(
        "NIS over its degrees of freedom (1: as sure as it may be)", "", series(nis)
    )
    if plots:
        sheet.mark(plots[-1], [(look.t_ns, look.reset) for look in looks if look.reset])
    return plots


def _faults(review: FlightReview, sheet: Sheet) -> list[Any]:
    """Return a row of bars for each source that was suspected, its probability, and the levels."""
    found = review.evidence
    if len(found.t_ns) < 2:
        return []
    # once a second, of a long flight less often
    gap_ns = max(GAP_NS, round(3.0 * float(np.median(np.diff(found.t_ns)))))
    shown = [one for one in SOURCES if (found.probability[:, one] > SHARE).any()]
    palette = {one: COLOURS[i % len(COLOURS)] for i, one in enumerate(shown)}
    rows = [
        (SOURCES[one][1], palette[one], held)
        for one in shown
        if (held := spans(found.t_ns, found.probability[:, one] > EVEN, gap_ns))
    ]
    plots = [sheet.bands("more likely wrong than right", rows)] if rows else []
    if shown:
        plot = sheet.figure("probability that it is wrong", "", y_range=(-0.02, 1.02))
        for one in shown:
            look: dict[str, Any] = {"line_color": palette[one], "legend_label": SOURCES[one][1]}
            sheet.line(plot, found.t_ns, found.probability[:, one], **look)
        place_legend(plot)
        plots.append(plot)
    table = review.table
    std = np.hypot(table.column("sd_pos_n"), table.column("sd_pos_e"))
    for i, (name, sigma) in enumerate(
        (("horizontal", std), ("vertical", table.column("sd_pos_d")))
    ):
        if np.isfinite(found.protection[:, i]).any():
            lines = [
                ("protection level", found.t_ns, found.protection[:, i], _TRUTH),
                ("sigma", table.stamp_ns, sigma, _OURS),
            ]
            plots += sheet.lines(f"protection level, {name}", "m", lines)
    return plots


def _biases(review: FlightReview, sheet: Sheet) -> list[Any]:
    table = review.table

    def group(title: str, unit: str, names: Sequence[str], scale: float = 1.0) -> list[Any]:
        series = [
            (name.rpartition("_")[2], table.stamp_ns, table.column(name) * scale, colour)
            for name, colour in zip(names, _AXIS_COLOURS, strict=True)
        ]
        return sheet.lines(title, unit, series)

    degrees = float(np.rad2deg(1.0))
    axes, parts = ("x", "y", "z"), ("n", "e", "d")
    return [
        *group("gyro bias", "deg/s", [f"gyro_bias_{axis}" for axis in axes], degrees),
        *group("accelerometer bias", "m/s2", [f"accel_bias_{axis}" for axis in axes]),
        *group("one sigma of position", "m", [f"sd_pos_{part}" for part in parts]),
        *group("one sigma of attitude", "deg", [f"sd_{name}" for name in EULER], degrees),
    ]


def _spectra(review: FlightReview, sheet: Sheet) -> list[Any]:
    found, plots = review.spectra, []
    if found is None:
        return []
    for title, unit, values in (
        ("gyro", "rad/s per root Hz", found.gyro),
        ("accelerometer", "m/s2 per root Hz", found.accel),
    ):
        plot = sheet.figure(title, unit, across="frequency, Hz", y_axis_type="log")
        for axis, colour in enumerate(_AXIS_COLOURS):
            positive = np.maximum(values[:, axis], 1e-9)
            plot.line(
                found.frequency.astype(np.float32),
                positive.astype(np.float32),
                line_color=colour,
                legend_label="xyz"[axis],
            )
        place_legend(plot)
        plots.append(plot)
    return plots
