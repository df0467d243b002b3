"""The figures of a report, drawn by Bokeh: lines over one time axis, robust against outliers.

At first an axis shows the range of nearly all values; a switch on the page shows all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ekf_companion.analysis.gaps import broken
from ekf_companion.analysis.status_bands import joined
from ekf_companion.nav.arrays import Array, Stamps

POINTS = 1500
"""Points of a line: more than a screen has columns. 30 lines of them are 0.7 MB."""
USUAL = (0.5, 99.5)
"""Percentiles of a line that an axis shows at first."""
MUCH = 1.6
"""All is shown at first unless its span is so many times that of the usual values."""
MARGIN = 0.08
"""Share of the span, on each side."""
ELSEWHERE = 100_000.0
"""Distance from the median of a track beyond which a position is an outlier, m."""
LEAP = 20.0
"""The same, as a multiple of the distance between the quartiles."""
HEIGHT, TALL = 280, 400
"""Pixels of a figure over time, and of a map; the width is the page's."""
BAND = 34
"""Pixels of a row of bands, with its name."""
AXIS = 45
"""Pixels that the vertical axis takes beside a figure with usual numbers."""
ROWS, ROW, LABEL = 12, 12, 0.3
"""Rows of labels, the height of one in pixels, and a label's width, a share of a phone's figure."""
_CONSTANT = 1e-8
"""Width of the usual span up to which a line counts as constant: twice the narrowest one."""

Line = tuple[str, Stamps, Array, str]
"""Name, stamps (ns), values, colour."""
Bands = tuple[str, str, Sequence[tuple[int, int]]]
"""Name, colour, and from when to when, ns."""
Span = tuple[float, float]


