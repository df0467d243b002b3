"""The figure of trajectories: lines end where there is nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.analysis import figure_file, trajectory_figure
from ekf_companion.nav.state import Trajectory


def moves(svg):
    """Return how often a line of the estimate's colour begins anew."""
    found = re.findall(r'<path d="([^"]*)"[^>]*stroke: #d62728', svg)
    return sorted(len(re.findall("M ", path)) for path in found if path.count("L ") > 2)


def straight(t_s):
    """Return a flight to the north at 5 m/s."""
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    return Trajectory(
        name="ekf-companion",
        pos_t_ns=t_ns,
        lat=0.8 + 5.0 * t_s / 6.37e6 + 1e-6 * np.sin(t_s),
        lon=0.15 + 1e-6 * np.cos(t_s),
        alt=400.0 + np.sin(t_s),
        vel_t_ns=t_ns,
        vel_n=np.stack([5.0 + np.sin(t_s), np.cos(t_s), 0.0 * t_s], axis=1),
        att_t_ns=t_ns,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (len(t_s), 1)),
    )


def test_no_line_is_drawn_over_a_time_without_estimates(tmp_path):
    t_s = np.arange(0.0, 60.0, 0.1)
    out = tmp_path / "figure.svg"
    trajectory_figure.plot(out, [straight(t_s)])
    whole = moves(out.read_text())
    trajectory_figure.plot(out, [straight(t_s[(t_s < 25.0) | (t_s > 37.0)])])
    assert whole == [1] * len(whole)
    assert moves(out.read_text())[-3:] == [2, 2, 2]  # track, altitude, speed


@pytest.mark.parametrize("rate", [10.0, 2000.0])
def test_no_line_crosses_the_panel_where_the_heading_passes_south(tmp_path, rate):
    """Also in a flight so long that of its rows not each is drawn."""
    t_s = np.arange(0.0, 30.0, 1.0 / rate)
    half = 0.5 * np.deg2rad(24.0 * t_s + 7.0)  # two turns: passes south twice
    q_nb = np.stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=1)
    out = tmp_path / "figure.svg"
    trajectory_figure.plot(out, [replace(straight(t_s), q_nb=q_nb)])
    assert moves(out.read_text())[-1] == 3


def test_a_long_title_is_wrapped_and_stays_on_the_sheet(tmp_path):
    widths = []

    def draw(sheet):
        sheet.canvas.mpl_connect("draw_event", lambda event: measure(sheet, event.renderer))

    def measure(sheet, renderer):
        box = sheet._suptitle.get_window_extent(renderer)
        widths.append((box.x0, box.x1, sheet.bbox.width, sheet._suptitle.get_text()))

    title = "flight.ulg\nfair: " + ", ".join(["WIDE WORDS OF A VERDICT"] * 12)
    figure_file.write(tmp_path / "figure.png", title, draw)
    first, last, width, text = widths[-1]
    assert 0.0 < first < last < width
    assert text.splitlines()[0] == "flight.ulg"
    assert text.replace("\n", " ") == title.replace("\n", " ")
