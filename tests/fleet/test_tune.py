"""Tuning to a fleet: the steps to the top, the intervals, the keys, and flights of one vehicle."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from ekf_companion.calibrate.likelihood import cuts_at
from ekf_companion.calibrate.result import lines
from ekf_companion.cli import app
from ekf_companion.config.config import Config, load_config, parse_config
from ekf_companion.engine.pipeline import Pipeline
from ekf_companion.errors import LogError
from ekf_companion.fleet import tune
from ekf_companion.fleet.source import of_path
from ekf_companion.fleet.tune import (
    Fit,
    between_flights,
    interval_sigma,
    jackknife_sigma,
    left_out,
    newton_step,
)
from ekf_companion.fleet.tune_antenna import Antenna
from ekf_companion.fleet.tune_flight import Likelihood, Look, differences
from ekf_companion.fleet.tune_parameter import (
    BEGIN,
    DELAY,
    HIGH,
    LOW,
    PARAMETERS,
    SURE,
    WHITE_SHARE,
    configured,
    known,
    to_values,
    tuned,
)
from ekf_companion.fleet.tuned_settings import result
from ekf_companion.nav.measurements import Kind
from ekf_companion.yaml_file import YamlLoader
from sim_autopilot.__main__ import app as simulator
from sim_autopilot.config import GnssConfig, ImuConfig
from tests.calibrate.recordings import fly
from tests.fleet.in_place import InPlace

N = len(PARAMETERS)
NAMES = [one.name for one in PARAMETERS]
VEHICLE = """\
imu: {gyro_noise: 0.003, accel_noise: 0.05}
gnss: {noise_h: 0.4, noise_v: 0.6, slow_h: 1.0, slow_v: 1.5, noise_vel: 0.15, delay: 0.25,
  lever_arm: [0.3, -0.2, -0.1]}
