import sys

import numpy as np
import pytest

from ekf_companion.analysis import score, trajectory_figure
from ekf_companion.errors import CompanionError, LogError
from ekf_companion.logs import tlog
from ekf_companion.logs.estimate import read_estimate, read_truth, to_trajectory
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from ekf_companion.nav.state import COLUMNS, Trajectory
from ekf_companion.replay import log_source
from tests.paths import DATA

FRAME = LocalFrame(0.8, 0.1, 500.0)


def circle(
    rate=50.0, seconds=30.0, late=0.0, offset=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), radius=20.0
):
    """Fly a circle in 10 s, wrongly by a delay, an offset (m) and a turn (rad)."""
    at = np.arange(0.0, seconds, 1.0 / rate)
    t_ns = np.rint(at * 1e9).astype(np.int64) + 5_000_000_000
    phase = 2.0 * np.pi / 10.0 * (at - late)
    ned = radius * np.stack([np.cos(phase), np.sin(phase), np.zeros_like(at)], axis=1) + offset
    vel_n = radius * np.pi / 5.0 * np.stack([-np.sin(phase), np.cos(phase), 0.0 * at], axis=1)
    lat, lon, alt = FRAME.to_geodetic(ned)
    angles = np.stack([0.3 * np.sin(phase), 0.2 * np.cos(phase), phase], axis=1) + turn
    return Trajectory(
        name="circle",
        pos_t_ns=t_ns,
        lat=lat,
        lon=lon,
        alt=alt,
        vel_t_ns=t_ns,
        vel_n=vel_n,
        att_t_ns=t_ns,
        q_nb=so3.from_euler(*angles.T),
    )


def test_an_estimate_equal_to_its_reference_has_no_error():
    found = score.score(circle(), circle())
    assert found.horizontal.largest < 1e-8
    assert found.velocity.largest == 0.0
    assert found.tilt.largest < 1e-7
    assert abs(found.lag) < 1e-9


def test_offsets_are_found_in_their_own_lines():
    turn = np.deg2rad([0.0, 0.0, 3.0])
    found = score.score(circle(offset=(0.6, 0.8, -2.0), turn=turn), circle())
    assert found.horizontal.rms == pytest.approx(1.0, abs=1e-5)  # radii at the reference
    assert found.vertical.rms == pytest.approx(2.0, abs=1e-9)
    assert found.vertical_mean == pytest.approx(2.0, abs=1e-9)
    assert found.vertical_about_mean.rms < 1e-9
    assert found.yaw.rms == pytest.approx(np.deg2rad(3.0), abs=1e-9)
    assert found.roll.rms < 1e-9
    assert found.pitch.p95 < 1e-9


def test_tilt_is_the_angle_between_the_two_downs():
    found = score.score(circle(turn=(0.02, 0.0, 0.0)), circle())
    assert found.tilt.rms == pytest.approx(0.02, rel=0.02)  # times the cosine of pitch


@pytest.mark.parametrize("late", [0.13, -0.05])
@pytest.mark.parametrize("rates", [(50.0, 10.0), (10.0, 50.0)])
def test_an_estimate_that_is_late_is_told_by_how_much(late, rates):
    found = score.score(circle(rates[0], late=late), circle(rates[1]))
    assert found.lag == pytest.approx(late, abs=1e-3)  # the parabola over steps of 20 ms
    assert found.horizontal_without_lag < 0.05
    assert found.horizontal.rms == pytest.approx(4.0 * np.pi * abs(late), rel=0.02)


def test_nothing_that_stands_still_tells_a_lag():
    still = score.score(circle(radius=0.1), circle(radius=0.1))
    assert still.lag is None


def test_rows_before_the_skip_and_outside_the_window_do_not_count():
    whole = score.score(circle(), circle())
    found = score.score(circle(), circle(), 10.0, end_ns=25_000_000_000)
    assert found.start_ns == whole.start_ns + 10_000_000_000
    assert found.end_ns == 25_000_000_000
    assert found.horizontal.count == 501


def test_nothing_is_interpolated_over_a_gap():
    full, reference = circle(), circle(10.0)
    kept = (full.pos_t_ns < 10_000_000_000) | (full.pos_t_ns > 20_000_000_000)
    holed = Trajectory(
        name="holed",
        pos_t_ns=full.pos_t_ns[kept],
        lat=full.lat[kept],
        lon=full.lon[kept],
        alt=full.alt[kept],
        vel_t_ns=full.vel_t_ns,
        vel_n=full.vel_n,
        att_t_ns=full.att_t_ns,
        q_nb=full.q_nb,
    )
    found = score.score(holed, reference)
    assert found.horizontal.largest < 0.02  # the chord of 20 ms of the circle
    assert 190 < found.horizontal.count < 202


