"""What may be turned in the field."""

import logging
import math

import pytest

from ekf_companion.config.config import Config, describe_config, parse_config
from ekf_companion.config.keys import KEYS, value_of
from ekf_companion.config.service import ParametersConfig
from ekf_companion.engine.tuning import Tuning, apply, parameters
from ekf_companion.errors import ConfigError
from ekf_companion.mavlink.parameters import _float32

TABLE = parameters(Config())


def test_rule_30_the_table_is_small_and_its_names_fit():
    """Rule 30."""
    names = [parameter.name for parameter in TABLE]
    assert 8 <= len(names) <= 15
    assert len(set(names)) == len({parameter.key for parameter in TABLE}) == len(names)
    assert all(len(name) <= 16 and name.isascii() for name in names)


def test_the_order_that_ground_stations_have_read_stays():
    assert [parameter.name.removeprefix("EC_") for parameter in TABLE] == [
        *("ODOM_RATE", "ODOM_MODE", "TSYNC_RESP", "GPS_DELAY", "GPS_VEL_USE"),
        *("GPS_POS_NSE", "GPS_HGT_NSE", "GPS_VEL_NSE", "GYRO_NSE", "ACC_NSE"),
        *("HDG_SRC", "MAG_NSE", "BARO_USE", "BARO_NSE", "GATE"),
    ]
    indices = [key.setting.param.index for key in KEYS.values() if key.setting.param]
    assert sorted(indices) == list(range(len(TABLE)))


@pytest.mark.parametrize("parameter", TABLE, ids=lambda parameter: parameter.name)
def test_every_default_and_both_ends_of_every_range_can_be_set(parameter):
    config, key = Config(), parameter.key
    assert parameter.accepts(_float32(parameter.value))
    assert value_of(apply(config, key, parameter.value), key) == pytest.approx(
        value_of(config, key)
    )
    for number in (parameter.lowest, parameter.highest):
        tuned = apply(config, key, number)
        (again,) = [one for one in parameters(tuned) if one.name == parameter.name]
        assert again.value == pytest.approx(number)
        # A file that says the same is taken as well
        assert parse_config(describe_config(tuned), "file") == tuned


def test_words_are_numbers_and_back():
    config = apply(Config(), "output.odometry.mode", 2.0)
    assert config.output.odometry.mode == "never"
    assert apply(config, "gnss.delay", 0.12).gnss.delay == 0.12
    assert apply(config, "gnss.delay", -1.0).gnss.delay == "auto"
    assert apply(config, "baro.use", 0.0).baro.use is False
    assert apply(config, "gate.probability", 3.0).gate.probability == pytest.approx(
        0.9973, abs=1e-4
    )


def test_one_key_is_changed_and_nothing_else():
    tuned = apply(Config(), "baro.std", 2.0)
    assert tuned != Config()
    assert apply(tuned, "baro.std", Config().baro.std) == Config()


def test_a_key_that_is_no_parameter_is_refused():
    with pytest.raises(ConfigError, match=r"link\.url: is no parameter"):
        apply(Config(), "link.url", 1.0)


def test_none_are_served_where_the_user_says_so():
    assert parameters(Config(parameters=ParametersConfig(serve=False))) == ()


def test_what_was_set_is_kept_for_the_next_run_and_only_that():
    kept = []
    first = Tuning(Config(), keep=kept.append)
    first.set("baro.std", 2.5)
    first.set("heading.source", 2.0)
    first.set("imu.gyro_noise", 0.01)
    first.set("imu.gyro_noise", Config().imu.gyro_noise)  # and back
    assert len(kept) == 4
    assert b"gyro" not in kept[-1]
    second = Tuning(Config(), kept[-1], "kept", kept.append)
    assert second.config == first.config
    assert second.config.heading.source == "magnetometer"
    # What the earlier run kept is not forgotten by a change in this one
    second.set("baro.use", 0.0)
    third = Tuning(Config(), kept[-1], "kept")
    assert (third.config.baro.std, third.config.baro.use) == (2.5, False)


