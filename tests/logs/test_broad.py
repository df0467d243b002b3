import numpy as np
import pytest
from scipy.io import savemat

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs import broad
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from ekf_companion.replay.read import read

RATE = 2000.0 / 7.0


def content(n=50):
    half = np.sqrt(0.5)
    quat = np.tile([half, 0.0, 0.0, -half], (n, 1))  # forward (y) points east
    quat[10:20] = np.nan
    return {
        "imu_gyr": np.tile([0.1, 0.2, 0.3], (n, 1)),
        "imu_acc": np.tile([0.0, 0.0, 9.81], (n, 1)),
        "imu_mag": np.tile([-20.0, 0.0, -45.0], (n, 1)),  # north is to the left
        "opt_quat": quat,
        "opt_pos": np.zeros((n, 3)),
        "sampling_rate": RATE,
        "movement": (np.arange(n) >= 30).astype(np.uint8).reshape(-1, 1),
    }


def written(path, **changes):
    values = content() | changes
    savemat(path, {name: value for name, value in values.items() if value is not None})
    return path


def test_axes_frames_and_units_become_ours(tmp_path):
    recording = broad.read(written(tmp_path / "trial.mat"))
    imu = recording.events.take(recording.events.kind == Kind.IMU)
    mag = recording.events.take(recording.events.kind == Kind.MAG)
    np.testing.assert_allclose(imu.values[0, :6], [0.2, 0.1, -0.3, 0.0, 0.0, -9.81])
    np.testing.assert_allclose(mag.values[0, :3], [0.0, -0.2, 0.45])
    np.testing.assert_array_equal(imu.t_ns, np.rint(np.arange(50) * 3.5e6))
    np.testing.assert_array_equal(imu.t_ns, mag.t_ns)
    np.testing.assert_allclose(so3.to_euler(recording.truth.q_nb[0]), [0, 0, np.pi / 2], atol=1e-12)


def test_field_gravity_and_truth_agree(tmp_path):
    recording = broad.read(written(tmp_path / "trial.mat"))
    q_nb = recording.truth.q_nb[0]
    values = recording.events.values[recording.events.kind == Kind.MAG][0, :3]
    np.testing.assert_allclose(so3.rotate(q_nb, values), [0.2, 0.0, 0.45], atol=1e-12)


def test_hidden_truth_is_left_out_and_the_movement_comes_along(tmp_path):
    recording = broad.read(written(tmp_path / "trial.mat"))
    assert len(recording.truth.att_t_ns) == 40
    assert np.diff(recording.truth.att_t_ns).max() > 30e6
    counted = recording.counted.at(np.array([-1, 0, 29 * 3_500_000, 30 * 3_500_000]))
    np.testing.assert_array_equal(counted, [False, False, False, True])


def test_a_truth_that_was_never_seen_is_none(tmp_path):
    path = written(tmp_path / "trial.mat", opt_quat=np.full((50, 4), np.nan))
    assert broad.read(path).truth is None


def test_rows_that_were_lost_are_left_out(tmp_path):
    gyro = content()["imu_gyr"]
    gyro[5] = np.nan
    events = broad.read(written(tmp_path / "trial.mat", imu_gyr=gyro)).events
    assert (events.kind == Kind.IMU).sum() == 49
    assert (events.kind == Kind.MAG).sum() == 50


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"imu_mag": None}, "has no imu_mag"),
        ({"imu_acc": np.zeros((49, 3))}, "differ in length"),
        ({"imu_gyr": np.zeros((50, 2))}, "not of"),
        ({"imu_gyr": np.array([["a"] * 3] * 50)}, "not of"),
        ({"imu_gyr": np.zeros((0, 3))}, "empty"),
        ({"sampling_rate": None}, "sampling_rate"),
        ({"sampling_rate": -3.0}, "sampling_rate"),
        ({"sampling_rate": "fast"}, "sampling_rate"),
        ({"movement": np.ones((50, 2))}, "differ in length"),
    ],
)
def test_what_is_no_trial_is_refused_in_words(tmp_path, changes, words):
    path = written(tmp_path / "trial.mat", **changes)
    with pytest.raises(LogError, match=words) as caught:
        broad.read(path)
    assert str(path) in str(caught.value)


def test_damage_anywhere_is_refused_or_survived(tmp_path):
    whole = written(tmp_path / "trial.mat").read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(60):
        data = bytearray(whole[: rng.integers(1, len(whole))] if rng.random() < 0.5 else whole)
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        path = tmp_path / "damaged.mat"
        path.write_bytes(bytes(data))
        try:
            broad.read(path)
        except LogError as error:
            refused += "damaged.mat" in str(error)
    assert refused > 20


def test_something_else_by_that_name_is_refused(tmp_path):
    path = tmp_path / "other.mat"
    path.write_bytes(b"no matlab file at all" * 40)
    with pytest.raises(LogError, match=r"other\.mat: is no MATLAB file"):
        broad.read(path)
    with pytest.raises(LogError, match="no such file"):
        broad.read(tmp_path / "missing.mat")


def test_it_is_known_by_its_suffix(tmp_path):
    recording = read(written(tmp_path / "trial.mat"), Config())
    assert (recording.events.kind == Kind.IMU).sum() == 50
    assert recording.truth is not None
    assert recording.counted is not None


def test_the_recorded_trial_is_read(flight):
    recording = broad.read(flight("broad-attitude/01_undisturbed_slow_rotation_A.mat"))
    assert (recording.events.kind == Kind.IMU).sum() == 56940
    assert len(recording.truth.att_t_ns) == 56940 - 162
    counted = recording.counted.is_counted
    assert counted.sum() == 36007
