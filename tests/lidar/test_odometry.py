from __future__ import annotations

import base64
import html
import importlib.util
import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.lidar.planes import Planes
from ekf_companion.lidar.readers import read
from ekf_companion.lidar.recording import InertialSamples, Mounting, Scan
from ekf_companion.lidar.rows import Shared, _hold, _lean_var, _share
from ekf_companion.lidar.settings import Settings
from ekf_companion.lidar.solution import lines_of, solve
from ekf_companion.lidar.state import exp, log
from ekf_companion.lidar.track import BLOCK, Track
from ekf_companion.lidar.voxel_map import VoxelMap
from ekf_companion.nav.relative_pose import SINCE
from sim_autopilot.lidar.record import simulate
from sim_autopilot.lidar.write import write_sequence
from tests.paths import DATA

TOOL = DATA.parent / "tools" / "lidar_score.py"


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A walk in a simulated room, as a folder, and its recording."""
    folder = tmp_path_factory.mktemp("lidar") / "room"
    write_sequence(folder, simulate("room", 11, duration=9.0))
    return folder, read(folder)


@pytest.fixture(scope="module")
def solved(room):
    return solve(room[1], Settings())


@pytest.fixture(scope="module")
def score():
    if not TOOL.is_file():
        pytest.skip(f"{TOOL} is not here")
    spec = importlib.util.spec_from_file_location("lidar_score", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_pose_is_right_and_within_its_own_sigma(room, solved, score):
    found = score.score(str(room[0]), solved.poses, solved.covariances())
    assert found["ate_start_m"] < 0.05
    assert found["cov_not_positive"] == 0
    # 1 is consistent. A map that is taken as known gives tens; a mean rate that is taken for the
    # gyro's bias, because nothing moves yet, gives 5
    assert found["nees_position"]["mean"] < 3.0
    assert found["nees_rotation"]["mean"] < 3.0
    apart = score.score_relative(str(room[0]), solved.relatives())
    assert apart["rows"] >= 7
    assert apart["not_positive"] == 0
    assert 0.05 < apart["nees_pose"]["mean"] < 4.0


@pytest.mark.parametrize("begin", [4.4, 5.4, 6.4, 7.4])
def test_in_a_gap_of_the_samples_the_turns_are_found_by_the_points(room, score, begin):
    """Points that are placed by turns that were not measured match what they do not lie on."""
    inertial = room[1].inertial
    t = inertial.stamp - inertial.stamp[0]
    kept = (t < begin) | (t > begin + 0.6)
    cut = InertialSamples(inertial.stamp[kept], inertial.gyro[kept], inertial.accel[kept])
    found = solve(replace(room[1], inertial=cut), Settings())
    scored = score.score(str(room[0]), found.poses, found.covariances())
    assert scored["ate_start_m"] < 0.05
    assert scored["nees_position"]["mean"] < 3.0
    assert scored["nees_rotation"]["mean"] < 3.0


def without(recording, gaps):
    """Return a recording without samples and points at some times, s since its begin."""
    inertial, kept = recording.inertial, np.ones(len(recording.inertial.stamp), bool)
    origin = inertial.stamp[0]
    scans = []
    for begin, end in gaps:
        kept &= (inertial.stamp - origin < begin) | (inertial.stamp - origin > end)
    for scan in recording.scans:
        t = scan.stamp + scan.times - origin
        seen = np.all([(t < begin) | (t > end) for begin, end in gaps], axis=0)
        if seen.any():
            scans.append(Scan(scan.stamp, scan.points[seen], scan.times[seen]))
    cut = InertialSamples(inertial.stamp[kept], inertial.gyro[kept], inertial.accel[kept])
    return replace(recording, inertial=cut, scans=scans)


@pytest.mark.parametrize("gaps", [[(4.4, 5.0)], [(0.9, 2.4)], [(3.9, 4.5), (5.1, 5.7)]])
def test_after_a_gap_of_samples_and_points_the_place_in_the_map_is_found_again(room, score, gaps):
    """An update alone finds the nearest of many poses: some ended 70 m off."""
    found = solve(without(room[1], gaps), Settings())
    assert [one.is_found for one in found.unknown] == [True] * len(gaps)
    scored = score.score(str(room[0]), found.poses, found.covariances())
    assert scored["ate_start_m"] < 0.05
    assert scored["nees_position"]["mean"] < 3.0
    assert scored["nees_rotation"]["mean"] < 3.0
    assert found.verdict().startswith("good: ")
    assert any("found again" in line for line in found.remarks())


def test_what_is_not_found_again_is_off_by_no_more_than_its_sigma(room, score):
    """Turned by half a turn most of the room looks the same, and two seconds leave that open."""
    found = solve(without(room[1], [(5.4, 7.4)]), Settings())
    assert [one.is_found for one in found.unknown] == [False]
    assert found.verdict().startswith("poor: ")
    assert any("not found again" in line for line in found.remarks())
    scored = score.score(str(room[0]), found.poses, found.covariances())
    assert scored["nees_position"]["mean"] < 3.0
    assert scored["nees_rotation"]["mean"] < 3.0
    apart = score.score_relative(str(room[0]), found.relatives())
    assert apart["nees_pose"]["mean"] < 4.0


def test_a_gyro_at_the_end_of_its_range_costs_no_honesty(room, score):
    inertial = room[1].inertial
    limit = np.radians(60.0)
    assert (np.abs(inertial.gyro) > limit).sum() > 50
    narrow = replace(inertial, gyro=np.clip(inertial.gyro, -limit, limit))
    found = solve(replace(room[1], inertial=narrow), Settings())
    assert any("end of their range" in line for line in found.remarks())
    scores = score.score(str(room[0]), found.poses, found.covariances())
    assert scores["ate_6dof_m"] < 0.01
    assert scores["nees_rotation"]["mean"] < 5.0
    # With clipped rates taken as they are, and their points placed by them, 300 and 500
    apart = score.score_relative(str(room[0]), found.relatives())
    assert apart["nees_position"]["mean"] < 3.0
    assert apart["nees_rotation"]["mean"] < 3.0


@pytest.mark.campaign
def test_a_mounting_that_is_found_is_found_within_its_own_sigma(tmp_path, score):
    write_sequence(tmp_path, simulate("room", 33, duration=16.0))
    whole = read(tmp_path)
    wrong = whole.mounting.rotation @ exp(np.radians([1.0, -1.5, 2.0]))
    shifted = whole.mounting.position + np.array([0.02, -0.03, 0.02])
    guess = Mounting(wrong, shifted, np.radians(3.0), 0.05)
    found = solve(replace(whole, mounting=guess), Settings(is_mounting_estimated=True))
    last = found.track.last
    error = np.concatenate(
        [
            log(last.state.C_bl.T @ whole.mounting.rotation),
            whole.mounting.position - last.state.pos_b,
        ]
    )
    assert np.linalg.norm(error[:3]) < np.radians(0.2)
    assert np.linalg.norm(error[3:]) < 0.02
    # A map whose points are taken to be where a wrong mounting put them claims 0.01 deg
    sigma = np.sqrt(np.diag(last.P)[17:23])
    assert (np.abs(error) < 4.0 * sigma).all()
    apart = score.score_relative(str(tmp_path), found.relatives())
    assert apart["nees_position"]["mean"] < 3.0
    assert apart["nees_rotation"]["mean"] < 3.0


@pytest.mark.campaign
def test_a_map_that_is_taken_as_known_claims_more(room, solved):
    known = solve(room[1], Settings(anchors=0))
    assert known.sigma < 0.7 * solved.sigma


@pytest.mark.campaign
def test_empty_scans_are_bridged_by_the_inertial_samples(room, solved):
    def holed():
        for k, scan in enumerate(room[1].scans):
            if 50 <= k < 55:
                yield Scan(scan.stamp, np.zeros((0, 3)), np.zeros(0))
            else:
                yield scan

    bridged = solve(replace(room[1], scans=list(holed())), Settings())
    assert len(bridged.poses) == pytest.approx(len(solved.poses), abs=1)
    assert np.count_nonzero(~bridged.track.is_matched) >= 5
    apart = np.linalg.norm(bridged.poses[-1, 1:4] - solved.poses[-1, 1:4])
    assert apart < 0.05


def test_a_recording_without_points_ends_in_a_verdict(room):
    scans = [Scan(one.stamp, np.zeros((0, 3)), np.zeros(0)) for one in room[1].scans]
    assert solve(replace(room[1], scans=scans), Settings()).verdict().startswith("poor: ")


def test_outputs_have_the_columns_that_are_promised(solved):
    count = len(solved.track)
    assert all(len(line.split()) == 8 for line in lines_of(solved, ".tum"))
    head, *rows = lines_of(solved, ".csv")
    assert len(rows) == count
    assert {len(row.split(",")) for row in rows} == {len(head.split(","))}
    assert {len(line.split(",")) for line in lines_of(solved, "rel")} == {30}
    assert {len(line.split(",")) for line in lines_of(solved, "cov")} == {22}
    ply = "\n".join(lines_of(solved, "ply")).split("\n")
    assert len(ply) == 7 + len(solved.points)


def planes(normal, sigma, rng):
    """Return planes with these normals, each with noise, one row each."""
    k = len(normal)
    axes = [np.linalg.svd(one[None])[2][1:] for one in normal]
    along = sigma * np.array(axes)
    noisy = normal + np.einsum("nk,nki->ni", rng.standard_normal((k, 2)), along)
    noisy /= np.linalg.norm(noisy, axis=1)[:, None]
    index, none = np.arange(k), np.zeros(k, dtype=np.int64)
    nothing, still = np.zeros((k, 3)), np.zeros(k)
    made = Planes(
        index, noisy, nothing, along, np.zeros((k, 2)), still, nothing, still, none, index
    )
    return Shared.of(made, none, 1)


@pytest.mark.parametrize("seed", range(8))
def test_noise_of_normals_does_not_hold_the_way_along_a_tunnel(seed):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0.0, 2.0 * np.pi, 400)
    walls = np.column_stack([np.zeros(400), np.cos(angle), np.sin(angle)])
    bare = planes(walls, 0.06, rng)
    found = _hold(bare, np.ones(400))
    assert found.is_lost[-1].tolist() == [True, False, False]
    assert abs(found.directions[0, 0]) > 0.99
    closed = planes(np.vstack([walls, np.tile([1.0, 0.0, 0.0], (40, 1))]), 0.06, rng)
    found = _hold(closed, np.ones(440))
    assert not found.is_lost.any()


def test_a_voxel_finds_its_plane_and_how_well_it_knows_it():
    rng, normal = np.random.default_rng(1), np.array([0.6, 0.0, 0.8])
    axes = np.linalg.svd(normal[None])[2][1:]
    offsets = []
    for _ in range(40):
        points = rng.uniform(-0.2, 0.2, (60, 2)) @ axes + rng.normal(0, 0.02, (60, 1)) * normal
        points += np.array([0.5, 0.5, 0.5])
        voxels = VoxelMap(Settings(voxel=1.0, levels=1, range_bias=0.0))
        voxels.insert(points, np.full(60, 4e-4), np.zeros(60), 3)
        found = voxels.match(np.array([[0.5, 0.5, 0.5], [9.0, 9.0, 9.0]]))
        assert found.index.tolist() == [0]
        assert found.owner.tolist() == [3]
        assert abs(found.normal[0] @ normal) > 0.99
        distance = float(found.normal[0] @ (np.array([0.5, 0.5, 0.5]) - found.centre[0]))
        offsets.append(distance**2 / found.spread[0, 0])
    # Chi-square of 40 draws over its degrees of freedom: 99.9 % are within
    assert 0.4 < np.mean(offsets) < 2.0


def test_a_few_points_of_each_scan_are_enough_for_the_map(room, score):
    found = solve(room[1], Settings(most_map_points=1200))
    scored = score.score(str(room[0]), found.poses, found.covariances())
    assert scored["ate_start_m"] < 0.05
    assert scored["nees_position"]["mean"] < 3.0


def test_a_way_that_was_mostly_without_hold_is_not_good(tmp_path):
    """A sparse lidar that leaves rest in a street: what seems to hold may be false."""
    path = tmp_path / "street"
    write_sequence(path, simulate("street", 503, duration=9.0))
    found = solve(read(path), Settings())
    assert sum(one.end - one.start for one in found.open_stretches()) > 4.5
    assert found.verdict().startswith("poor: ")


def test_a_sparse_lidar_leaves_rest_in_a_street(tmp_path, score):
    """What a ray strikes as the vehicle moves is a plane, which leans as the motion was wrong."""
    path = tmp_path / "street"
    write_sequence(path, simulate("street", 501, duration=9.0))
    found = solve(read(path), Settings())
    scored = score.score(str(path), found.poses, found.covariances())
    # 9.6 m if the map has the error of its part's mean pose, and a sigma of 0.03 m
    assert scored["ate_start_m"] < 3.0
    assert found.sigma > 0.06


def swept(speed: float, number: int) -> Planes:
    """Return the plane of a wall x = 5.4 m that a ray strikes as it is thought to move along x.

    The ray goes forward and to the left; the wall is put in ``speed`` times the time too far.
    """
    rng, t = np.random.default_rng(3), np.linspace(0.0, 1.0, 120)
    made = np.column_stack([5.4 + speed * t, 0.2 + 0.6 * t, rng.uniform(0.1, 0.9, 120)])
    made[:, 0] += rng.normal(0.0, 0.02, 120)
    rays = np.column_stack([np.ones(120), 0.02 * (np.arange(120) % number), np.zeros(120)])
    voxels = VoxelMap(Settings(voxel=1.0, levels=1))
    voxels.insert(made, np.full(120, 4e-4), t, 0, rays)
    return voxels.match(np.array([[5.5 + speed, 0.79, 0.5]]))


def test_a_plane_of_one_ray_has_the_error_of_the_pose_that_put_it_in():
    plane = swept(0.1, 1)
    q = np.array([[5.5, 0.8, 0.5]])
    assert abs(plane.sweep[0, 1]) == pytest.approx(1.0 / 0.6, rel=0.05)
    # Of the last moment it is the present one; a second later the part's has its share
    assert _share(plane, q, np.array([0.5]), 1.0)[0] < 0.05
    assert _share(plane, q, np.array([0.5]), 2.0)[0] == pytest.approx(2.0 / 3.0, abs=0.05)
    # Its lean is that of the velocity, which rays of three azimuths would show
    P_vel = 0.3**2 * np.eye(3)
    assert np.sqrt(_lean_var(plane, P_vel)[0]) == pytest.approx(0.3 / 0.6, rel=0.1)
    assert _lean_var(swept(0.0, 3), P_vel)[0] < _lean_var(swept(0.0, 1), P_vel)[0]


def test_what_is_far_or_of_a_gone_anchor_is_forgotten():
    voxels = VoxelMap(Settings())
    points = np.random.default_rng(2).uniform(0.0, 20.0, (500, 3))
    voxels.insert(points[:250], np.full(250, 4e-4), np.zeros(250), 0)
    voxels.insert(points[250:], np.full(250, 4e-4), np.zeros(250), 1)
    voxels.forget_owner(0)
    assert voxels.owners() == {1}
    voxels.forget_far(np.zeros(3), 5.0)
    assert len(voxels) < 100
    assert (np.linalg.norm(voxels.points(), axis=1) < 5.5).all()


def test_the_command_writes_what_is_asked_for(room, tmp_path):
    out, rel = tmp_path / "way.tum", tmp_path / "rel.csv"
    arguments = ["lidar", str(room[0]), "-o", str(out), "--rel", str(rel), "--json"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["verdict"].startswith("good: ")
    assert len(out.read_text().splitlines()) > 80
    assert len(rel.read_text().splitlines()) >= 7


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["-o", "way.xyz"], 2, ".tum, .csv or .mcap"),
        (["--lidar-pose", "1,2,3"], 2, "six numbers"),
        (["--find", "north"], 2, "mounting or delay"),
        (["--stamp", "late"], 2, "start, middle or end"),
        (["--report", "way.pdf"], 2, "is a .html"),
        (["--filter", "kalman"], 2, "anchors, lins, fast-lio or doppler"),
        (["--nearest", "90"], 2, "beyond"),
    ],
)
def test_a_wrong_option_is_refused_in_a_sentence(room, words, code, says):
    done = CliRunner().invoke(app, ["lidar", str(room[0]), *words])
    assert done.exit_code == code
    assert says in done.stderr


def fits(schema, value):
    """Return whether a JSON schema names every part of a value: Foxglove shows no others."""
    if schema["type"] == "object":
        parts = schema["properties"]
        return set(parts) == set(value) and all(fits(parts[name], value[name]) for name in parts)
    if schema["type"] == "array":
        return all(fits(schema["items"], one) for one in value)
    return isinstance(
        value, {"number": (int, float), "integer": int, "string": str}[schema["type"]]
    )


def test_an_mcap_holds_what_the_csv_says_and_the_map(room, solved, tmp_path):
    out = tmp_path / "way.mcap"
    done = CliRunner().invoke(app, ["lidar", str(room[0]), "-o", str(out)])
    assert done.exit_code == 0, done.stderr
    found = {}
    with out.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
            assert fits(json.loads(schema.data), json.loads(message.data)), schema.name
            data = json.loads(schema.data)["properties"].get("data", {})
            assert data.get("contentEncoding") == ("base64" if channel.topic == "/map" else None)
    head, *rows = (line.split(",") for line in lines_of(solved, ".csv"))
    of_poses = head.index(SINCE)
    assert len(found["/pose"]) == len(found["/tf"]) == len(found["/estimate"]) == len(rows)
    for row, (ns, data) in zip(rows, found["/estimate"], strict=True):
        numbers = json.loads(data)
        assert ns == round(float(row[0]) * 1e9)
        assert [numbers[name] for name in head[1:of_poses]] == [*map(float, row[1:of_poses])]
    cloud = json.loads(found["/map"][0][1])
    points = np.frombuffer(base64.b64decode(cloud["data"]), np.float32).reshape(-1, 3)
    assert np.allclose(points, solved.points, atol=1e-4)  # float32, some 10 m away
    assert json.loads(found["/log"][0][1])["message"] == solved.verdict()


def test_the_report_shows_track_map_holds_and_innovations(room, tmp_path):
    out = tmp_path / "way.html"
    done = CliRunner().invoke(app, ["lidar", str(room[0]), "--report", str(out)])
    assert done.exit_code == 0, done.stderr
    text = out.read_text()
    assert done.stdout.splitlines()[0] in html.unescape(text)
    for word in ("from above", "sigma of position", "share that is more than noise", "RMS"):
        assert word in text
    assert "<script src=" not in text


def test_what_is_kept_of_an_estimate_is_numbers_alone(room, solved):
    # 133 kB of each scan as a view of all the anchors' covariance, 7 kB as objects
    track = Track()
    tracemalloc.start()
    try:
        for k in range(2 * BLOCK):
            track.add(replace(solved.track.last, stamp=float(k), relative=None))
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size < 800 * 2 * BLOCK
    assert track.stamp.tolist() == list(range(2 * BLOCK))
    last = solved.track.last
    assert np.array_equal(track.covariance[-1], last.P[:9, :9])
    assert np.array_equal(track.attitude[0], last.state.C_wb)
    assert np.array_equal(track.hold[BLOCK], last.match.hold)


def test_scan_to_scan_is_worse_than_a_map_and_says_so(room, solved, score):
    alone = solve(room[1], Settings(is_scan_to_scan=True))
    found = score.score(str(room[0]), alone.poses, alone.covariances())
    mapped = score.score(str(room[0]), solved.poses, solved.covariances())
    assert mapped["ate_start_m"] < found["ate_start_m"] < 1.0
    assert alone.sigma > 2.0 * solved.sigma
    assert found["nees_position"]["mean"] < 3.0


def test_a_recording_that_is_not_there_is_named():
    done = CliRunner().invoke(app, ["lidar", "nowhere.mcap"])
    assert done.exit_code == 3
    assert "nowhere.mcap" in done.stderr


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "limit"), [("room_walk", 0.03), ("street_drive", 0.1), ("forest_flight", 0.1)]
)
def test_the_sequences_are_solved_honestly(score, name, limit):
    path = DATA / "lidar" / name
    if not path.is_dir():
        pytest.skip(f"{path} is not here")
    solution = solve(read(path), Settings())
    found = score.score(str(path), solution.poses, solution.covariances())
    apart = score.score_relative(str(path), solution.relatives())
    assert found["ate_4dof_m"] <= limit
    assert found["nees_position"]["mean"] <= 3.0
    assert found["nees_rotation"]["mean"] <= 3.0
    assert apart["nees_position"]["mean"] <= 2.0
    assert apart["nees_rotation"]["mean"] <= 2.0
