import yaml

from ekf_companion.calibrate.result import Result, Setting, is_known, lines, rounded, spelled
from ekf_companion.config.config import parse_config

RESULT = Result(
    settings=[
        Setting(key="gnss.delay", value=0.12, comment="s; 95 %: 0.11 to 0.13"),
        Setting(key="imu.gyro_noise", value=2.34e-5, comment="short"),
        Setting(key="imu.gyro_bias_walk", value=1e-5, comment="a bound", is_sure=False),
        Setting(key="gnss.no_such_key", value=3.0, comment="not yet"),
        Setting(
            key="heading.soft_iron",
            value=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            comment="long " * 30,
        ),
    ],
    notes=["what it rests on " * 10],
    data={"more": [1.0, 2.0]},
)


def test_what_is_sure_is_a_key_and_all_else_a_comment():
    text = "\n".join(lines("title", RESULT))
    table = yaml.safe_load(text)
    assert table == {
        "gnss": {"delay": 0.12},
        "imu": {"gyro_noise": 2.34e-5},
        "heading": {"soft_iron": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]},
    }
    parse_config(table, "printed")
    assert "  #gyro_bias_walk: 1.00e-05" in text
    assert "  #no_such_key: 3" in text
    assert text.startswith("# title\n# what it rests on")
    assert max(map(len, text.splitlines())) <= 100


def test_sections_stand_once_with_all_their_keys():
    text = lines("title", RESULT)
    assert [line for line in text if not line.startswith((" ", "#"))] == [
        "gnss:",
        "imu:",
        "heading:",
    ]


def test_json_holds_everything():
    told = RESULT.after(["first"]).to_dict("flight.bin")
    assert told["log"] == "flight.bin"
    assert told["keys"]["gnss.delay"]["value"] == 0.12
    assert told["keys"]["imu.gyro_bias_walk"]["is_sure"] is False
    assert told["notes"][0] == "first"
    assert told["more"] == [1.0, 2.0]


def test_keys_are_those_of_the_configuration():
    assert is_known("gnss.delay")
    assert is_known("window")
    assert not is_known("gnss.delay.more")
    assert not is_known("gnss.no_such_key")


def test_numbers_keep_three_digits_and_read_back():
    for value in (0.0, 0.12345, 123.4, 2.345e-5, -3e-7, 0.000299):
        assert abs(float(yaml.safe_load(spelled(value))) - value) <= 0.006 * abs(value)
    assert rounded([1.23456789, float("nan")]) == [1.23457, None]