def test_series_without_common_time_have_no_score():
    early = circle()
    late = circle()
    late = Trajectory(
        name="late",
        pos_t_ns=late.pos_t_ns + 10**12,
        lat=late.lat,
        lon=late.lon,
        alt=late.alt,
        vel_t_ns=late.vel_t_ns[:0],
        vel_n=late.vel_n[:0],
        att_t_ns=late.att_t_ns[:0],
        q_nb=late.q_nb[:0],
    )
    found = score.score(early, late)
    assert found.horizontal is found.velocity is found.yaw is found.lag is None
    assert score.table([found])


def test_a_reference_without_vertical_velocity_is_compared_in_the_plane():
    reference = circle()
    reference.vel_n[:, 2] = np.nan
    found = score.score(circle(), reference)
    assert found.velocity.largest == 0.0


def estimate_columns(trajectory):
    columns = {name: np.zeros(len(trajectory.pos_t_ns)) for name in COLUMNS}
    columns["time_us"] = trajectory.pos_t_ns // 1000
    columns["lat_deg"], columns["lon_deg"] = np.rad2deg(trajectory.lat), np.rad2deg(trajectory.lon)
    columns["alt_m"] = trajectory.alt
    for index, axis in enumerate("ned"):
        columns[f"vel_{axis}"] = trajectory.vel_n[:, index]
    for index, part in enumerate("wxyz"):
        columns[f"q_{part}"] = trajectory.q_nb[:, index]
    return columns


def test_our_columns_and_our_csv_score_alike(tmp_path):
    columns = estimate_columns(circle(late=0.1))
    path = tmp_path / "estimate.csv"
    rows = zip(*(columns[name].tolist() for name in COLUMNS), strict=True)
    lines = [",".join(COLUMNS), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    direct = score.score(to_trajectory(columns), circle())
    read = score.score(read_estimate(path), circle())
    assert read.horizontal == direct.horizontal
    assert read.yaw == direct.yaw
    assert score.score(read_truth(path), circle()).velocity == direct.velocity


def test_rows_before_the_alignment_are_left_out():
    columns = estimate_columns(circle())
    for name in COLUMNS[1:]:
        columns[name] = columns[name].astype(float)
        columns[name][:100] = np.nan
    assert len(to_trajectory(columns).pos_t_ns) == 1400


def test_a_file_without_the_columns_is_refused(tmp_path):
    path = tmp_path / "estimate.csv"
    path.write_text("time_us,lat_deg\n1,2\n")
    with pytest.raises(LogError, match="no column 'lon_deg'; there are: time_us, lat_deg"):
        read_estimate(path)


def test_scores_stand_beside_each_other_and_go_into_json():
    found = score.score(circle(offset=(1.0, 0.0, 0.0)), circle())
    lines = score.table([found, found])
    assert any(line.startswith("horizontal, m") and line.count("1.000") == 6 for line in lines)
    flat = found.to_dict()
    assert flat["horizontal_m"]["rms"] == pytest.approx(1.0, abs=1e-5)
    assert flat["yaw_deg"]["max"] < 1e-5


def test_a_figure_is_drawn(tmp_path):
    path = tmp_path / "figure.png"
    trajectory_figure.plot(path, [circle(late=0.3), circle(10.0)], "a circle")
    assert path.read_bytes().startswith(b"\x89PNG")


def test_without_matplotlib_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(CompanionError, match=r"pip install 'ekf-companion\[plot\]'"):
        trajectory_figure.plot(tmp_path / "figure.png", [circle()])


@pytest.mark.parametrize(
    ("name", "window", "horizontal", "velocity", "roll", "yaw"),
    [
        # What the recordings' own README found, by another program.
        ("sitl-arducopter-square", (196.98, 297.58), 0.096, 0.041, 0.101, 0.900),
        ("sitl-px4-square", (143.80, 204.52), 0.260, 0.409, 1.222, 1.249),
    ],
)
def test_the_autopilots_own_error_is_what_was_found_before(
    name, window, horizontal, velocity, roll, yaw
):
    path = DATA / name / "flight.tlog"
    if not path.is_file():
        pytest.skip(f"the recorded flight {name} is not on this machine")
    log = tlog.read(path)
    start_ns, end_ns = (round(edge * 1e9) for edge in window)
    found = score.score(
        log_source.reference(log),
        log_source.truth(log),
        start_ns=start_ns,
        end_ns=end_ns,
    )
    assert found.horizontal.rms == pytest.approx(horizontal, rel=0.02)
    assert found.velocity.rms == pytest.approx(velocity, rel=0.03)
    assert np.rad2deg(found.roll.rms) == pytest.approx(roll, rel=0.02)
    assert np.rad2deg(found.yaw.rms) == pytest.approx(yaw, rel=0.02)
