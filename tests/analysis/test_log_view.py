"""What the page is given of a log."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from ekf_companion.analysis import log_view, report_page
from ekf_companion.analysis.flight_review import review
from ekf_companion.config.config import Config
from ekf_companion.engine.health import Aid, Verdict
from ekf_companion.nav import so3
from ekf_companion.nav.state import Trajectory
from sim_autopilot.__main__ import app

SECOND_NS = 1_000_000_000


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "flight.tlog"
    options = ["generate", "--duration", "20", "--scenario", "figure-eight", "-o", str(path)]
    assert CliRunner().invoke(app, options).exit_code == 0
    return path


@pytest.fixture(scope="module")
def flight(log):
    return review(log, Config())


@pytest.fixture(scope="module")
def data(flight):
    return json.loads(log_view.to_json(flight))


def test_the_columns_are_as_long_as_the_slider(data):
    moments = len(data["t"])
    assert 1000 < moments <= log_view.MOMENTS
    assert data["t"][0] == 0.0
    for columns in (data["ours"], data["estimate"], data["others"][0]["columns"]):
        assert {len(values) for values in columns.values()} == {moments}


def test_a_moment_is_the_estimate_of_that_moment(flight, data):
    at = len(data["t"]) // 2
    table = flight.table
    row = np.argmin(np.abs((table.stamp_ns - table.stamp_ns.min()) * 1e-9 - data["t"][at]))
    assert data["ours"]["lat_deg"][at] == pytest.approx(table.column("lat_deg")[row], abs=2e-7)
    assert data["ours"]["v_north"][at] == pytest.approx(table.column("vel_n")[row], abs=0.05)
    heading = math.degrees(table.column("yaw")[row]) % 360.0
    turned = (data["ours"]["heading_deg"][at] - heading + 180.0) % 360.0 - 180.0
    assert turned == pytest.approx(0.0, abs=1.0)
    sigma = data["estimate"]["sd_yaw"][at]
    assert sigma == pytest.approx(math.degrees(table.column("sd_yaw")[row]), abs=0.01)


def test_innovations_have_bounds_and_looks_have_counts(data):
    found = data["innovations"]
    assert set(found["values"]) == set(found["bounds"])
    assert {len(values) for values in found["values"].values()} == {len(found["t"])}
    assert sum(data["looks"]["fused"]["position"]) > 20


@pytest.mark.campaign
def test_a_disturbed_field_is_told_from_what_gates_refuse(tmp_path):
    pytest.importorskip("bokeh")
    path = tmp_path / "flight.tlog"
    options = ["generate", "--duration", "40", "--scenario", "hover", "-o", str(path)]
    options += ["--fault", "mag-disturbance:start=20,duration=10,forward=0.3"]
    assert CliRunner().invoke(app, options).exit_code == 0
    found = review(path, Config())
    looks = json.loads(log_view.to_json(found))["looks"]
    counted = found.report.health.verdicts[Aid.HEADING]
    assert counted[Verdict.DISTURBED] > 20
    assert sum(looks["refused"]["heading disturbed"]) == counted[Verdict.DISTURBED]
    assert sum(looks["refused"].get("heading gated", [])) == counted[Verdict.GATED]
    titles = report_page._REFUSED
    report_page.write(tmp_path / "report.html", found)
    text = (tmp_path / "report.html").read_text()
    assert f'"{titles[Verdict.DISTURBED]}"' in text
    assert (f'"{titles[Verdict.GATED]}"' in text) == any(
        name.endswith("gated") for name in looks["refused"]
    )


def test_events_are_in_the_order_of_time(data):
    times = [event["t"] for event in data["events"]]
    assert times == sorted(times)
    assert any("Estimate is OK" in event["text"] for event in data["events"])


def test_an_attitude_between_two_is_on_the_short_way():
    yaw = np.deg2rad([170.0, -170.0])
    q_nb = so3.from_euler(0.0 * yaw, 0.0 * yaw, yaw)
    turning = Trajectory(name="", att_t_ns=np.array([0, SECOND_NS]), q_nb=q_nb)
    found = log_view._trajectory(turning, np.array([SECOND_NS // 2]))
    assert found["heading_deg"] == [pytest.approx(180.0, abs=0.1)]


def test_where_no_row_is_near_nothing_is_known():
    standing = Trajectory(
        name="",
        vel_t_ns=np.array([0, 10 * SECOND_NS]),
        vel_n=np.ones((2, 3)),
    )
    found = log_view._trajectory(standing, np.array([SECOND_NS // 2, 5 * SECOND_NS]))
    assert found["v_north"][0] == 1.0
    assert math.isnan(found["v_north"][1])


def without(log, begin_s, end_s):
    """Return a .tlog without the records of some seconds."""
    kept, place, zero = [], 0, int.from_bytes(log[:8], "big")
    while place < len(log):
        size = 20 + log[place + 9] + 13 * (log[place + 10] & 1)
        seconds = (int.from_bytes(log[place : place + 8], "big") - zero) * 1e-6
        if not begin_s < seconds < end_s:
            kept.append(log[place : place + size])
        place += size
    return b"".join(kept)


def test_every_line_ends_where_three_seconds_are_missing(log, tmp_path):
    path = tmp_path / "gap.tlog"
    path.write_bytes(without(log.read_bytes(), 9.5, 12.5))
    data = json.loads(log_view.to_json(review(path, Config())))
    t, status = np.array(data["t"]), data["estimate"]["status"]
    assert np.diff(t).min() >= 0.0
    inside = [at for at, one in enumerate(status) if one == "no_samples"]
    assert inside
    assert inside == list(range(inside[0], inside[-1] + 1))
    begin, end = t[inside[0] - 1], t[inside[-1] + 1]
    assert 2.5 < end - begin < 3.5
    drawn = {**data["ours"], **data["estimate"], **data["others"][0]["columns"]}
    del drawn["status"]
    for name, values in drawn.items():
        assert {values[at] for at in inside} == {None}, name
    for part, values in (
        (data["innovations"], data["innovations"]["values"]["position north"]),
        (data["looks"], data["looks"]["fused"]["position"]),
    ):
        times = np.array(part["t"])
        (first, *_) = np.flatnonzero(times > begin - 0.5)
        assert None in values[first : np.searchsorted(times, end)]


def test_a_reset_says_before_which_moment_the_track_jumps(flight):
    jump_ns = int(flight.table.stamp_ns[1000])
    data = json.loads(log_view.to_json(replace(flight, jumps_ns=(jump_ns,))))
    at, jump = data["jumps"][0], (jump_ns - flight.table.stamp_ns.min()) * 1e-9
    assert data["t"][at - 1] < jump <= data["t"][at] + 1e-3
