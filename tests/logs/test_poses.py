"""Files of poses that another estimator has written: forms, what they state, what is refused."""

import numpy as np
import pytest

from ekf_companion.errors import LogError
from ekf_companion.logs.poses import read
from ekf_companion.nav import so3
from ekf_companion.nav.relative_pose import COVARIANCE, LEVEL, SINCE, UPPER, square

N = 31
T = 1_700_000_000.0 + 0.1 * np.arange(N)


def poses(seed=1):
    """Return positions and attitudes of a way that turns and climbs."""
    rng = np.random.default_rng(seed)
    s = 0.1 * np.arange(N)
    euler = np.cumsum(rng.normal(0.0, 0.05, (N, 3)), axis=0)
    return np.column_stack([np.sin(s), 2.0 * s, 0.3 * s]), so3.from_euler(*euler.T)


def rows_of(stamps, pos, q, order, mark):
    return "".join(
        mark.join([f"{t}", *(f"{one:.12g}" for one in (*p, *r[order]))]) + "\n"
        for t, p, r in zip(stamps, pos, q, strict=True)
    )


def covariances(count, seed=2):
    root = np.random.default_rng(seed).normal(0.0, 0.01, (count, 6, 6))
    return root @ root.transpose(0, 2, 1)


def relative(pos, q, every=10):
    """Return relative poses of every so many, with covariances."""
    k = np.arange(0, N, every)
    step = so3.rotate(so3.conjugate(q[k[:-1]]), pos[k[1:]] - pos[k[:-1]])
    turn = so3.multiply(so3.conjugate(q[k[:-1]]), q[k[1:]])[:, [1, 2, 3, 0]]
    P = covariances(len(k) - 1)
    return np.column_stack([T[k[:-1]], T[k[1:]], step, turn, P[:, UPPER[0], UPPER[1]]]), P


def save(path, rows):
    path.write_text(
        "".join(
            ",".join([f"{r[0]:.6f},{r[1]:.6f}", *map(repr, r[2:].tolist())]) + "\n" for r in rows
        )
    )
    return path


@pytest.mark.parametrize("form", ["tum", "euroc", "euroc with velocity"])
def test_poses_without_a_covariance_are_read_in_their_forms(tmp_path, form):
    pos, q = poses()
    path = tmp_path / "poses.txt"
    if form == "tum":
        path.write_text("# t x y z qx qy qz qw\n" + rows_of(T, pos, q, [1, 2, 3, 0], " "))
    else:
        text = rows_of([f"{round(t * 10) * 10**8}" for t in T], pos, q, [0, 1, 2, 3], ",")
        if form != "euroc":
            text = text.replace("\n", ",0.1,0.2,0.3\n")
        path.write_text("#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z\n" + text)
    found = read(path)
    np.testing.assert_allclose(found.pos_w, pos, atol=1e-9)
    np.testing.assert_allclose(so3.to_matrix(found.q_wp), so3.to_matrix(q), atol=1e-9)
    np.testing.assert_allclose(found.t_ns * 1e-9, T, atol=1e-6)
    assert found.drift is None
    assert found.is_level


def test_relative_poses_are_composed_and_state_their_drift(tmp_path):
    pos, q = poses()
    rows, P = relative(pos, q)
    found = read(save(tmp_path / "rel.csv", rows))
    first = so3.to_matrix(q[0])
    np.testing.assert_allclose(found.pos_w, (pos[::10] - pos[0]) @ first, atol=1e-9)
    assert not found.is_level
    C = so3.to_matrix(found.q_wp)
    np.testing.assert_allclose(found.drift.way[2], C[1] @ P[1, :3, :3] @ C[1].T, rtol=1e-6)
    np.testing.assert_allclose(found.drift.turn[2], C[2] @ P[1, 3:, 3:] @ C[2].T, rtol=1e-6)
    assert found.drift.level == pytest.approx(np.sqrt(np.trace(P[:, 3:, 3:].sum(axis=0))))


def test_of_relative_poses_with_a_gap_the_longest_run_counts(tmp_path):
    rows, _ = relative(*poses(), every=5)
    found = read(save(tmp_path / "rel.csv", np.delete(rows, 1, axis=0)))
    assert len(found.t_ns) == len(rows) - 1
    assert "gap" in found.notes[0]


def test_relative_poses_that_overlap_are_refused(tmp_path):
    rows, _ = relative(*poses())
    rows[:, 0] -= 0.5
    with pytest.raises(LogError, match="overlap"):
        read(save(tmp_path / "rel.csv", rows))


def own(tmp_path, change=lambda cells: None):
    """Write the .csv of a lidar: a relative pose ends at each tenth row."""
    pos, q = poses()
    P = covariances(N)
    names = ["t_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "rows", LEVEL, SINCE, *COVARIANCE]
    lines = [",".join(names)]
    for k in range(N):
        cells = [
            f"{T[k]:.6f}",
            *map(repr, pos[k].tolist()),
            *map(repr, q[k, [1, 2, 3, 0]].tolist()),
        ]
        cells += ["800", "0.002"]
        if k and k % 10 == 0:
            cells += [f"{T[k - 10]:.6f}", *map(repr, P[k][UPPER].tolist())]
        else:
            cells += [""] * 22
        lines.append(",".join(cells))
    change(lines)
    path = tmp_path / "pose.csv"
    path.write_text("\n".join(lines) + "\n")
    return path, pos, so3.to_matrix(q), P


def test_the_csv_of_a_lidar_states_its_drift_for_each_row(tmp_path):
    path, pos, C, P = own(tmp_path)
    found = read(path)
    np.testing.assert_allclose(found.pos_w, pos, atol=1e-9)
    assert found.drift.level == 0.002
    for k in (1, 5, 10):  # per second, over a second
        np.testing.assert_allclose(found.drift.way[k], C[0] @ P[10, :3, :3] @ C[0].T, rtol=1e-5)
    np.testing.assert_allclose(found.drift.way[11], C[10] @ P[20, :3, :3] @ C[10].T, rtol=1e-5)
    np.testing.assert_allclose(found.drift.turn[30], C[30] @ P[30, 3:, 3:] @ C[30].T, rtol=1e-5)


def test_rows_that_are_no_pose_are_left_out_with_a_note(tmp_path):
    def damage(lines):
        lines[4] = lines[4].replace(lines[4].split(",")[1], "nan", 1)
        lines[8] = lines[7]

    found = read(own(tmp_path, damage)[0])
    assert len(found.t_ns) == N - 2
    assert "2 of 31 rows" in found.notes[0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "empty"),
        ("time,north\n1,2\n", "unknown form"),
        ("hello world\n", "unknown form"),
        ("1 2 3\n", "unknown form"),
        ("1,2,3,4,5,6,7,8\n2,2,3,4,5,6,7,8\n", "unknown form"),
        ("1 0 0 0 0 0 0 1\n", "1 poses"),
        ("1 0 0 0 0 0 0 3\n2 0 0 0 0 0 0 3\n", "0 poses"),
        ("1 0 0 0 0 0 0 1\n2 0 0\n", "different lengths"),
        ("\x00\x01\xff", "unknown form"),
    ],
)
def test_what_is_no_file_of_poses_is_refused_with_a_sentence(tmp_path, text, words):
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(LogError, match=words):
        read(path)


def test_a_covariance_is_the_same_out_of_its_triangle():
    P = covariances(3)
    np.testing.assert_array_equal(square(P[:, UPPER[0], UPPER[1]]), P)
