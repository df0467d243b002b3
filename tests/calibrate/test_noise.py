from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.calibrate import fixes, noise, rest
from ekf_companion.calibrate.result import lines
from ekf_companion.config.config import Config, parse_config
from ekf_companion.core.settings.settings import FilterSettings, GnssSettings, ImuSettings
from ekf_companion.errors import LogError
from ekf_companion.nav.measurements import Kind
from ekf_companion.yaml_file import YamlLoader
from sim_autopilot.config import GnssConfig, ImuConfig
from tests.calibrate.recordings import fly, without

SETTINGS = FilterSettings()
SLOW = GnssConfig(noise_h=0.2, noise_v=0.3, slow_h=1.0, slow_v=1.5, slow_time=20.0, noise_vel=0.07)


def measured(recording, settings=SETTINGS):
    result = noise.result(noise.measure(recording, settings), settings)
    return {one.key: one for one in result.settings}, result


def test_the_inertial_noise_of_a_standing_vehicle_is_what_was_put_in():
    found, _ = measured(fly("static", 120.0, ImuConfig(rate=100.0)))
    assert found["imu.gyro_noise"].value == pytest.approx(3e-4, rel=0.05)
    assert found["imu.accel_noise"].value == pytest.approx(3e-3, rel=0.05)
    assert found["imu.gyro_noise"].is_sure
    # two minutes bound a walk, and say no more: 5e-5 and 2e-3 over 300 s walk by 4e-6 and 1.6e-4
    assert not found["imu.gyro_bias_walk"].is_sure
    assert found["imu.gyro_bias_walk"].value > 4e-6
    assert not found["imu.accel_bias_walk"].is_sure
    assert found["imu.accel_bias_walk"].value > 1.6e-4


def test_a_low_pass_is_seen_through_but_does_not_lower_what_is_set():
    found, result = measured(fly("static", 120.0, ImuConfig(rate=100.0, lowpass=20.0)))
    assert found["imu.gyro_noise"].value == pytest.approx(3e-4, rel=0.1)
    assert found["imu.accel_noise"].value == pytest.approx(3e-3, rel=0.1)
    assert not found["imu.gyro_noise"].is_sure
    assert any("low-passed at about 2" in note for note in result.notes)


def test_more_noise_than_is_set_is_a_key_behind_a_low_pass_too():
    low = FilterSettings(imu=ImuSettings(gyro_noise=1e-4, accel_noise=1e-3))
    found, _ = measured(fly("static", 120.0, ImuConfig(rate=100.0, lowpass=20.0)), low)
    assert found["imu.gyro_noise"].is_sure
    assert found["imu.accel_noise"].is_sure


def test_the_walk_of_a_bias_shows_in_a_long_rest():
    wandering = ImuConfig(
        rate=50.0, accel_bias_instability=0.02, accel_bias_time=300.0, gyro_bias_instability=5e-4
    )
    found, _ = measured(fly("static", 1500.0, wandering))
    for sensor, sigma in (("gyro", 5e-4), ("accel", 0.02)):
        assert found[f"imu.{sensor}_bias_walk"].is_sure
        truth = sigma * np.sqrt(2.0 / 300.0)
        assert found[f"imu.{sensor}_bias_walk"].value == pytest.approx(truth, rel=0.5)


@pytest.mark.parametrize("name", ["static", "figure-eight", "hover", "loiter"])
def test_a_receiver_scatters_in_flight_as_it_does_at_rest(name):
    found = noise.measure(fly(name, 400.0, gnss=SLOW), SETTINGS).receivers[-1]
    assert found.state == ("at rest" if name == "static" else "in flight")
    # steps of the slow error count as white: 1 m over 20 s makes 0.1 m from one fix to the next
    assert found.horizontal.white == pytest.approx(0.2, rel=0.15)
    assert found.height.white == pytest.approx(0.3, rel=0.15)
    assert found.velocity.white == pytest.approx(0.07, rel=0.1)
    assert found.stated == pytest.approx((np.hypot(0.2, 1.0), np.hypot(0.3, 1.5), 0.07))
    assert found.horizontal.slow == pytest.approx(1.0, rel=0.4)
    assert 8.0 < found.horizontal.time < 50.0


