"""All forms of one recording give the same numbers, to the precision of the form."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers import read
from sim_autopilot.lidar.write import write_bag, write_sequence
from tests.lidar import recordings
from tests.lidar.recordings import after, points, small

FORMS = ["npz", "ascii", "binary", "binary_compressed", "a.bag", "a.mcap", "a.db3"]


@pytest.mark.parametrize("form", FORMS)
def test_all_forms_give_the_same_bits(tmp_path, form):
    flown = small()
    path = tmp_path / form
    if "." in form:
        write_bag(path, flown)
    else:
        recordings.write_folder(path, flown, form)
    recording = read(path)
    scans = list(recording.scans)
    assert len(scans) == len(flown.stamp)
    for k, scan in enumerate(scans):
        assert scan.stamp == round(flown.stamp[k] * 1e9) / 1e9
        assert np.array_equal(scan.points, points(flown, k).astype(np.float32))
        assert np.array_equal(scan.times, np.round(after(flown, k) * 1e9) / 1e9)
    assert np.array_equal(recording.inertial.gyro, flown.gyro)
    assert np.array_equal(recording.inertial.accel, flown.accel)
    stamps = np.round(flown.imu_stamp * 1e9) / 1e9
    assert np.allclose(recording.inertial.stamp, stamps, rtol=1e-15, atol=0)
    if "." in form:  # the others have no mounting
        assert np.allclose(recording.mounting.position, flown.lidar.position, rtol=0, atol=1e-15)


def test_the_sequence_gives_the_stored_numbers(tmp_path):
    flown = small()
    write_sequence(tmp_path / "s", flown)
    for k, scan in enumerate(read(tmp_path / "s").scans):
        assert scan.stamp == flown.stamp[k]
        assert np.array_equal(scan.points, points(flown, k))
        assert np.array_equal(scan.times, after(flown, k))
        assert np.array_equal(scan.ring, flown.ring[flown.first[k] : flown.first[k + 1]])


@pytest.mark.parametrize(
    ("dialect", "epoch", "within", "words"),
    [
        ("t", 1.7e9, 1e-9, "times of points (t) are nanoseconds after the stamp"),
        ("time", 0.0, 1e-8, "times of points (time) are seconds after the stamp"),  # float32
        ("timestamp", 0.0, 1e-12, "seconds on the clock of the stamps"),
        ("timestamp", 1.7e9, 3e-7, "seconds on the clock of the stamps"),  # float64 since 1970
        ("timestamp in ns", 1.7e9, 5e-7, "nanoseconds on the clock of the stamps"),
        ("none", 0.0, None, "points have no time of their own"),
        ("CustomMsg", 0.0, 1e-15, "times of points (offset_time) are nanoseconds"),
    ],
)
def test_each_dialect_of_time_is_named_and_read(tmp_path, dialect, epoch, within, words):
    flown = small()
    livox = dialect == "CustomMsg"
    recordings.write_dialect(
        tmp_path / "b", flown, "t" if livox else dialect, epoch=epoch, livox=livox
    )
    recording = read(tmp_path / "b")
    assert any(words in sentence for sentence in recording.decisions)
    for k, scan in enumerate(recording.scans):
        assert np.array_equal(scan.points, points(flown, k).astype(np.float32))
        middle = 0.05 if dialect == "none" else 0.0  # taken at once, in its middle
        assert scan.stamp == pytest.approx(flown.stamp[k] + epoch + middle, abs=3e-7)
        if within:
            assert np.allclose(scan.times, after(flown, k), rtol=0, atol=within)
        else:
            assert not scan.times.any()


def test_scans_are_read_anew_in_each_pass(tmp_path):
    write_bag(tmp_path / "a.bag", small())
    scans = read(tmp_path / "a.bag").scans
    first, second = next(iter(scans)), next(iter(scans))
    assert np.array_equal(first.points, second.points)


def test_a_bag_that_was_cut_is_named_with_its_remedy(tmp_path):
    for name in ("a.bag", "a.mcap", "a.db3"):
        path = tmp_path / name
        write_bag(path, small())
        file = path if path.is_file() else next(path.glob(f"*{path.suffix}"))
        file.write_bytes(file.read_bytes()[: file.stat().st_size * 3 // 5])
        with pytest.raises(LogError, match=r"a\.(bag|mcap|db3)") as caught:
            read(path)
        assert "reindex" in str(caught.value) or "damaged" in str(caught.value)


def test_a_topic_that_is_missing_is_named_with_those_that_are_there(tmp_path):
    write_bag(tmp_path / "a.bag", small())
    with pytest.raises(LogError, match=r"no topic /imu2 of inertial samples .*found: .*/points"):
        read(tmp_path / "a.bag", imu="/imu2")


@pytest.mark.parametrize("name", ["imu.csv", "imu.npz"])
def test_missing_inertial_samples_are_an_error(tmp_path, name):
    path = tmp_path / "r"
    if name == "imu.csv":
        recordings.write_folder(path, small(), "npz")
    else:
        write_sequence(path, small())
    (path / name).unlink()
    with pytest.raises(LogError, match=f"{name}: no such file"):
        read(path)
