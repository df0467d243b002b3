"""A report on a flight as one HTML file, which opens from the disk without a network.

Bokeh draws it; its script is taken from the installed package.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ekf_companion.analysis.flight_review import FlightReview
from ekf_companion.engine.health import Aid
from ekf_companion.errors import ConfigError, part_of
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array, Stamps
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import EULER, Trajectory
from ekf_companion.replay.report import summary

POINTS = 1500
"""Of a line: more than a screen has columns. 30 lines of them are 0.7 MB."""
_COLOURS = ("#c0392b", "#2874a6", "#7f8c8d")
_AXIS_COLOURS = ("#c0392b", "#1e8449", "#2874a6")
_WIDTH, _HEIGHT = 640, 260
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.2em auto; max-width: 1340px; padding: 0 1em;
       color: #1c2833; background: #fdfefe; }
h1 { font-size: 1.25em; margin: 0; } h2 { font-size: 1.05em; margin: 1.6em 0 .3em; }
.verdict { font-size: 1.35em; padding: .5em .7em; border-left: .5em solid; margin: .6em 0; }
.good { border-color: #1e8449; background: #e9f7ef; }
.fair { border-color: #d68910; background: #fef5e7; }
.poor { border-color: #c0392b; background: #fdedec; }
.attitude { border-color: #2874a6; background: #ebf5fb; }
.plots { display: grid; gap: .6em;
         grid-template-columns: repeat(auto-fit, minmax(min(100%, 520px), 1fr)); }
pre { white-space: pre-wrap; background: #f4f6f6; padding: .7em; font-size: .85em; }
.bk-Figure { max-width: 100%; }
"""


def page(review: FlightReview) -> str:
    """Return the report.

    Raises:
        MissingPackageError: Bokeh is not installed.
    """
    with part_of("report", "report"):
        from bokeh.embed import components
        from bokeh.resources import Resources
    sections = _sections(review)
    figures = [one for _, plots in sections for one in plots]
    script, places = components(figures)
    waiting = iter(places)
    body = [
        f"<h2>{escape(title)}</h2><div class=plots>{''.join(next(waiting) for _ in plots)}</div>"
        for title, plots in sections
        if plots
    ]
    resources = Resources(mode="inline", components=["bokeh"])
    judgement = review.judgement
    text = "\n".join(summary(review.report))
    grade = judgement.grade.partition(" ")[0]
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width, initial-scale=1">'
        f"<title>{escape(review.name)}: {escape(judgement.grade)}</title><style>{_STYLE}</style>"
        f"{resources.render_js()}</head><body><h1>{escape(review.name)}</h1>"
        f"<div class='verdict {grade}'>{escape(judgement.sentence)}</div>"
        f"{''.join(body)}<h2>What was found, used and refused</h2><pre>{escape(text)}</pre>"
        f"{script}</body></html>"
    )


def write(path: Path, review: FlightReview) -> None:
    """Write the report.

    Raises:
        CompanionError: Bokeh is not installed.
        ConfigError: The file cannot be written.
    """
    text = page(review)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error


class _Sheet:
    """Draws figures whose time axes are one, from the first estimate on."""

    def __init__(self, zero_ns: int) -> None:
        from bokeh.models import DataRange1d

        self._zero_ns = zero_ns
        self._time = DataRange1d()

    def seconds(self, t_ns: Stamps) -> Array:
        """Return stamps as the time axis shows them, s."""
        return np.asarray((t_ns - self._zero_ns) * 1e-9)

    def figure(self, title: str, unit: str, *, across: str = "time, s", **options: Any) -> Any:
        """Return an empty figure."""
        from bokeh.plotting import figure

        if across == "time, s":
            options["x_range"] = self._time
        plot = figure(
            title=title,
            x_axis_label=across,
            y_axis_label=unit,
            width=_WIDTH,
            height=_HEIGHT,
            sizing_mode="scale_width",
            tools="pan,box_zoom,wheel_zoom,reset,save,hover",
            active_drag="box_zoom",
            toolbar_location="above",
            **options,
        )
        plot.toolbar.logo = None
        return plot

    def lines(
        self, title: str, unit: str, series: Sequence[tuple[str, Stamps, Array, str]]
    ) -> list[Any]:
        """Return a figure of lines over time: name, stamps, values, colour; none if all are NaN."""
        known = [one for one in series if np.isfinite(one[2]).any()]
        if not known:
            return []
        plot = self.figure(title, unit)
        for name, t_ns, values, colour in known:
            x, y = thin(self.seconds(t_ns), values)
            plot.line(x, y, line_color=colour, line_width=1.4, legend_label=name)
        _place_legend(plot)
        return [plot]