"""
TRUTH = {"delay": 0.25, "position_std": 0.4, "height_std": 0.6, "velocity_std": 0.15}


def bowl(top, theta, curvature):
    """Return what a flight shows about theta whose likelihood is a parabola with a top."""
    off = top - theta
    return Look(float(-0.5 * off @ curvature @ off), curvature @ off, -curvature, 0.1)


def bowls(rng, theta, count, spread=0.01):
    """Return looks at flights whose tops scatter, and these tops."""
    root = rng.normal(size=(N, N))
    curvature = 1e4 * (root @ root.T + N * np.eye(N))
    tops = BEGIN + rng.normal(0.0, spread, (count, N))
    return [bowl(top, theta, curvature) for top in tops], tops


def test_a_parabola_is_climbed_in_one_step():
    theta = BEGIN + 0.2
    looks, tops = bowls(np.random.default_rng(1), theta, 7)
    assert theta + newton_step(looks) == pytest.approx(tops.mean(axis=0), abs=1e-5)  # the prior


def test_differences_show_a_parabola_as_it_is():
    look = bowls(np.random.default_rng(6), BEGIN, 1)[0][0]

    def parabola(theta):
        off = theta - BEGIN
        return look.value + look.slope @ off + 0.5 * off @ look.curvature @ off

    value, slope, curvature = differences(parabola, BEGIN)
    assert value == look.value
    assert slope == pytest.approx(look.slope, rel=1e-6, abs=1e-3)  # of 1e5, over steps of 0.01
    assert curvature == pytest.approx(look.curvature, rel=1e-6, abs=0.1)


def test_where_it_curves_upwards_the_step_still_goes_uphill():
    slope = np.zeros(N)
    slope[4] = 3.0
    step = newton_step([Look(0.0, slope, np.diag(np.full(N, 50.0)), 0.1)])
    assert step[4] > 0.0
    assert np.count_nonzero(step) == 1


def test_the_interval_is_that_of_a_mean_where_all_flights_show_as_much():
    theta = BEGIN
    looks, tops = bowls(np.random.default_rng(2), theta, 9)
    expected = tops.std(axis=0, ddof=1) / math.sqrt(9)
    assert jackknife_sigma(left_out(theta, looks)) == pytest.approx(expected, rel=1e-3)


def test_a_parameter_that_no_flight_shows_is_not_known():
    looks, _ = bowls(np.random.default_rng(5), BEGIN, 6)
    for one in looks:
        one.slope[6] = one.curvature[6, :] = one.curvature[:, 6] = 0.0
    assert jackknife_sigma(left_out(BEGIN, looks))[6] == pytest.approx(0.0, abs=1e-9)
    sigma = interval_sigma(left_out(BEGIN, looks), looks)
    assert sigma[6] > 10.0 * SURE[6]
    assert (np.delete(sigma, 6) < 0.1 * np.delete(SURE, 6)).all()


def test_a_flight_left_out_leaves_the_top_of_the_others():
    theta = BEGIN
    looks, tops = bowls(np.random.default_rng(3), theta, 5)
    others = left_out(tops.mean(axis=0), looks)
    rest = np.delete(tops, 2, axis=0).mean(axis=0)
    assert others[2] - others.mean(axis=0) == pytest.approx(rest - tops.mean(axis=0), abs=1e-5)


@pytest.mark.parametrize("spread", [0.0, 0.01, 0.03])
def test_the_scatter_of_the_delay_is_what_flights_do_not_know_of_it_themselves(spread):
    rng = np.random.default_rng(4)
    sigma = rng.uniform(0.002, 0.01, 400)
    looks = []
    for own in sigma:
        off, curvature = np.zeros(N), np.eye(N)
        off[DELAY] = rng.normal(0.0, math.hypot(own, spread))
        curvature[DELAY, DELAY] = own**-2
        looks.append(bowl(off, np.zeros(N), curvature))
    assert between_flights(looks) == pytest.approx(spread, abs=0.003)


def test_the_likelihood_falls_to_both_sides_of_the_truth():
    gnss = GnssConfig(noise_h=0.4, noise_v=0.6, slow_h=1.0, slow_v=1.5, noise_vel=0.15, delay=0.25)
    imu = ImuConfig(rate=50.0, gyro_noise=0.003, accel_noise=0.05)
    flown = fly("figure-eight", 60.0, imu=imu, gnss=gnss)
    ends = flown.events.t_ns[[0, -1]] * 1e-9
    cuts = cuts_at(flown, ends + np.array([15.0, 0.0]))
    of = Likelihood(flown, Pipeline(Config()).run(flown.events), cuts, Config())
    truth = np.array([0.25, 0, 0, 0, *np.log([0.4, 0.6, 0.15, 0.001, 0.05, 0.003])])
    top = of(truth)
    far = dict.fromkeys(NAMES, 0.7) | {"delay": 0.03}
    far |= {"forward": 0.5, "right": 0.5, "down": 0.5, "timing_std": 3.5}
    for i, name in enumerate(NAMES):
        for side in (-1.0, 1.0):
            other = truth + side * far[name] * np.eye(N)[i]
            if (other >= LOW).all():
                assert of(other) < top, (name, side)


def test_the_noise_of_the_gyro_makes_no_lever_arm_shorter():
    arm, gyro_noise = (0.6, -0.4, -0.3), 0.01  # 0.07 rad/s a sample, a third of the turns
    gnss = GnssConfig(noise_h=0.4, noise_v=0.6, noise_vel=0.05, delay=0.25, lever_arm=arm)
    imu = ImuConfig(rate=50.0, gyro_noise=gyro_noise, accel_noise=0.05)
    flown = fly("figure-eight", 60.0, imu=imu, gnss=gnss, seed=3)
    ends = flown.events.t_ns[[0, -1]] * 1e-9
    cuts = cuts_at(flown, ends + np.array([15.0, 0.0]))
    of = Likelihood(flown, Pipeline(Config()).run(flown.events), cuts, Config())
    truth = np.array([0.25, *arm, *np.log([0.4, 0.6, 0.05, 0.001, 0.05, gyro_noise])])
    far = 0.2 * np.eye(N)[1]
    up, middle, down = of(truth + far), of(truth), of(truth - far)
    top = arm[0] - 0.2 * (up - down) / (2.0 * (up + down - 2.0 * middle))
    assert top == pytest.approx(arm[0], rel=0.1)


def test_what_the_noise_of_the_rate_takes_of_the_likelihood_of_an_arm_is_known():
    arm, gyro_noise, rng = np.array([0.6, -0.4, -0.3]), 0.01, np.random.default_rng(1)
    gnss = GnssConfig(noise_h=0.4, noise_v=0.6, noise_vel=0.05, delay=0.25, lever_arm=tuple(arm))
    flown = fly("figure-eight", 40.0, imu=ImuConfig(rate=50.0, accel_noise=0.05), gnss=gnss)
    table, ends = Pipeline(Config()).run(flown.events), flown.events.t_ns[[0, -1]] * 1e-9
    of = Likelihood(flown, table, cuts_at(flown, ends + np.array([15.0, 0.0])), Config())
    theta = np.array([0.25, *arm, *np.log([0.4, 0.6, 0.05, 0.001, 0.05, gyro_noise])])
    fixes = np.count_nonzero(flown.events.kind == Kind.GNSS)
    value, expected = of(theta), of.noise_curvature(theta, of(theta))
    bandwidth, taken = Antenna(flown, table, Config()).bandwidth, []
    for _ in range(12):
        # What a rate of this noise adds to the velocities, where the vehicle is level
        noise = gyro_noise * math.sqrt(bandwidth) * rng.normal(size=(fixes, 3))
        off = np.cross(noise, arm)
        taken.append(value - 0.5 * (of(theta, off) + of(theta, -off)))
    assert np.mean(taken) == pytest.approx(0.5 * expected * float(arm @ arm), rel=0.25)


def a_fit(**changes):
    values = np.array([0.2513, 0.31, -0.2, -0.11, 0.4, 0.6, 0.15, 0.01, 0.05, 0.003])
    gains = np.stack([np.linspace(90.0, 110.0, 8), np.linspace(40.0, 60.0, 8)], axis=1)
    fit = Fit(
        values=values,
        low=values - 0.001,
        high=values + 0.001,
        is_shown=np.ones(N, dtype=bool),
        delay_std=0.0042,
        arm_std=0.031,
        flights=8,
        moves=3,
        gains=gains,
        refused=("logs/9.tlog: holds no GNSS fix",),
    )
    return replace(fit, **changes)


def pasted(fit):
    text = "\n".join(lines("fleet tune", result(fit, Config())))
    return text, parse_config(yaml.load(text, YamlLoader), "printed")


def test_what_is_printed_is_the_configuration_whose_gain_is_told():
    text, found = pasted(a_fit())
    assert found.gnss.lever_arm == (0.31, -0.2, -0.11)
    assert (found.gnss.position_std, found.gnss.white_share) == (0.4, WHITE_SHARE)
    assert (found.imu.accel_noise, found.imu.learn_noise) == (0.05, False)
    meant = a_fit().settings(Config())
    for one in PARAMETERS[4:]:
        section = "gnss" if one.name.endswith("_std") else "imu"
        printed, fitted = (getattr(getattr(x, section), one.name) for x in (found, meant))
        assert printed == pytest.approx(fitted, rel=2e-3), one.name
    assert meant.gnss.delay_std <= found.gnss.delay_std <= meant.gnss.delay_std + 0.001
    assert "left aside: logs/9.tlog: holds no GNSS fix" in text
    assert "chance" not in text


def test_where_learnt_noise_is_likelier_inertial_noise_is_no_key():
    text, found = pasted(a_fit(gains=a_fit().gains[:, ::-1]))
    assert found.imu == Config().imu
    assert found.gnss.white_share == "auto"
    assert found.gnss.position_std == 0.4
    assert "#accel_noise: 0.05" in text


def test_what_flights_do_not_show_stays_as_it_is():
    shown = np.ones(N, dtype=bool)
    shown[[DELAY, 2, 4, 9]] = False
    text, found = pasted(a_fit(is_shown=shown))
    present = Config()
    assert (found.gnss.delay, found.gnss.delay_std) == ("auto", "auto")
    assert found.gnss.lever_arm == (0.31, 0.0, -0.11)
    assert found.gnss.lever_arm_std == present.gnss.lever_arm_std
    assert found.gnss.position_std == present.gnss.position_std
    assert found.imu.gyro_noise == present.imu.gyro_noise
    assert text.count("these flights do not show it") == 4


@pytest.mark.parametrize("end", [LOW, HIGH])
def test_a_value_at_the_end_of_its_range_is_said_to_be_there(end):
    values = a_fit().values.copy()
    values[[DELAY, 7]] = to_values(end)[[DELAY, 7]]
    text = pasted(a_fit(values=values))[0]
    for key in ("delay", "timing_std"):
        (line,) = (one for one in text.splitlines() if one.lstrip(" #").startswith(f"{key}:"))
        assert "at the end of the range that is searched" in line
    assert text.count("at the end of") == 2


def test_a_gain_of_chance_is_said_to_be_one():
    gains = np.tile(np.array([[-30.0, -31.0], [33.0, 32.0]]), (4, 1))
    assert "no more than chance" in pasted(a_fit(gains=gains))[0]


def test_a_configuration_is_the_start_of_none_of_its_noises_lost():
    config = Config()
    theta = configured(config, 0.12)
    again = known(config, theta)
    assert again.gnss.position_std == pytest.approx(config.gnss.position_std)
    assert again.imu.gyro_noise == pytest.approx(config.imu.gyro_noise)
    assert (theta >= LOW).all()
    assert (theta <= HIGH).all()
    assert known(replace(config, weigh_faults="report"), theta) == again  # at a tenth of the time
    nothing = tuned(config, theta, np.zeros(N, dtype=bool), (0.01, 0.02), learns=True)
    assert nothing == config


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a function that writes a flight of the vehicle."""
    root = tmp_path_factory.mktemp("vehicle")
    (root / "vehicle.yaml").write_text(VEHICLE)

    def make(folder, seed, duration="50", scenario=None):
        log = folder / f"{seed}.tlog"
        scenario = scenario or ("figure-eight", "square-spiral")[seed % 2]
        options = ["--duration", duration, "--imu-rate", "50", "--seed", str(seed)]
        options += ["--scenario", scenario, "--config", str(root / "vehicle.yaml")]
        done = CliRunner().invoke(simulator, ["generate", "-o", str(log), *options])
        assert done.exit_code == 0, done.output
        return log

    return make


