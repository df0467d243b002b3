"""The report on a flight: one file, offline, small, drawn by a browser, and true."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.analysis import report_page
from ekf_companion.analysis.flight_review import review
from ekf_companion.analysis.report_sheet import (
    POINTS,
    Sheet,
    is_cut,
    rows_of_labels,
    thin,
    usual_span,
    without_leaps,
)
from ekf_companion.cli import app
from ekf_companion.config.config import Config, parse_config
from ekf_companion.logs.onboard import Message, Onboard
from ekf_companion.nav.state import Table
from sim_autopilot.__main__ import app as simulator
from tests.browser import chromium
from tests.logs.test_csv_known import SENSORS

LARGEST = 3_000_000
DRAWN = "window.Bokeh?.documents.length > 0 && document.querySelector('.bk-Figure') !== null"


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    log = tmp_path_factory.mktemp("flown") / "flight.tlog"
    made = CliRunner().invoke(
        simulator, ["generate", "-o", str(log), "--scenario", "figure-eight", "--duration", "40"]
    )
    assert made.exit_code == 0, made.output
    return log


@pytest.fixture(scope="module")
def reported(flown):
    pytest.importorskip("bokeh")
    return CliRunner().invoke(app, ["report", str(flown)]), flown.with_name("flight.report.html")


def test_it_says_its_verdict_and_where_it_is(reported):
    result, path = reported
    assert result.exit_code == 0, result.output
    verdict, file = result.stdout.splitlines()
    assert re.fullmatch(r"good: 0\.\d m RMS from the truth, no resets", verdict)
    assert file == f"report: {path}"


def test_it_is_one_small_file_that_needs_no_network(reported):
    text = reported[1].read_text()
    assert len(text) < LARGEST
    assert not re.search(r"<(script|link|img)[^>]*\b(src|href)=", text)
    assert "good: 0." in text.partition("class='verdict good'>")[2][:40]
    for title in (
        *("track", "height above mean sea level", "velocity north", "roll", "position north"),
        *("fused, per second", "gyro bias", "accelerometer", "status over time"),
    ):
        assert f'"{title}' in text, title
    assert "position: " in text.partition("found, used and refused")[2]


def test_a_browser_draws_it_without_an_error_as_wide_as_its_screen(reported, tmp_path):
    with chromium(tmp_path) as tab:
        for width in (420, 1280):
            tab.show(width, 900, phone=width == 420)
            tab.open(reported[1].as_uri())
            tab.wait_for(DRAWN)
            tab.wait_for("document.querySelector('.bk-Figure').clientHeight > 100")
            assert tab.value("document.documentElement.scrollWidth") == width
            least = tab.value("document.querySelector('.bk-Figure').clientWidth")
            assert least > 0.4 * width
        picture = tmp_path / "shot.png"
        tab.screenshot(picture)
        assert picture.stat().st_size > 30_000  # an empty page has 8 kB
        assert tab.errors == []


def test_its_head_names_the_log_when_it_was_recorded_and_how_long_it_is(flown, reported, tmp_path):
    head = reported[1].read_text().partition("</head>")[2][:400]
    assert head.startswith("<body><h1>flight.tlog</h1>")
    assert re.search(r"<p class=when>\S*.*4\d s \u00b7 PX4", head), head
    dated = tmp_path / "dated.tlog"
    dated.write_bytes(with_stamps(flown.read_bytes(), 1_782_907_200_000_000))
    assert report_page._when(review(dated, Config())).startswith("2026-07-01 12:00 UTC \u00b7 ")


def with_stamps(log, first_us):
    """Return a .tlog whose recorder's clock began at a time."""
    records, place, zero = [], 0, int.from_bytes(log[:8], "big")
    while place < len(log):
        stamp_us = int.from_bytes(log[place : place + 8], "big") - zero + first_us
        size = 12 + log[place + 9] + 13 * (log[place + 10] & 1)
        records += [stamp_us.to_bytes(8, "big"), log[place + 8 : place + 8 + size]]
        place += 8 + size
    return b"".join(records)