def thin(x: Array, y: Array) -> tuple[Array, Array]:
    """Return a line with few points and the same outline: the extremes of each piece."""
    if len(x) <= POINTS:
        return x.astype(np.float32), y.astype(np.float32)
    # Pieces of one length, as rows: the last one is filled up with its last value
    pieces = POINTS // 2
    length = -(-len(x) // pieces)
    piece = np.concatenate([y, np.full(pieces * length - len(y), y[-1])]).reshape(pieces, length)
    is_known = np.isfinite(piece)
    first = np.arange(0, pieces * length, length)
    has_gap, has_value = ~is_known.all(axis=1), is_known.any(axis=1)
    found = [(first + np.argmin(is_known, axis=1))[has_gap]]
    for extreme, other in ((np.argmin, np.inf), (np.argmax, -np.inf)):
        found.append((first + extreme(np.where(is_known, piece, other), axis=1))[has_value])
    kept = np.unique(np.concatenate(found))
    kept = kept[kept < len(x)]
    return x[kept].astype(np.float32), y[kept].astype(np.float32)


def usual_span(series: Iterable[Array]) -> tuple[Span, Span] | None:
    """Return the range of nearly all values of each line, and that of all; None: no values.

    Both have a margin, and neither is narrower than 1e-9.
    """
    known = [values[np.isfinite(values)] for values in series]
    known = [values for values in known if len(values)]
    if not known:
        return None
    usual = np.array([np.percentile(values, USUAL) for values in known])
    whole = np.array([(values.min(), values.max()) for values in known])
    first, second = ((one[:, 0].min(), one[:, 1].max()) for one in (usual, whole))
    return _with_margin(*first), _with_margin(*second)


def _with_margin(low: float, high: float) -> Span:
    spare = max(MARGIN * (high - low), 1e-9)
    return float(low - spare), float(high + spare)


def is_cut(usual: Span, whole: Span) -> bool:
    """Return whether an axis shows less than all at first; that of a constant does not."""
    width = usual[1] - usual[0]
    return width > _CONSTANT and whole[1] - whole[0] > MUCH * width


def rows_of_labels(places: Sequence[float], span: float) -> list[int | None]:
    """Return the row of each label at ascending positions; None: no row has room."""
    ends = [-np.inf] * ROWS
    found: list[int | None] = []
    for place in places:
        row = next((row for row, end in enumerate(ends) if end <= place), None)
        if row is not None:
            ends[row] = place + LABEL * span
        found.append(row)
    return found


def without_leaps(track: Array) -> Array:
    """Return the rows of a track, north, east, shape (n, 2) or more, without outliers.

    Left out is what is farther than ``ELSEWHERE`` from the median, and also farther than a multiple
    of the spread of half of the track: positions of a damaged file, or of a receiver's first fix.
    """
    place = track[:, :2]
    known = place[np.isfinite(place).all(axis=1)]
    if not len(known):
        return track
    low, median, high = np.percentile(known, (25.0, 50.0, 75.0), axis=0)
    farthest = max(ELSEWHERE, LEAP * float(np.hypot(*(high - low))))
    return np.asarray(track[np.hypot(*(place - median).T) <= farthest])


class Sheet:
    """Draws figures with a common time axis, from the first estimate on."""

    def __init__(self, zero_ns: int, begins_ns: Sequence[int] = (), end_ns: int = 0) -> None:
        """Draw nothing yet.

        Args:
            zero_ns: Zero of the time axis.
            begins_ns: Times at which the autopilot's clock began anew, which are marked by a line.
            end_ns: End of the time axis.
        """
        from bokeh.models import DataRange1d

        self._zero_ns = zero_ns
        self.span = max((end_ns - zero_ns) * 1e-9, 1.0)
        """How long the time axis is, s."""
        self._restarts = self.seconds(np.array(begins_ns, dtype=np.int64)).tolist()
        self._time = DataRange1d(range_padding=0.02)
        self.cuts: list[dict[str, Any]] = []
        """Axes that show less than all: the id of a range, its usual and its whole span."""

    def seconds(self, t_ns: Stamps) -> Array:
        """Return stamps as the time axis shows them, s."""
        return np.asarray((t_ns - self._zero_ns) * 1e-9)

    def second(self, t_ns: int) -> float:
        """Return one stamp as the time axis shows it, s."""
        return (t_ns - self._zero_ns) * 1e-9

    def figure(self, title: str, unit: str, *, across: str = "time, s", **options: Any) -> Any:
        """Return an empty figure."""
        from bokeh.plotting import figure

        if across == "time, s":
            options["x_range"] = self._time
        plot = figure(
            title=title,
            x_axis_label=across,
            y_axis_label=unit,
            sizing_mode="stretch_width",
            tools="pan,box_zoom,wheel_zoom,reset,save,hover",
            active_drag="box_zoom",
            toolbar_location="above",
            **{"height": HEIGHT, **options},
        )
        plot.toolbar.logo, plot.toolbar.autohide = None, True
        if across == "time, s":
            self._mark_restarts(plot)
        return plot

    def lines(self, title: str, unit: str, series: Sequence[Line]) -> list[Any]:
        """Return a figure of lines over time; none if all values are NaN."""
        known = [one for one in series if np.isfinite(one[2]).any()]
        if not known:
            return []
        plot = self.figure(title, unit)
        for name, t_ns, values, colour in reversed(known):  # the first one on top
            self.line(plot, t_ns, values, line_color=colour, legend_label=name)
        self.limit(plot, [values for _, _, values, _ in known])
        place_legend(plot)
        return [plot]

    def line(self, plot: Any, t_ns: Stamps, values: Array, dots: int = 0, **look: Any) -> None:
        """Draw one line over time into a figure.

        Dots, whose size is in pixels, also show a single value between two gaps.
        """
        x, y = thin(*broken(t_ns, self.seconds(t_ns), np.asarray(values, dtype=float)))
        drawn = plot.line(x, y, **{"line_width": 1.4, **look})
        if dots:
            colour = look["line_color"]
            plot.scatter("x", "y", source=drawn.data_source, size=dots, color=colour)

    def bands(self, title: str, rows: Sequence[Bands]) -> Any:
        """Return a figure of bands over time, one row below the other, each under its name."""
        from bokeh.models import Label

        height = BAND * len(rows) + 90
        plot = self.figure(title, "", y_range=(-len(rows) - 0.1, 0.1), height=height)
        plot.yaxis.visible, plot.ygrid.visible = False, False
        plot.min_border_left = AXIS
        least_ns = round(self.span * 1e9 / POINTS)
        drawn: dict[str, list[Any]] = {name: [] for name in ("left", "right", "top", "what", "c")}
        for at, (name, colour, spans_ns) in enumerate(rows):
            spans = joined(spans_ns, least_ns)
            # A moment that is narrower than a pixel is seen, too
            drawn["left"] += [self.second(begin) for begin, _ in spans]
            drawn["right"] += [self.second(max(end, begin + least_ns)) for begin, end in spans]
            drawn["top"] += [-at - 0.5] * len(spans)
            drawn["what"] += [name] * len(spans)
            drawn["c"] += [colour] * len(spans)
            words = {"text": name, "text_font_size": "9pt", "text_baseline": "top"}
            plot.add_layout(Label(x=4, x_units="screen", y=-at - 0.05, **words))
        drawn["bottom"] = [top - 0.42 for top in drawn["top"]]
        plot.quad(
            **{side: side for side in ("left", "right", "top", "bottom")},
            **{"source": drawn, "fill_color": "c", "line_color": "c"},
        )
        plot.hover.tooltips = [("", "@what"), ("s", "@left{0.0} to @right{0.0}")]
        return plot

    def mark(self, plot: Any, marks: Sequence[tuple[int, str]]) -> None:
        """Draw vertical lines at ascending stamps, with labels that do not overlap."""
        from bokeh.models import Label, Span

        if not marks:
            return
        seconds = self.seconds(np.array([t_ns for t_ns, _ in marks], dtype=np.int64)).tolist()
        rows = rows_of_labels(seconds, self.span)
        for second, row, (_, words) in zip(seconds, rows, marks, strict=True):
            plot.add_layout(Span(location=second, dimension="height", line_color="#000000"))
            if row is not None:
                look = {"y": 2 + ROW * row, "y_units": "screen", "text_font_size": "8pt"}
                plot.add_layout(Label(x=second, text=f" {words}", **look))

    def limit(self, plot: Any, series: Sequence[Array]) -> None:
        """Let the vertical axis show at first the usual range of some lines."""
        from bokeh.models import Range1d

        spans = usual_span(series)
        if spans is None or not is_cut(*spans):
            return
        usual, whole = spans
        plot.y_range = Range1d(*usual)
        self._cut(plot, plot.y_range, usual, whole)

    def limit_map(self, plot: Any, tracks: Sequence[Array]) -> None:
        """Let a map, whose axes have one scale, show at first the usual range of some tracks.

        The tracks are north, east, shape (n, 2) or more. Nothing near is cut off.
        """
        spans = []
        for axis in (1, 0):
            usual_of = usual_span([without_leaps(one)[:, axis] for one in tracks])
            whole_of = usual_span([one[:, axis] for one in tracks])
            if usual_of is None or whole_of is None:
                return
            spans.append((usual_of[0], whole_of[1]))
        east, north = spans
        size = max(east[0][1] - east[0][0], north[0][1] - north[0][0])
        all_of = max(east[1][1] - east[1][0], north[1][1] - north[1][0])
        if all_of <= MUCH * size:
            return
        # Invisible corners, which alone the ranges follow: a map keeps one scale by itself
        usual = {"x": list(east[0]), "y": list(north[0])}
        whole = {"x": list(east[1]), "y": list(north[1])}
        corners = plot.scatter(usual["x"], usual["y"], alpha=0.0, size=1)
        plot.x_range.renderers = plot.y_range.renderers = [corners]
        self._cut(plot, corners.data_source, usual, whole)

    def _cut(self, plot: Any, model: Any, usual: Any, whole: Any) -> None:
        plot.title.text += " (peaks cut off)"
        self.cuts.append({"id": model.id, "title": plot.title.id, "usual": usual, "whole": whole})

    def _mark_restarts(self, plot: Any) -> None:
        from bokeh.models import Label, Span

        for second in self._restarts:
            plot.add_layout(
                Span(location=second, dimension="height", line_color="#566573", line_dash="dotted")
            )
            words = {"text": " clock restarts", "text_font_size": "8pt", "text_color": "#566573"}
            plot.add_layout(Label(x=second, y=4, y_units="screen", **words))


def place_legend(plot: Any) -> None:
    """Put the legend below the figure, where a click hides a line."""
    legend = plot.legend[0]
    legend.click_policy, legend.orientation = "hide", "horizontal"
    legend.ncols = 3
    legend.items = legend.items[::-1]  # ours, which is drawn last, first
    legend.label_text_font_size, legend.border_line_alpha, legend.padding = "9pt", 0.0, 0
    legend.margin, legend.spacing, legend.location = 0, 8, "top_left"
    plot.add_layout(legend, "below")
