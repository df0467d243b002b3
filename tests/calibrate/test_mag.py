import numpy as np
import pytest

from ekf_companion.calibrate import ellipsoid, mag
from ekf_companion.calibrate.result import lines
from ekf_companion.config.config import Config, parse_config
from ekf_companion.core.settings.settings import FilterSettings
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError
from ekf_companion.nav import so3
from ekf_companion.nav.measurements import Kind
from ekf_companion.yaml_file import YamlLoader
from sim_autopilot import events as wire
from sim_autopilot.config import CompassConfig, SimConfig
from sim_autopilot.flight import Flight
from tests.calibrate.recordings import fly, without

FIELD = 0.48
HARD = np.array([0.2, -0.1, 0.05])
SOFT = np.array([[1.1, 0.03, -0.02], [0.03, 0.92, 0.04], [-0.02, 0.04, 1.03]])
SETTINGS = FilterSettings()


def tumbled(count=3000, noise=0.005, seed=1):
    """Return a field of constant strength from all directions, shape (n, 3), gauss."""
    rng = np.random.default_rng(seed)
    ways = rng.standard_normal((count, 3))
    ways *= FIELD / np.linalg.norm(ways, axis=1, keepdims=True)
    return ways + noise * rng.standard_normal((count, 3))


def turned(dip=1.1, count=1500, noise=0.005, seed=1):
    """Return what a level vehicle sees that turns about its down axis."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.0, 4.0 * np.pi, count)
    flat = FIELD * np.cos(dip)
    ways = [flat * np.cos(angle), -flat * np.sin(angle), np.full(count, FIELD * np.sin(dip))]
    return np.stack(ways, axis=1) + noise * rng.standard_normal((count, 3))


def spoilt(field_b, hard=HARD, soft=SOFT):
    """Return what a magnetometer says whose numbers the correction brings back to the field."""
    return field_b @ np.linalg.inv(soft).T + hard


def test_an_ellipsoid_gives_its_iron_back():
    found = mag.measure_field(spoilt(tumbled()), FIELD)
    assert found.method == "ellipsoid"
    assert found.share == 1.0
    assert np.allclose(found.fit.hard, HARD, atol=0.002)
    assert np.allclose(found.fit.soft, SOFT, atol=0.01)
    assert np.all(np.abs(found.fit.hard - HARD) < 4.0 * found.fit.hard_std)
    assert found.fit.rms < 0.006 < found.rms_before


def test_what_the_worst_samples_say_counts_little():
    field = spoilt(tumbled())
    field[::20] += np.random.default_rng(2).uniform(-0.5, 0.5, (len(field[::20]), 3))
    found = mag.measure_field(field, FIELD)
    assert np.allclose(found.fit.hard, HARD, atol=0.01)
    assert np.allclose(found.fit.soft, SOFT, atol=0.03)


def test_how_long_a_direction_is_held_does_not_matter():
    held = np.concatenate([tumbled(), np.tile(tumbled(1), (3000, 1))])
    found = mag.measure_field(spoilt(held), FIELD)
    assert np.allclose(found.fit.hard, HARD, atol=0.005)


def test_largest_and_smallest_values_give_what_stands_along_the_axes():
    stretched = np.diag([1.1, 0.9, 1.0])
    found = mag.measure_field(spoilt(tumbled(noise=0.0), soft=stretched), FIELD)
    assert np.allclose(found.by_extremes.hard, HARD, atol=0.005)
    assert np.allclose(found.by_extremes.soft, stretched, atol=0.01)
    assert found.by_extremes.rms < 0.005


def test_without_a_place_the_strength_is_the_samples_own():
    found = mag.measure_field(tumbled() + HARD, None)
    assert not found.is_place_known
    assert found.strength == pytest.approx(FIELD, rel=0.01)
    assert np.allclose(found.fit.hard, HARD, atol=0.003)


def test_flat_turns_give_hard_iron_as_unsure_as_soft_iron_makes_it():
    rng = np.random.default_rng(4)
    ratios = []
    for seed in range(20):
        bend = ellipsoid.LIKELY_SOFT * rng.standard_normal((3, 3))
        soft = np.eye(3) + np.diag(np.diag(bend)) + np.triu(bend, 1) + np.triu(bend, 1).T
        found = mag.measure_field(spoilt(turned(seed=seed), soft=soft), FIELD)
        assert found.method == "hard iron"
        ratios.append((found.fit.hard - HARD) / found.fit.hard_std)
    spread = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((spread > 0.4) & (spread < 1.6))


@pytest.mark.parametrize("strength", [None, FIELD])
def test_flat_turns_that_leave_an_axis_open_name_it(strength):
    # without a place nothing is known of down; near the magnetic equator its slope is none
    field = turned(dip=0.05 if strength else 1.1) + HARD
    found = mag.measure_field(field, strength)
    assert found.method == "circle"
    assert found.determined.tolist() == [True, True, False]
    assert np.allclose(found.fit.hard[:2], HARD[:2], atol=0.01)
    assert found.fit.hard[2] == 0.0
    result = mag.result(found)
    assert any("hard iron down is not determined" in note for note in result.notes)
    assert result.to_dict("log")["determined"] == {"forward": True, "right": True, "down": False}
    assert "down not determined" in result.settings[0].comment


@pytest.mark.parametrize("strength", [None, FIELD])
def test_a_vehicle_that_has_hardly_turned_is_refused(strength):
    still = np.array([0.2, 0.1, 0.42]) + 0.005 * np.random.default_rng(1).standard_normal((500, 3))
    with pytest.raises(LogError, match=r"^x\.bin: the vehicle has hardly turned"):
        mag.measure_field(still, strength, "x.bin")


def test_a_log_without_a_magnetometer_is_refused():
    with pytest.raises(LogError, match=r"^x\.bin: holds no samples of a magnetometer"):
        mag.measure(without(fly("hover", 60.0), Kind.MAG), SETTINGS, "x.bin")


@pytest.mark.parametrize("name", ["figure-eight", "loiter", "walk"])
def test_the_simulators_hard_iron_is_found(name):
    found = mag.measure(fly(name, 60.0, compass=CompassConfig(hard_iron=tuple(HARD))), SETTINGS)
    assert np.allclose(found.fit.hard, HARD, atol=0.01)
    assert found.is_place_known
    assert found.strength == pytest.approx(FIELD, abs=0.01)


def test_a_compass_without_iron_is_left_alone():
    result = mag.result(mag.measure(fly("figure-eight", 60.0), SETTINGS))
    assert not result.settings[0].is_sure
    assert result.settings[0].comment.endswith("no more than its uncertainty: leave it as it is")


def test_what_is_printed_brings_the_heading_back():
    import yaml

    hard = (0.12, -0.1, 0.05)
    flown = Flight.plan(
        "figure-eight", SimConfig(compass=CompassConfig(hard_iron=hard)), duration=60.0
    )
    events = wire.events(flown, has_vel_down=True)
    recording = fly("figure-eight", 60.0, compass=CompassConfig(hard_iron=hard))
    text = "\n".join(lines("mag", mag.result(mag.measure(recording, SETTINGS))))
    config = parse_config(yaml.load(text, YamlLoader), "printed")
    late = slice(5000, None)
    truth = so3.to_euler(wire.truth(flown).q_nb)[late, 2]
    errors = []
    for settings in (SETTINGS, config):
        yaw = Pipeline(settings).run(events).column("yaw")[late]
        errors.append(np.degrees(np.sqrt(np.mean(so3.wrap(yaw - truth) ** 2))))
    assert errors[1] < 1.0
    # the filter finds much of it by itself, in so many turns
    assert errors[1] < errors[0]


def broad(flight, name):
    """Return the magnetometer of a BROAD trial, gauss, and the attitude of the motion capture."""
    from scipy.io import loadmat

    trial = loadmat(flight(f"broad-attitude/{name}.mat"))
    mag_b, q = trial["imu_mag"] * 0.01, trial["opt_quat"]
    known = np.isfinite(mag_b).all(axis=1) & np.isfinite(q).all(axis=1)
    return mag_b[known], q[known]


def by_attitude(mag_b, q):
    """Return the hard iron and the field's strength that agree best with a known attitude."""
    turns = np.swapaxes(so3.to_matrix(q), 1, 2)
    rows = np.concatenate([turns, np.broadcast_to(np.eye(3), turns.shape)], axis=2).reshape(-1, 6)
    terms = np.linalg.lstsq(rows, mag_b.ravel(), rcond=None)[0]
    return terms[3:], float(np.linalg.norm(terms[:3]))


