"""Damaged recordings are read as they were meant, or refused, by a sentence that names it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks import lidar_memory
from ekf_companion.errors import LogError
from ekf_companion.lidar.readers import read
from sim_autopilot.lidar.motion import Motion
from sim_autopilot.lidar.record import simulate
from sim_autopilot.lidar.write import write_sequence
from tests.lidar.recordings import arrays, small


def damaged(path, edit):
    """Write the small recording after `edit(lidar, imu)`."""
    flown = small()
    write_sequence(path, flown)
    lidar, imu = arrays(flown)
    edit(lidar, imu)
    np.savez(path / "lidar.npz", **lidar)
    np.savez(path / "imu.npz", **imu)
    return path


def change(which, name, function):
    def edit(lidar, imu):
        arrays = {"lidar": lidar, "imu": imu}[which]
        arrays[name] = function(arrays[name])

    return edit


def empty(lidar, imu):
    begin, end = lidar["first"][10], lidar["first"][11]
    lidar["first"][11:] -= end - begin
    for name in ("xyz", "dt", "ring"):
        lidar[name] = np.delete(lidar[name], np.s_[begin:end], 0)


def doubled(lidar, imu):
    lidar["stamp"][31::20] = lidar["stamp"][30:-1:20][: len(lidar["stamp"][31::20])]


def backwards(lidar, imu):
    for begin, end in zip(lidar["first"][:-1], lidar["first"][1:], strict=True):
        part = lidar["dt"][begin:end]
        lidar["dt"][begin:end] = part.max() - part


def at_the_end(lidar, imu):
    lidar["stamp"] = lidar["stamp"] + 0.1
    lidar["dt"] = lidar["dt"] * float(lidar["tick"]) - 0.1
    lidar["tick"] = 1.0


def gap(lidar, imu):
    for name in imu:
        imu[name] = np.delete(imu[name], np.s_[1000:1100], 0)


def axes(order, sign=(1, 1, 1)):
    def edit(lidar, imu):
        for name in ("gyro", "accel"):
            imu[name] = imu[name][:, order] * np.array(sign, np.float32)

    return edit


def without_times(lidar, imu):
    del lidar["dt"]


def shuffled(lidar, imu):
    order = np.random.default_rng(0).permutation(len(imu["stamp"]))
    for name in imu:
        imu[name] = imu[name][order]


def other_clock(lidar, imu):
    counts = np.diff(lidar["first"])
    lidar["dt"] = np.repeat(lidar["stamp"], counts) + lidar["dt"] * float(lidar["tick"]) + 1e5
    lidar["tick"] = 1.0


def set_back(lidar, imu):
    lidar["stamp"][80:] -= 5.0


def bad_times(lidar, imu):
    lidar["dt"][::97] = 65535


def not_finite(lidar, imu):
    imu["gyro"][100:150] = np.nan


def dead(lidar, imu):
    imu["gyro"][:], imu["accel"][:] = 0.0, 0.0


MENDED = {
    "an empty scan": (empty, "1 scans are empty (the first is scan 10): left out"),
    "stamps doubled": (doubled, "scans repeat the stamp of another (the first is scan 31"),
    "stored last first": (
        lambda lidar, imu: reverse_scans(lidar),
        "scans are stored last first",
    ),
    "times backwards": (backwards, "times of points count backwards"),
    "stamps of the end, by motion": (
        change("lidar", "stamp", lambda stamp: stamp + 0.1),
        "stamps are of the end of a scan: the scans agree",
    ),
    "stamps of the end, by times": (
        at_the_end,
        "stamps are of the end of a scan by the points' times",
    ),
    "ns in stamps of scans": (
        change("lidar", "stamp", lambda stamp: stamp * 1e9),
        "stamps of scans are nanoseconds",
    ),
    "ns in stamps of samples": (
        change("imu", "stamp", lambda stamp: stamp * 1e9),
        "stamps of inertial samples are nanoseconds",
    ),
    "ns in times of points": (
        change("lidar", "tick", lambda tick: tick * 1e9),
        "times of points (dt) are nanoseconds",
    ),
    "g": (change("imu", "accel", lambda accel: accel / 9.80665), "specific force is in g"),
    "a gap": (gap, "inertial samples are missing 1 times, 0.50 s in all"),
    "no times": (without_times, "points have no time of their own"),
    # Not listed in the issue
    "samples shuffled": (shuffled, "times (first at number"),
    "times of another clock": (other_clock, "seconds on another clock, 100000.0"),
    "a clock set back": (set_back, "the clock of scans was set back 1 times (first at number 80"),
    "some times wrong": (bad_times, "points with times outside the scan: those points are left"),
    "samples not finite": (not_finite, "50 inertial samples are not finite: left out"),
    "points in mm": (
        change("lidar", "unit", lambda unit: unit * 1000),
        "points are in millimetres",
    ),
    "stamps of arrival": (
        change(
            "lidar",
            "stamp",
            lambda stamp: stamp + np.random.default_rng(0).uniform(0, 0.012, len(stamp)),
        ),
        "stamps of scans jitter by",
    ),
    "scans 0.2 s late": (
        change("lidar", "stamp", lambda stamp: stamp + 0.2),
        "s late by the gyro: corrected",
    ),
    "a second without scans": (
        lambda lidar, imu: cut_scans(lidar),
        "scans are missing 1 times, 1.0 s in all",
    ),
}


def reverse_scans(lidar):
    order = np.arange(len(lidar["stamp"]))[::-1]
    parts = [np.arange(lidar["first"][k], lidar["first"][k + 1]) for k in order]
    for name in ("xyz", "dt", "ring"):
        lidar[name] = lidar[name][np.concatenate(parts)]
    lidar["stamp"] = lidar["stamp"][order]
    lidar["first"] = np.cumsum([0, *map(len, parts)])


def cut_scans(lidar):
    begin, end = lidar["first"][60], lidar["first"][70]
    for name in ("xyz", "dt", "ring"):
        lidar[name] = np.delete(lidar[name], np.s_[begin:end], 0)
    lidar["stamp"] = np.delete(lidar["stamp"], np.s_[60:70])
    lidar["first"] = np.concatenate((lidar["first"][:60], lidar["first"][70:] - (end - begin)))


@pytest.mark.parametrize("name", MENDED)
def test_what_can_be_mended_is_named_and_read(tmp_path, name):
    edit, words = MENDED[name]
    recording = read(damaged(tmp_path / "r", edit))
    assert any(words in sentence for sentence in recording.decisions), recording.decisions
    stamps = np.array([scan.stamp for scan in recording.scans])
    assert (np.diff(stamps) > 0).all()
    if name not in ("stamps of arrival", "scans 0.2 s late"):
        # Whatever was done to it, the stamps are those of the simulator again
        middle = 0.05 if name == "no times" else 0.0
        nearest = np.abs(stamps[:, None] - middle - small().stamp).min(axis=1)
        assert nearest.max() < 1e-3
    assert all((scan.times > -1e-9).all() for scan in recording.scans)


REFUSED = {
    "x and y exchanged": (axes([1, 0, 2], (1, -1, 1)), "axes of gyro and lidar"),
    "all axes exchanged": (axes([2, 0, 1]), "axes of gyro and lidar"),
    "forward, right, down": (axes([0, 1, 2], (1, -1, -1)), r"read as \(x, -y, -z\)"),
    "gyro in degrees": (change("imu", "gyro", np.degrees), "the gyro is in deg/s"),
    "another clock": (
        change("lidar", "stamp", lambda stamp: stamp + 1.7e9),
        "share no time; stamp both by one clock",
    ),
    "no point in any scan": (change("lidar", "xyz", lambda xyz: xyz * 0), "empty, all"),
    "a dead sensor": (dead, "samples are the same"),
    # Not listed in the issue
    "samples of another time": (
        lambda lidar, imu: imu.update(gyro=imu["gyro"][::-1].copy()),
        "do not turn as the gyro says",
    ),
    "one stamp for all": (
        change("lidar", "stamp", lambda stamp: stamp * 0 + 1.0),
        "different stamps, two at least",
    ),
    "gravity too small": (change("imu", "accel", lambda accel: accel * 0.35), "neither m/s2 nor g"),
    "a mirrored gyro": (
        change("imu", "gyro", lambda gyro: gyro * np.array([1, 1, -1], np.float32)),
        "axes of gyro and lidar",
    ),
}


@pytest.mark.campaign
@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_mended_is_refused_by_name(tmp_path, name):
    edit, words = REFUSED[name]
    with pytest.raises(LogError, match=words) as caught:
        read(damaged(tmp_path / "r", edit))
    assert str(caught.value).startswith("r: ") or "r/" in str(caught.value)


def test_a_mounting_turned_by_a_quarter_is_refused(tmp_path):
    path = damaged(tmp_path / "r", lambda lidar, imu: None)
    calib = json.loads((path / "calib.json").read_text())
    calib["T_imu_lidar"]["R"] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    (path / "calib.json").write_text(json.dumps(calib))
    with pytest.raises(LogError, match="give the lidar's mounting"):
        read(path)


def test_small_errors_are_left_to_the_filter(tmp_path):
    """12 ms and 2.8 deg are what its states of delay and mounting find."""
    path = damaged(tmp_path / "r", change("imu", "stamp", lambda stamp: stamp + 0.012))
    calib = json.loads((path / "calib.json").read_text())
    c, s = np.cos(np.radians(2.8)), np.sin(np.radians(2.8))
    calib["T_imu_lidar"]["R"] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    (path / "calib.json").write_text(json.dumps(calib))
    recording = read(path)
    assert any("scans and gyro agree" in sentence for sentence in recording.decisions)
    assert [scan.stamp for scan in recording.scans] == list(small().stamp)


@pytest.mark.parametrize("seed", [82, 83])
def test_rings_on_bare_ground_that_hardly_turn_contradict_no_gyro(tmp_path, seed):
    """They turn with the lidar, and lie on those before best if they are not turned at all."""
    drive = Motion(lidar_memory.along)
    scene = lidar_memory.avenue(np.random.default_rng(seed))
    write_sequence(
        tmp_path / "r", simulate("street", seed, duration=8.0, scene=scene, motion=drive)
    )
    said = read(tmp_path / "r").decisions
    assert "the motion does not show whether scans and gyro agree" in said


def test_an_undamaged_recording_names_its_decisions_and_no_damage(tmp_path):
    decisions = " ".join(read(damaged(tmp_path / "r", lambda lidar, imu: None)).decisions)
    for word in ("left out", "not seconds", "missing", "late", "jitter", "backwards", "of the end"):
        assert word not in decisions
    assert "scans and gyro agree" in decisions