def with_outlier(review):
    """Return a flight whose estimate leaps away for a moment."""
    table = Table(stamp_ns=review.table.stamp_ns, values=review.table.values.copy())
    table.column("gyro_bias_x")[len(table) // 2] = 5.0
    lat = review.ours.lat.copy()
    lat[len(lat) // 2 :][:20] += 0.01  # rad
    return replace(review, table=table, ours=replace(review.ours, lat=lat))


@pytest.mark.campaign
def test_an_outlier_spoils_no_axis_and_a_switch_shows_it(flown, tmp_path):
    path = tmp_path / "wild.html"
    report_page.write(path, with_outlier(review(flown, Config())))
    wide = (
        "(() => { const found = {}; for (const one of Bokeh.documents[0]._all_models.values())"
        " if (one.type == 'Figure') found[one.title.text.split(' (')[0]] ="
        " [one.x_range.end - one.x_range.start, one.y_range.end - one.y_range.start];"
        " return found; })()"
    )
    with chromium(tmp_path) as tab:
        tab.show(1280, 900)
        tab.open(path.as_uri())
        tab.wait_for(DRAWN)
        tab.wait_for(f"{wide}['track'][1] < 1000")
        assert tab.value(wide)["gyro bias"][1] < 20.0
        tab.value("document.querySelector('#outliers').click()")
        tab.wait_for(f"{wide}['gyro bias'][1] > 200")
        tab.wait_for(f"{wide}['track'][1] > 50000")
        tab.value("document.querySelector('#outliers').click()")
        tab.wait_for(f"{wide}['gyro bias'][1] < 20 && {wide}['track'][1] < 1000")
        assert tab.errors == []


def test_without_a_position_of_ours_nothing_of_the_autopilots_is_in_our_colour(flown):
    found = review(flown, Config())
    nowhere = np.zeros(0)
    ours = replace(found.ours, pos_t_ns=nowhere.astype(np.int64), lat=nowhere, lon=nowhere)
    colours = dict(report_page._coloured(replace(found, ours=replace(ours, alt=nowhere))))
    assert len(set(colours.values())) == len(found.others) + 1
    plot = report_page._track(replace(found, ours=replace(ours, alt=nowhere)), Sheet(0))[0]
    drawn = {one.glyph.line_color for one in plot.renderers if hasattr(one.glyph, "line_color")}
    assert report_page._OURS not in drawn
    assert report_page._AUTOPILOT in drawn


def test_heights_of_a_made_up_place_are_those_of_its_file(tmp_path):
    rows = []
    for index in range(400):
        fix = "1,0,0,110,0,0,0" if index % 10 == 0 else "0,NaN,NaN,NaN,NaN,NaN,NaN"
        rows.append(f"{index / 10},0,0,0,0,0,-9.81,1,0,0,{0.1 * (index % 2)},{fix}")
    path = tmp_path / "uavSensors.csv"
    path.write_text("\n".join([SENSORS.partition("\n")[0], *rows, ""]))
    found = review(path, Config())
    assert found.ours.alt == pytest.approx(110.0, abs=5.0)
    assert not found.has_sea_level
    assert '"height as the file counts it' in report_page.page(found)


def test_two_boots_are_drawn_one_after_another(flown, tmp_path):
    log = tmp_path / "twice.tlog"
    log.write_bytes(2 * flown.read_bytes())
    found = review(log, Config())
    assert (np.diff(found.table.stamp_ns) >= 0).all()
    (begin_ns,) = found.begins_ns
    lasted = (begin_ns - found.table.stamp_ns[0]) * 1e-9
    assert 45.0 < lasted < 55.0  # 40 s and a pause
    assert found.table.stamp_ns[-1] - begin_ns > 35e9
    assert found.looks[-1].t_ns > begin_ns
    page = report_page.page(found)
    assert "clock restarts" in page
    assert "clock restarted once" in page


@pytest.mark.parametrize("mode", ["off", "report", "act"])
def test_what_may_be_wrong_is_drawn_and_what_was_is_in_a_table(mode, tmp_path):
    pytest.importorskip("bokeh")
    log = tmp_path / "jumped.tlog"
    options = ["--duration", "40", "--fault", "baro-step:start=25,duration=60,height=8"]
    made = CliRunner().invoke(simulator, ["generate", "-o", str(log), *options])
    assert made.exit_code == 0, made.output
    reviewed = review(log, replace(Config(), weigh_faults=mode))
    text = report_page.page(reviewed)
    table = text.partition("<table id=faults>")[2].partition("</table>")[0]
    has_bars, has_levels = '"more likely wrong than right' in text, '"protection level, ver' in text
    assert has_levels == (mode == "act")
    assert has_bars == ('"probability that it is wrong' in text) == (mode != "off")
    assert table.count("<tr>") == (0 if mode == "off" else 2)  # with its head
    found = reviewed.to_dict()["faults"]
    if mode != "off":
        assert "<td class=text>barometer</td>" in table
        assert [one["source"] for one in found] == ["baro"]
        assert found[0]["size"] == pytest.approx([8.0], abs=3.0)
        assert found[0]["from_s"] == pytest.approx(25.0, abs=3.0)
    else:
        assert found == []


def test_a_second_one_overwrites_nothing_and_json_comes_in_place_of_the_text(reported, flown):
    before = reported[1].read_bytes()
    result = CliRunner().invoke(app, ["report", str(flown), "--json", "--png"])
    assert result.exit_code == 0, result.output
    second = flown.with_name("flight.report-2.html")
    assert result.stderr.endswith(f"report: {second}, {second.with_suffix('.png')}\n")
    assert second.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    data = json.loads(result.stdout)
    assert data["grade"] == "good"
    assert data["verdict"].startswith("good: 0.")
    assert reported[1].read_bytes() == before


def test_without_bokeh_it_says_what_to_install(flown):
    hidden = "import sys; sys.modules['bokeh'] = None; from ekf_companion.cli import app; app()"
    result = subprocess.run(
        [sys.executable, "-c", hidden, "report", flown, "-o", flown.with_name("no.html")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert "report: needs bokeh, which is not installed" in result.stderr
    assert "-m pip install 'ekf-companion[report]'" in result.stderr
    assert not flown.with_name("no.html").exists()


def test_a_line_keeps_its_extremes_and_its_gaps():
    x = np.arange(100_000.0)
    y = np.sin(x / 3000.0)
    y[5_000], y[77_777], y[50_000] = 9.0, -9.0, np.nan
    _, short = thin(x, y)
    assert len(short) <= 1.6 * POINTS
    assert (np.nanmax(short), np.nanmin(short)) == (9.0, -9.0)
    assert np.isnan(short).sum() == 1


def test_what_is_usual_is_of_each_line_by_itself():
    still, far = np.zeros(1000), np.full(1000, 46.0)
    far[500] = 9000.0
    usual, whole = usual_span([still, far, np.full(3, np.nan)])
    assert usual[1] == pytest.approx(46.0, abs=5.0)
    assert whole[1] > 9000.0
    assert is_cut(usual, whole)
    assert not is_cut(*usual_span([np.sin(np.arange(1000.0))]))
    assert usual_span([np.full(3, np.nan)]) is None


def test_a_map_begins_where_a_track_is_and_not_where_it_leapt_to():
    pytest.importorskip("bokeh")
    angle = np.linspace(0.0, 6.0, 700)
    near = 200.0 * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    leapt = near.copy()
    leapt[-50:] += (1_110_000.0, 164_000.0)  # as EKF2's in a damaged .ulg: 7 %, beyond percentiles
    for tracks, is_cut_off in (([near], False), ([leapt], True), ([near, leapt], True)):
        sheet = Sheet(0)
        plot = sheet.figure("track", "north, m", across="east, m")
        sheet.limit_map(plot, tracks)
        assert bool(sheet.cuts) is is_cut_off
        for cut in sheet.cuts:
            assert max(np.abs([*cut["usual"]["x"], *cut["usual"]["y"]])) < 300.0
            assert cut["whole"]["y"][1] > 1_100_000.0
    # A long way that was flown is no leap
    assert len(without_leaps(np.linspace((0.0, 0.0), (9e5, 3e5), 100))) == 100


def test_an_axis_of_a_constant_shows_every_departure_from_it():
    values = np.full(10_000, 4.0)
    values[:30] = 1.0
    assert not is_cut(*usual_span([values]))


def test_a_value_alone_between_gaps_is_drawn_as_a_dot():
    sheet = Sheet(0)
    plot = sheet.figure("position north", "m")
    t_ns = np.array([0, 1, 30, 60, 61], dtype=np.int64) * 1_000_000_000
    sheet.line(plot, t_ns, np.arange(5.0), dots=3, line_color="#000000")
    line, dots = plot.renderers
    assert (line.glyph.__class__.__name__, dots.glyph.__class__.__name__) == ("Line", "Scatter")
    assert set(dots.data_source.data["x"]) == {0.0, 1.0, 30.0, 60.0, 61.0}


def test_labels_of_resets_cover_no_other():
    assert rows_of_labels([0.0, 5.0, 6.0, 50.0], 100.0) == [0, 1, 2, 0]
    rows = rows_of_labels([*range(30)], 100.0)
    assert rows[:12] == [*range(12)]
    assert rows[12:] == [None] * 18
    sheet = Sheet(0, end_ns=100_000_000_000)
    plot = sheet.figure("NIS", "")
    sheet.mark(plot, [(1_000_000_000, "position"), (2_000_000_000, "height")])
    heights = [one.y for one in plot.center if one.__class__.__name__ == "Label"]
    assert abs(heights[1] - heights[0]) > 10.0


HOSTILE = "<script>alert(1)</script>'\"&<img src=x onerror=alert(1)>"


def test_what_a_log_says_is_text_whatever_it_says(flown):
    found = review(flown, Config())
    wild = Onboard(
        firmware=HOSTILE,
        parameters={f"EK3_{HOSTILE}": np.nan, "GPS_TYPE": 1.0, "MOT_SPIN": 3.0},
        messages=(Message(None, HOSTILE, HOSTILE), Message(0, "error", HOSTILE)),
        left_out=7,
    )
    others = tuple(replace(one, name=HOSTILE) for one in found.others)
    errors = tuple(replace(one, reference=HOSTILE) for one in found.numbers.errors)
    wild_review = replace(
        found,
        name=HOSTILE,
        onboard=wild,
        others=others,
        numbers=replace(found.numbers, errors=errors),
        settings={"gnss.delay": HOSTILE},
    )
    body, usual = (
        report_page.page(one).rpartition("</head><body>")[2] for one in (wild_review, found)
    )
    # Bokeh's part is JSON in a script, where no end of a script may stand
    assert body.count("</script") == usual.count("</script") == usual.count("<script")
    outside = re.sub(r"<script.*?</script>", "", body, flags=re.DOTALL)
    assert "<script" not in outside
    assert "<img" not in outside
    assert outside.count("&lt;img") > 5
    assert "GPS_TYPE" in body
    assert "MOT_SPIN" not in body
    assert "2 of 3 parameters" in body
    assert "7 more are left out" in body


def test_its_table_of_errors_says_what_its_verdict_says(reported):
    text = reported[1].read_text()
    size = re.search(r"(0\.\d) m RMS from the truth", reported[0].stdout)[1]
    row = re.search(r"<th>horizontal, m</th><td>(0\.\d+)</td>", text)
    assert f"{float(row[1]):.1f}" == size
    for words in ("way over ground", "top speed over ground", "velocity, m/s", "clipped samples"):
        assert words in text


def test_its_numbers_are_in_the_json_too(flown, tmp_path):
    out = tmp_path / "r.html"
    result = CliRunner().invoke(app, ["report", str(flown), "-o", str(out), "--json"])
    found = json.loads(result.stdout)
    assert found["errors"][0]["horizontal_m"]["rms"] < 1.0
    assert found["motion"]["way_m"] > 100.0
    assert found["vibration"]["accel_clipped"] == 0
    assert {one["name"] for one in found["bands"]} >= {"aligning", "ok"}


def test_a_map_lies_under_the_track_only_where_tiles_are_configured(flown, reported):
    assert "tiles.example.org" not in reported[1].read_text()
    tiles = "https://tiles.example.org/{z}/{x}/{y}.png"
    config = parse_config({"http": {"tiles": tiles, "tiles_credit": "(c) <b>us</b>"}}, "test")
    found = review(flown, config)
    (track,) = report_page._track(found, Sheet(0))
    assert len(track.x_range.renderers) == len(track.renderers) - 1  # the map widens no axis
    text = report_page.page(found)
    assert len(set(re.findall(r"https://tiles.example.org/1[0-9]/[0-9]+/[0-9]+.png", text))) > 3
    assert "<b>us" not in text
    assert "map: (c) " in text