def test_a_recorded_sensor_turned_all_ways_agrees_with_motion_capture(flight):
    mag_b, q = broad(flight, "01_undisturbed_slow_rotation_A")
    truth, strength = by_attitude(mag_b, q)
    clean = mag.measure_field(mag_b, strength)
    assert clean.method == "ellipsoid"
    # the field of the room differs by 0.012 gauss RMS from place to place
    assert np.allclose(clean.fit.hard, truth, atol=0.012)
    again = mag.measure_field(spoilt(mag_b), strength)
    restored = again.fit.apply(spoilt(mag_b))
    assert np.abs(restored - clean.fit.apply(mag_b)).max() < 0.015
    assert again.fit.rms < 0.01 < 0.1 < again.rms_before


def test_a_recorded_sensor_hardly_turned_is_as_unsure_as_it_says(flight):
    mag_b, q = broad(flight, "15_undisturbed_fast_translation_A")
    truth, strength = by_attitude(mag_b, q)
    found = mag.measure_field(mag_b, strength)
    assert found.method == "hard iron"
    assert np.all(np.abs(found.fit.hard - truth) < 2.0 * found.fit.hard_std)


def test_a_recorded_flight_of_a_simulator_needs_no_correction(flight):
    from ekf_companion.replay.read import read

    log = flight("sitl-arducopter-bin/flight.bin")
    found = mag.measure(read(log, Config()), Config())
    assert np.abs(found.fit.hard).max() < 0.005
    assert not mag.result(found).settings[0].is_sure
