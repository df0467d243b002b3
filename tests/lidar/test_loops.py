"""The compiled loops, and the same files as plain Python: the same bits."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from ekf_companion.lidar import loops, voxel_map
from ekf_companion.lidar.settings import Settings


def plain(module):
    """Return a module's source run as plain Python."""
    path = Path(module.__file__)
    source = path.with_name(f"{path.name.partition('.')[0]}.py")
    spec = importlib.util.spec_from_file_location(f"plain_{source.stem}", source)
    made = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


PLAIN = plain(loops), plain(voxel_map)


@pytest.fixture(scope="module", params=["compiled", "plain"])
def either(request):
    if request.param == "plain":
        return PLAIN
    if not loops.__file__.endswith(".so"):
        pytest.skip("nothing is compiled here")
    return loops, voxel_map


def walls(seed, count=400):
    """Return points of the walls of a room."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3.0, 3.0, (count, 3))
    wall = rng.integers(0, 3, count)
    points[np.arange(count), wall] = rng.choice([-3.0, 3.0], count) + rng.normal(0, 0.02, count)
    return points


def filled(module):
    """Return a map of three parts of which one was forgotten, and what is far."""
    voxels = module.VoxelMap(Settings())
    for owner in range(3):
        voxels.insert(walls(owner), np.full(400, 4e-4), owner + np.linspace(0.0, 1.0, 400), owner)
    voxels.forget_owner(1)
    voxels.insert(walls(4), np.full(400, 4e-4), np.full(400, 3.0), 3)
    voxels.forget_far(np.array([0.5, -0.5, 0.0]), 3.5)
    return voxels


LATER = ("time", "sweep", "drift", "owner", "voxel")


def scan_sums(loops, voxel_map):
    """Return all that the loops make of a scan."""
    planes = filled(voxel_map).match(walls(7, 150))
    k, rng = len(planes.index), np.random.default_rng(8)
    path, states = np.array([0.0, 0.05]), rng.standard_normal((2, 21))
    stamp = rng.uniform(0.0, 0.1, k)
    step = (stamp > 0.05).astype(np.int64)
    turn, moved = np.empty((k, 9)), np.empty((k, 3))
    loops.carry(stamp, step, path, states, np.eye(3), turn, moved)
    pose, points = rng.standard_normal(37), rng.standard_normal((k, 3))
    y, q, rows = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 25))
    loops.place(points, 0.1 - stamp, turn, moved, pose, y, q)
    loops.differentiate(points, 0.1 - stamp, turn, y, q, planes.normal, pose, rows)
    along, group = planes.along.reshape(-1, 6), planes.owner % 2
    out, together = np.empty((k, 3)), np.full(k, 2)
    noise = np.array([0.02, 3e-4, 0.003, 500.0, 3.0])
    apart = rng.standard_normal((2, 9))
    loops.weigh(
        *(points, turn, pose, q, planes.normal, planes.centre, along, planes.spread),
        *(together, group, apart, rows, np.eye(6), noise, out),
    )
    A, B, sums = np.zeros((2, 9)), np.zeros((2, 9)), np.zeros((2, 9))
    weight = out[:, 2].copy()
    loops.sum_normals(planes.normal, along, weight, group, A, B)
    loops.sum_planes(planes.normal, along, weight, group, apart, sums)
    squares, products = np.zeros((50, 25)), np.zeros((2, 25))
    loops.sum_rows(rows, out[:, 0].copy(), weight, group, squares, products)
    return [turn, moved, y, q, rows, out, A, B, sums, squares, products]


def test_loops_give_the_same_bits_compiled_or_not():
    compiled, interpreted = scan_sums(loops, voxel_map), scan_sums(*PLAIN)
    for one, other in zip(compiled, interpreted, strict=True):
        assert np.array_equal(one, other)
    assert (compiled[5][:, 2] > 0.0).sum() > 20


def test_a_map_gives_the_same_bits_compiled_or_not():
    one, other = filled(voxel_map), filled(PLAIN[1])
    assert len(one) == len(other) > 50
    assert one.owners() == other.owners() == {0, 2, 3}
    assert np.array_equal(one.points(), other.points())
    a, b = (voxels.match(walls(9)) for voxels in (one, other))
    assert len(a.index) > 100
    for name in (*("index", "normal", "centre", "along", "spread"), *LATER):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def test_axes_are_those_of_the_points(either):
    rng = np.random.default_rng(5)
    for _ in range(20):
        axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        points = 0.5 + (rng.standard_normal((30, 3)) * [0.003, 0.1, 0.12]) @ axes.T
        points = np.clip(points, 0.05, 0.95)
        voxels = either[1].VoxelMap(Settings(voxel=1.0, levels=1))
        times = rng.uniform(0.0, 1.0, 30)
        voxels.insert(points, np.full(30, 4e-4), times, 0, rng.standard_normal((30, 3)))
        found = voxels.match(points.mean(axis=0)[None])
        size, expected = np.linalg.eigh(np.cov(points.T, bias=True))
        assert abs(found.normal[0] @ expected[:, 0]) == pytest.approx(1.0, abs=1e-9)
        assert found.spread[0, 1] == pytest.approx(size[0] * 30 / 27, rel=1e-6)
        # Times by places, whose variances have noise
        d = (points - points.mean(axis=0)) @ expected[:, 1:]
        across = d.T @ times / 30
        sweep = expected[:, 1:] @ (across / (size[1:] - 4e-4))
        assert np.allclose(found.sweep[0], sweep, rtol=1e-6, atol=1e-9)
        assert found.time[0] == pytest.approx(times.mean(), rel=1e-9)
        left = times.var() - across @ (across / size[1:])
        assert found.drift[0] == pytest.approx(found.spread[0, 1] / 30 / left, rel=1e-6)


def test_what_stays_is_found_when_much_is_forgotten(either):
    rng = np.random.default_rng(6)
    voxels = either[1].VoxelMap(Settings(levels=2))
    points = rng.uniform(-20.0, 20.0, (600, 3))
    for number, radius in enumerate((19.0, 12.0, 6.0)):
        voxels.insert(points, np.full(600, 4e-4), np.zeros(600), number)
        voxels.forget_far(np.zeros(3), radius)
    left = len(voxels)
    near = points[np.linalg.norm(points, axis=1) < 5.0]
    assert len(near) > 0
    voxels.insert(near, np.full(len(near), 4e-4), np.zeros(len(near)), 3)
    assert len(voxels) == left
