import pytest

from ekf_companion.errors import ConfigError
from sim_autopilot.config import SimConfig, load


def test_no_file_gives_the_defaults():
    assert load(None) == SimConfig()


def test_a_file_says_only_what_differs(tmp_path):
    path = tmp_path / "sim.yaml"
    path.write_text(
        "gnss: {lever_arm: [0.1, 0, -0.2], yaw: true}\nparameters: {EKF2_EV_CTRL: 15}\n"
    )
    config = load(path)
    assert config.gnss.lever_arm == (0.1, 0.0, -0.2)
    assert config.gnss.yaw
    assert config.gnss.rate == SimConfig().gnss.rate
    assert config.parameters == {"EKF2_EV_CTRL": 15.0}


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("imu: {rate: 0}", r"yaml: imu\.rate: expected float > 0"),
        ("imu: {rate: fast}", r"yaml: imu\.rate: expected float, got str"),
        ("imu: {gyro_nosie: 1}", "gyro_nosie"),
        ("gnss: {noise_h: -1}", "noise_h"),
        ("gnss: {lever_arm: [1, 2]}", "lever_arm"),
        ("home: {lat: 91}", "lat"),
        ("compass: {year: 1999}", "year"),
        ("imu: 5", "yaml: imu: expected table, got int"),
        ("[1, 2]", "sim.yaml"),
        ("a: [", "sim.yaml"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(tmp_path, text, word):
    path = tmp_path / "sim.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=word) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        load(tmp_path / "none.yaml")


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "sim.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="is not YAML"):
        load(path)