def _place_legend(plot: Any) -> None:
    legend = plot.legend[0]
    legend.click_policy, legend.orientation = "hide", "horizontal"
    legend.label_text_font_size, legend.border_line_alpha, legend.padding = "9pt", 0.0, 0
    plot.add_layout(legend, "below")


def _short(name: str) -> str:
    """Return a trajectory's name without the messages that it is from: a legend is narrow."""
    return name.partition(" (")[0]


def thin(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a line with few points that has the same outline: the extremes of each piece."""
    if len(x) <= POINTS:
        return x.astype(np.float32), y.astype(np.float32)
    edges = np.linspace(0, len(x), POINTS // 2 + 1).astype(int)
    kept: list[int] = []
    for begin, end in pairwise(edges.tolist()):
        piece = y[begin:end]
        unknown = ~np.isfinite(piece)
        found = {begin + int(np.argmax(unknown))} if unknown.any() else set()
        if not unknown.all():
            found |= {begin + int(np.nanargmin(piece)), begin + int(np.nanargmax(piece))}
        kept += sorted(found)
    return x[kept].astype(np.float32), y[kept].astype(np.float32)


def _sections(review: FlightReview) -> list[tuple[str, list[Any]]]:
    sheet = _Sheet(int(review.table.stamp_ns[0]))
    trajectories = (review.ours, *review.others)
    return [
        ("Track, height, velocity", [*_track(review, sheet), *_motion(trajectories, sheet)]),
        ("Attitude", _attitude(trajectories, sheet)),
        (
            "Fixes less the estimate that did not know them, with three sigmas",
            _fixes(review, sheet),
        ),
        ("What the filter made of the measurements", _looks(review, sheet)),
        ("Biases and sigmas", _biases(review, sheet)),
        ("Spectra of the inertial samples", _spectra(review, sheet)),
    ]


def _track(review: FlightReview, sheet: _Sheet) -> list[Any]:
    placed = [one for one in (review.ours, *review.others) if len(one.pos_t_ns)]
    if not placed:
        return []
    frame = LocalFrame(float(placed[0].lat[0]), float(placed[0].lon[0]), 0.0)
    plot = sheet.figure("track", "north, m", across="east, m", match_aspect=True)
    if len(review.fixes):
        values = review.fixes.values
        some = slice(None, None, -(-len(values) // POINTS))
        ned = frame.to_ned(values[some, 0], values[some, 1], values[some, 2])
        plot.scatter(
            ned[:, 1], ned[:, 0], size=3, color="#b2babb", legend_label="fixes", name="fixes"
        )
    for one, colour in reversed(list(zip(placed, _COLOURS, strict=False))):
        some = slice(None, None, -(-len(one.pos_t_ns) // POINTS))
        ned = frame.to_ned(one.lat[some], one.lon[some], np.nan_to_num(one.alt[some]))
        plot.line(
            ned[:, 1], ned[:, 0], line_color=colour, line_width=1.6, legend_label=_short(one.name)
        )
    _place_legend(plot)
    return [plot]


def _motion(trajectories: Sequence[Trajectory], sheet: _Sheet) -> list[Any]:
    coloured = list(zip(trajectories, _COLOURS, strict=False))
    heights = [(_short(one.name), one.pos_t_ns, one.alt, colour) for one, colour in coloured]
    plots = sheet.lines("height above mean sea level", "m", heights)
    for axis, name in enumerate(("north", "east", "down")):
        series = [
            (_short(one.name), one.vel_t_ns, one.vel_n[:, axis], colour) for one, colour in coloured
        ]
        plots += sheet.lines(f"velocity {name}", "m/s", series)
    return plots


def _attitude(trajectories: Sequence[Trajectory], sheet: _Sheet) -> list[Any]:
    plots = []
    for axis, name in enumerate(EULER):
        series = []
        for one, colour in zip(trajectories, _COLOURS, strict=False):
            angle = np.rad2deg(so3.to_euler(one.q_nb)[:, axis]) if len(one.q_nb) else np.zeros(0)
            turned = np.abs(np.diff(angle, append=angle[-1:])) > 180.0
            series.append((_short(one.name), one.att_t_ns, np.where(turned, np.nan, angle), colour))
        plots += sheet.lines(name, "deg", series)
    return plots


def _fixes(review: FlightReview, sheet: _Sheet) -> list[Any]:
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
            x, y = thin(sheet.seconds(found.t_ns), sign * bound)
            plot.line(x, y, line_color="#85929e", line_dash="dashed")
        x, y = thin(sheet.seconds(found.t_ns), found.values[:, column])
        plot.line(x, y, line_color=_COLOURS[0], line_width=1.2)
        plots.append(plot)
    return plots


def _looks(review: FlightReview, sheet: _Sheet) -> list[Any]:
    looks = [look for look in review.looks if look.t_ns >= review.table.stamp_ns[0]]
    if not looks:
        return []
    t_ns = np.array([look.t_ns for look in looks], dtype=np.int64)
    palette = dict(
        zip(Aid, ("#c0392b", "#d68910", "#1e8449", "#2874a6", "#7d3c98", "#566573"), strict=False)
    )

    def series(values: Mapping[Aid, Array]) -> list[tuple[str, Stamps, Array, str]]:
        return [
            (aid.name.lower(), t_ns, value, palette.get(aid, "#000000"))
            for aid, value in values.items()
            if (np.nan_to_num(value) != 0.0).any()
        ]

    refused = {aid: np.array([float(look.refused[aid]) for look in looks]) for aid in Aid}
    fused = {aid: np.array([float(look.fused[aid]) for look in looks]) for aid in Aid}
    nis = {aid: np.array([look.nis[aid] for look in looks]) for aid in Aid}
    plots = sheet.lines("refused by gates, per second", "1/s", series(refused))
    plots += sheet.lines("fused, per second", "1/s", series(fused))
    plots += sheet.lines(
        "NIS over its degrees of freedom (1: as sure as it may be)", "", series(nis)
    )
    resets = [look for look in looks if look.reset]
    if plots and resets:
        from bokeh.models import Label, Span

        for look in resets:
            second = float(sheet.seconds(np.array([look.t_ns]))[0])
            plots[-1].add_layout(Span(location=second, dimension="height", line_color="#000000"))
            plots[-1].add_layout(Label(x=second, y=0, text=look.reset, text_font_size="8pt"))
    return plots


def _biases(review: FlightReview, sheet: _Sheet) -> list[Any]:
    table = review.table

    def group(title: str, unit: str, names: Sequence[str], scale: float = 1.0) -> list[Any]:
        series = [
            (name, table.stamp_ns, table.column(name) * scale, colour)
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
        *sheet.lines(
            "status (3 ok, 4 degraded, 5 without GNSS, 6 invalid)",
            "",
            [("status", table.stamp_ns, table.column("status"), "#2874a6")],
        ),
    ]


def _spectra(review: FlightReview, sheet: _Sheet) -> list[Any]:
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
        _place_legend(plot)
        plots.append(plot)
    return plots