def test_a_guard_that_was_lifted_over_the_link_is_set_again_at_the_next_start(caplog):
    kept = []
    tuning = Tuning(Config(), keep=kept.append)
    tuning.set("baro.std", 2.5)
    tuning.set("output.odometry.mode", 1.0)
    assert tuning.config.output.odometry.mode == "always"
    again = Tuning(Config(), kept[-1], "kept").config
    assert (again.output.odometry.mode, again.baro.std) == ("auto", 2.5)
    # Not by what an earlier version kept either
    data = b'{"output.odometry.mode": "always"}'
    assert Tuning(Config(), data, "kept").config == Config()
    assert "always counts in the run that it is set in; dropped" in caplog.text
    # The user's file may lift it, and the safer choice is kept
    always = parse_config({"output": {"odometry": {"mode": "always"}}}, "file")
    assert Tuning(always, kept[-1], "kept").config.output.odometry.mode == "always"
    tuning.set("output.odometry.mode", 2.0)
    assert Tuning(Config(), kept[-1], "kept").config.output.odometry.mode == "never"


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "holds no parameters"),
        (b"\xff\x00", "holds no parameters"),
        (b"[1]", "holds no parameters"),
        (b'{"baro.std": "\xff\xfe"}', "holds no parameters"),
        (b'{"\xc3(": 1.0}', "holds no parameters"),
        (
            b'{"a\\u001b[31m": 1, "b": 1, "c": 1}',
            "'a\\x1b[31m' and 2 more: is no parameter any more",
        ),
        (b'{"baro.std": ' + b"[" * 100_000 + b"]" * 100_000 + b"}", "holds no parameters"),
        (b'{"a": ' * 100_000 + b"1" + b"}" * 100_000, "holds no parameters"),
        (b'{"old.key": 1}', "'old.key': is no parameter any more; dropped"),
        (b'{"link.url": "tcp:evil:1"}', "'link.url': is no parameter any more; dropped"),
        (b'{"baro.std": -1.0}', "baro.std: -1.0"),
        (b'{"gnss.position_std": 1.4e-45}', "gnss.position_std: 1.4e-45 is not in 0.005 to 50"),
        (b'{"gnss.velocity_std": 0.0}', "gnss.velocity_std: 0.0 is not in 0.005 to 10"),
        (b'{"imu.gyro_noise": 5}', "imu.gyro_noise: 5.0 is not in 1e-05 to 0.1"),
        (b'{"gate.probability": 0.51}', "gate.probability: 0.6"),
        (b'{"baro.use": "perhaps"}', "baro.use: 'perhaps'"),
        (b'{"baro.std": {"a": 1}}', "baro.std"),
    ],
)
def test_what_cannot_be_meant_is_dropped_and_said(caplog, data, words):
    assert Tuning(Config(), data, "kept").config == Config()
    assert words in caplog.text


@pytest.mark.parametrize("parameter", TABLE, ids=lambda one: one.name)
def test_what_nobody_can_mean_is_refused_and_both_ends_are_kept_for_the_next_run(parameter):
    nonsense = [1.4e-45, -1.4e-45, 1e-38, 3e38, -3e38, 1e9, math.nan, math.inf, -2.0]
    if not parameter.is_whole and parameter.lowest > 0.0:
        nonsense.append(0.0)
    if parameter.key != "gnss.delay":  # a delay near zero is a delay
        assert not [value for value in nonsense if parameter.accepts(value)]
    assert not parameter.accepts(3.2e7)  # a year
    for end in (parameter.lowest, parameter.highest):
        kept = []
        first = Tuning(Config(), keep=kept.append)
        first.set(parameter.key, end)
        if parameter.key != "output.odometry.mode":
            assert Tuning(Config(), kept[-1], "kept").config == first.config


def test_a_dropped_value_leaves_the_others(caplog):
    caplog.set_level(logging.INFO)
    tuning = Tuning(Config(), b'{"old.key": 1, "baro.std": 2.0}', "kept")
    assert tuning.config.baro.std == 2.0
    assert "baro.std is 2.0, as set over MAVLink" in caplog.text


def test_one_parameter_alone_counts_from_the_next_start():
    assert {parameter.name for parameter in TABLE if parameter.is_late} == {"EC_GPS_DELAY"}