def fleet_tune(*arguments):
    return CliRunner().invoke(app, ["fleet", "tune", *map(str, arguments)])


def test_too_few_flights_are_a_sentence_that_says_what_was_wrong_with_them(made, tmp_path):
    sources = [of_path(made(tmp_path, seed, "12")) for seed in range(3)]
    (tmp_path / "9.tlog").write_bytes(b"no log at all" * 100)
    (tmp_path / "8.csv").write_text("time_s,gyro_x_dps\n0,1\n")
    sources += [of_path(tmp_path / name) for name in ("9.tlog", "8.csv")]
    with pytest.raises(LogError, match="only 0 flights can be used, of 4 at least; ") as refused:
        tune.tune(sources, Config(), InPlace())
    assert "s with a position, of 30 at least" in str(refused.value)
    assert str(refused.value).endswith("name more logs of this vehicle")


def test_three_flights_are_too_few(tmp_path):
    for name in "abc":
        (tmp_path / f"{name}.tlog").write_bytes(b"\0" * 100)
    done = fleet_tune(tmp_path)
    assert done.exit_code == 3
    assert "of 4 at least" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("out", ["no/such/folder.yaml", "a.tlog"])
def test_an_output_that_cannot_be_is_refused_before_any_work(tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.tlog").write_bytes(b"kept")
    done = fleet_tune("a.tlog", "-o", out)
    assert done.exit_code == 2
    assert out in done.stderr
    assert (tmp_path / "a.tlog").read_bytes() == b"kept"


def test_no_log_is_a_sentence(tmp_path):
    done = fleet_tune(tmp_path)
    assert done.exit_code == 2
    assert "no log in there" in done.stderr


@pytest.mark.campaign
@pytest.mark.parametrize("present", ["", "gnss: {position_std: 20, delay: 0.9, velocity_std: 5}"])
def test_flights_of_a_vehicle_show_it_whatever_is_configured(made, tmp_path, present):
    folder = tmp_path / "logs"
    folder.mkdir()
    for seed in range(1, 7):
        made(folder, seed)
    (folder / "7.tlog").write_bytes(b"\0" * 1000)
    (tmp_path / "present.yaml").write_text(f"{present or 'gnss: {use_velocity: true}'}\n")
    written = tmp_path / "tuned.yaml"
    options = ("--config", tmp_path / "present.yaml", "-o", written)
    done = fleet_tune(folder, *options, "--jobs", "2", "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    for name, true in TRUTH.items():
        assert found["parameters"][name]["value"] == pytest.approx(true, rel=0.1), name
    gain = max(found["gain_fixed"]["mean"], found["gain_learnt"]["mean"])
    assert gain > 0.0
    assert found["flights"] == 6
    assert "7.tlog" in found["left_aside"][0]
    assert load_config(written).gnss.delay == pytest.approx(0.25, abs=0.02)
    if not present:
        again = fleet_tune(folder, *options, "--dask", "local", "--jobs", "2", "--json")
        assert again.exit_code == 0, again.output
        assert json.loads(again.stdout) == found