def test_the_antennas_lever_arm_is_no_noise():
    arm = GnssConfig(noise_h=0.02, noise_v=0.02, noise_vel=0.02, lever_arm=(2.0, 0.0, 0.0))
    flown = fly("figure-eight", 120.0, gnss=arm)
    measured_arm = GnssSettings(lever_arm=arm.lever_arm, lever_arm_std=0.01, velocity_std=0.02)
    told = FilterSettings(gnss=measured_arm)
    own = fixes.find(flown)
    still = rest.find(flown.events, SETTINGS.align, 10.0)
    seen, unseen = (fixes.in_flight(flown, one, own, still) for one in (told, SETTINGS))
    assert seen.horizontal.white == pytest.approx(0.02, rel=0.3)
    # the estimate, which is not told of a receiver this good, is off by as much again
    assert 0.014 < seen.velocity.white < 0.04
    assert seen.velocity.slow < 0.5 * unseen.velocity.slow


def test_floors_that_do_no_harm_stay():
    found, _ = measured(fly("figure-eight", 120.0, gnss=SLOW))
    assert found["gnss.position_std"].is_sure  # 0.2 m, 0.1 is set
    assert found["gnss.velocity_std"].is_sure  # 0.07 m/s, 0.05 is set
    exact = GnssConfig(noise_h=0.01, noise_v=0.02, noise_vel=0.03)
    found, _ = measured(fly("figure-eight", 120.0, gnss=exact))
    assert found["gnss.position_std"].is_sure  # it claims 0.01 m, and keeps it
    assert found["gnss.position_std"].value == pytest.approx(0.01, rel=0.3)


def test_what_is_printed_is_a_configuration():
    import yaml

    _, result = measured(fly("static", 400.0, gnss=SLOW))
    text = "\n".join(lines("calibrate noise", result))
    config = parse_config(yaml.load(text, YamlLoader), "printed")
    assert config.imu.gyro_noise == pytest.approx(3e-4, rel=0.05)
    assert config.gnss.position_std == pytest.approx(0.2, rel=0.1)
    assert max(map(len, text.splitlines())) <= 100


def test_a_log_without_rest_tells_of_the_receiver_alone():
    found, result = measured(fly("figure-eight", 120.0))
    assert not any(key.startswith("imu.") for key in found)
    assert any("s of rest found, 20 s are needed" in note for note in result.notes)


def test_a_log_without_fixes_tells_of_the_inertial_sensors_alone():
    found, result = measured(without(fly("static", 60.0), Kind.GNSS))
    assert not any(key.startswith("gnss.") for key in found)
    assert any("no GNSS fix of its own" in note for note in result.notes)


def test_a_log_that_tells_nothing_is_refused():
    with pytest.raises(
        LogError, match=r"^x\.bin: shows nothing of the noise: .*rest.*; .*no GNSS fix"
    ):
        noise.measure(without(fly("hover", 60.0), Kind.GNSS), SETTINGS, "x.bin")


def test_telemetry_is_not_judged():
    recording = fly("static", 60.0)
    imu = np.flatnonzero(recording.events.kind == Kind.IMU)
    kept = np.ones(len(recording.events), dtype=bool)
    kept[imu] = np.arange(len(imu)) % 10 == 0
    found, result = measured(replace(recording, events=recording.events.take(kept)))
    assert not any(key.startswith("imu.") for key in found)
    assert any("samples come at 5.0 Hz" in note for note in result.notes)


def test_a_recorded_simulator_has_the_noise_that_it_documents(flight):
    from ekf_companion.replay.read import read

    log = flight("sitl-px4-ulg/flight.ulg")
    found = noise.measure(read(log, Config()), Config()).receivers[-1]
    # its README: 0.2 m by axis (0.25 to 0.28 both together), 0.5 m, and 0.06 to 0.08 m/s
    assert found.horizontal.white == pytest.approx(0.17, abs=0.03)
    assert found.height.white == pytest.approx(0.5, abs=0.05)
    assert found.velocity.white == pytest.approx(0.07, abs=0.01)
