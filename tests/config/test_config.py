"""The configuration: what the files in config/ say, and what is refused with which sentence."""

import os
import re
import socket
from dataclasses import fields, is_dataclass
from itertools import pairwise

import msgspec
import pytest
from typer.testing import CliRunner

from ekf_companion.cli import app
from ekf_companion.config.config import Config, ConfigFile, load_config, parse_config
from ekf_companion.config.keys import KEYS
from ekf_companion.errors import ConfigError
from tests.paths import ROOT
from tests.reference import reference

CONFIG = ROOT / "config"
REFERENCE = CONFIG / "reference.yaml"
DEPARTURES = {
    "reference.yaml": {},
    # A vehicle has a wire
    "px4.yaml": {"link.url": "serial:/dev/serial0:921600"},
    "ardupilot.yaml": {"link.url": "serial:/dev/serial0:921600"},
}
"""What a file says that is not the default."""
FILES = sorted(DEPARTURES)
WORDS = (
    "link.url",
    "link.peer",
    "record.path",
    "checkpoint.file",
    "signing.key_file",
    "http.host",
    "http.token",
    "http.tiles_credit",
)


def leaves(config, path=""):
    """Return every key with its value, by its dotted name."""
    found = {}
    for field in fields(config):
        value = getattr(config, field.name)
        if is_dataclass(value):
            found |= leaves(value, f"{path}{field.name}.")
        else:
            found[path + field.name] = value
    return found


def load(tmp_path, text):
    path = tmp_path / "quad.yaml"
    path.write_text(text.rstrip("\n") + "\n")
    return load_config(path)


def test_no_file_is_untested():
    assert sorted(path.name for path in CONFIG.iterdir()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_a_file_differs_from_the_defaults_only_where_declared(name):
    ours, defaults = leaves(load_config(CONFIG / name)), leaves(Config())
    assert {key: value for key, value in ours.items() if value != defaults[key]} == DEPARTURES[name]


def test_a_vehicle_s_file_is_short():
    for name in ("px4.yaml", "ardupilot.yaml"):
        assert len((CONFIG / name).read_text().splitlines()) < 30


def test_the_reference_shows_every_key_at_its_default_under_a_text(tmp_path):
    lines = REFERENCE.read_text().splitlines()
    spelled_out = [re.sub(r"^( *)#(\w+:)", r"\1\2", line) for line in lines]
    assert load(tmp_path, "\n".join(spelled_out)) == Config()
    shown = [place for place, line in enumerate(lines) if re.match(r" *#\w+:", line)]
    assert len(shown) == len(leaves(Config())) == len(KEYS)
    for place in shown:
        above = lines[place - 1].strip()
        if above.endswith("]") and not above.startswith("# ["):
            above = lines[place - 2].strip()
        assert re.match(r"# \[.*|# .*\.$", above), lines[place]


def test_the_reference_is_as_make_reference_writes_it():
    assert REFERENCE.read_text(encoding="utf-8") == reference(), "run make reference"


def test_the_reference_says_unit_range_reload_and_parameter():
    text = " ".join(REFERENCE.read_text().replace("#", "").split())
    for said in (
        "[m; 0 or more; reloadable; EC_GPS_POS_NSE 0.005 to 50] position_std: 0.1",
        "[s; -1 to 1 or auto; EC_GPS_DELAY -1 auto, to 1] delay: auto",
        "auto: 0.085 for ArduPilot, 0.05 for PX4, 0 for others. [s;",
        "[auto, always or never; reloadable; EC_ODOM_MODE 0 auto, 1 always, 2 never] mode: auto",
        "[above 0.5 and below 1; reloadable; EC_GATE 1 to 6 sigmas of one axis] probability:",
        "[1 to 255 or null] system_id: null",
        "[gauss; each -10 to 10] hard_iron: [0.0, 0.0, 0.0]",
    ):
        assert said in text


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("imu: {gyro_nosie: 1.0}", "imu.gyro_nosie: unknown key; did you mean gyro_noise?"),
        ("autopilot: 1", "autopilot: unknown key; known: airspeed, align, anchor_range, baro, "),
        ("1: 2", "1: unknown key; known: "),
        (
            "link: {component_id: 300}",
            "link.component_id: 300 is out of range; write a whole number, 1 to 255",
        ),
        (
            "link: {component_id: 1.5}",
            "link.component_id: 1.5 is a number; write a whole number, 1 to 255",
        ),
        (
            "imu: {gyro_noise: -1}",
            "imu.gyro_noise: -1 is out of range; write a number in rad/s/sqrt(Hz), 1e-09",
        ),
        (
            "imu: {gyro_noise: fast}",
            "imu.gyro_noise: 'fast' is a text; write a number in rad/s/sqrt(Hz), 1e-09 to",
        ),
        ("imu: {learn_noise: 1}", "imu.learn_noise: 1 is a number; write true or false"),
        (
            "gnss: {delay: late}",
            "gnss.delay: 'late' is no such word; write a number in s, -1 to 1, or auto",
        ),
        (
            "gnss: {delay: true}",
            "gnss.delay: true is true or false; write a number in s, -1 to 1, or auto",
        ),
        ("imu: {gyro_noise: true}", "imu.gyro_noise: true is true or false; write a number in "),
        (
            "imu: {gyro_noise: [1]}",
            "imu.gyro_noise: [1] is a list; write a number in rad/s/sqrt(Hz)",
        ),
        ("imu: {gyro_noise: {x: 1}}", "imu.gyro_noise: {'x': 1} is a table; write a number in "),
        ("imu: {gyro_noise: null}", "imu.gyro_noise: null is no value; write a number in "),
        ("imu: {gyro_noise: 5 Hz}", "imu.gyro_noise: '5 Hz' is a text; write a number in "),
        ("link: {allow_systems: 5}", "link.allow_systems: 5 is a number; write a list of whole "),
        (
            "heading: {hard_iron: 1}",
            "heading.hard_iron: 1 is a number; write a list of 3 numbers in ",
        ),
        (
            "link: {system_id: x}",
            "link.system_id: 'x' is a text; write a whole number, 1 to 255, or ",
        ),
        (
            "gnss: {delay: 5}",
            "gnss.delay: 5 is out of range; write a number in s, -1 to 1, or auto",
        ),
        (
            "gnss: {lever_arm: [0.1, 0.2]}",
            "gnss.lever_arm: [0.1, 0.2] has 2 values; write a list of 3 numbers in m",
        ),
        (
            "gnss: {lever_arm: [1, 2, x]}",
            "gnss.lever_arm.2: 'x' is a text; gnss.lever_arm takes a list of 3 numbers in m",
        ),
        (
            "heading: {source: sun}",
            "heading.source: 'sun' is no such word; write auto, gnss, magnetometer or",
        ),
        ("record: {path: 5}", "record.path: 5 is a number; write a text, or null"),
        ("imu: {gyro_noise: .nan}", "imu.gyro_noise: nan is no number to work with; give another"),
        ("window: .inf", "window: inf is no number to work with"),
        ("gnss: {lever_arm: [1, 2, .nan]}", "gnss.lever_arm: [1, 2, nan] is no number"),
        (
            "heading: {soft_iron: [[1, 0, 0], [0, 1, 0], [0, 0, .nan]]}",
            "heading.soft_iron: [[1, 0, 0], [0, 1, 0], [0, 0, nan]] is no number",
        ),
        (
            "heading: {soft_iron: [[1, 0, 0], [0, 1, 0], [0, 0, 50]]}",
            "heading.soft_iron.2.2: 50 is out of range; heading.soft_iron takes a list of 3 "
            "lists of 3 numbers, each -10 to 10",
        ),
        ("imu: 5", "imu: 5 is not a table; write keys and values"),
        ("- 1", "the file: [1] is not a table; write keys and values"),
        ("imu: {gap: 1.0", "is not YAML: while parsing a flow mapping"),
        ("imu: {[1, 2]: 3}", "is not YAML: while constructing a mapping"),
        (
            "baro:\n  use: true\nbaro:\n  std: 1.0",
            "is not YAML: baro stands 2 times; keep one in line",
        ),
        ("imu: {gyro_noise: 0x_}", "is not YAML: '0x_' is no int; put text in quotes in line 1"),
        ("link: {url: 2024-13-45}", "is not YAML: '2024-13-45' is no timestamp; put text in quo"),
        ("baro: {std: !!float x}", "is not YAML: 'x' is no float; put text in quotes in line 1"),
        ("baro: {use: !!bool x}", "is not YAML: 'x' is no bool; put text in quotes in line 1"),
        ("baro: {use: !!timestamp x}", "is not YAML: 'x' is no timestamp; put text in quotes"),
        ("baro: {std: !!int ''}", "is not YAML: '' is no int; put text in quotes in line 1"),
        ("baro: !!map x", "is not YAML: expected a mapping node, but found scalar in line 1"),
        (f"baro: {{std: {'[' * 3000}", "a list stands too deep in lists"),
        (
            "link: {allow_systems: &a [*a]}",
            "is not YAML: *a is an alias; write the value itself in line 1",
        ),
        ("link: &a {}\nimu: {<<: *a}", "is not YAML: *a is an alias; write the value it"),
        ('http: {host: "a\\0b"}', "http.host: 'a\\x00b' is no address; 127.0.0.1 is this board"),
        ("http: {host: ''}", "http.host: '' is no address"),
        ('link: {url: "udpin:a\\0b:14540"}', "link.url: 'udpin:a\\x00b:14540': has a character"),
        ('link: {peer: "a\\0b"}', "link.peer: 'a\\x00b': has a character that no address has"),
        ("link: {url: 'serial:/dev/ttyS0:-9600'}", "link.url: serial:/dev/ttyS0:-9600: -9600 is"),
        ("link: {url: 'serial:/dev/ttyS0:fast'}", "link.url: serial:/dev/ttyS0:fast: fast is"),
        ("link: {url: 'serial:/dev/ttyS0:'}", "link.url: serial:/dev/ttyS0:: nothing is no"),
        ("imu: {gyro_noise: 1e-300}", "imu.gyro_noise: 1e-300 is out of range; write a number"),
        ("", "is empty: nothing is set in it; name at least a section, as in link:"),
        ("# nothing", "is empty: nothing is set in it"),
        ("link: {allow_systems: !!set {a}}", "link.allow_systems.0: {'a'} is neither number"),
        ("link: {url: com3}", "link.url: com3: not a link; write for example udpin:0.0.0.0:14540"),
    ],
)
def test_what_cannot_be_meant_is_named_with_a_remedy(tmp_path, text, sentence):
    with pytest.raises(ConfigError) as complaint:
        load(tmp_path, text)
    assert str(complaint.value).startswith(f"{tmp_path / 'quad.yaml'}: {sentence}")


def test_every_number_has_a_range_and_every_word_its_rivals():
    """No key takes just anything: each is refused a word, a list and a number beyond all sense."""
    for key, value in leaves(Config()).items():
        if key in WORDS:
            continue
        for nonsense in ("nonsense", [[]], 1e30 if not isinstance(value, bool) else 2):
            data = nonsense
            for part in reversed(key.split(".")):
                data = {part: data}
            with pytest.raises(ConfigError, match=re.escape(f"quad.yaml: {key}")):
                parse_config(data, "quad.yaml")


@pytest.mark.parametrize("text", ["imu:\n", "imu:\ngnss:\n  # use_velocity: false\n"])
def test_what_is_left_out_is_at_its_default(tmp_path, text):
    assert load(tmp_path, text) == Config()


@pytest.mark.parametrize("number", ["5e-5", "5E-05", "5.0e-5", "0.00005", "+5e-5"])
def test_a_number_may_be_spelled_as_anybody_would(tmp_path, number):
    assert load(tmp_path, f"imu: {{gyro_bias_walk: {number}}}").imu.gyro_bias_walk == 5e-5


def test_a_word_that_looks_like_a_number_stays_a_word(tmp_path):
    assert load(tmp_path, "record: {path: 1e3x}").record.path == "1e3x"


def test_the_printed_configuration_reads_back_the_same(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("gnss: {delay: 0.1, lever_arm: [0.1, 0.0, -0.2]}\nlink: {autopilot: 7}\n")
    printed = CliRunner().invoke(app, ["check-config", str(path)])
    assert printed.exit_code == 0
    assert load(tmp_path, printed.stdout) == load_config(path) != Config()
    assert set(leaves(Config())) == set(keys(msgspec.yaml.decode(printed.stdout)))


def test_the_printed_configuration_keeps_the_token_to_itself(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text("http: {token: correct-horse-battery-staple}\n")
    printed = CliRunner().invoke(app, ["check-config", str(path)])
    assert printed.exit_code == 0
    assert "correct-horse" not in printed.output
    assert "token: (set, and not shown)" in printed.stdout


def test_a_place_that_is_not_there_yet_is_said_before_the_first_flight(tmp_path):
    path = tmp_path / "some.yaml"
    path.write_text(
        f"record: {{path: {tmp_path}/stick/%s.tlog}}\ncheckpoint: {{file: {tmp_path}}}\n"
    )
    printed = CliRunner().invoke(app, ["check-config", str(path)])
    assert printed.exit_code == 0
    assert load(tmp_path, printed.stdout) == load_config(path)
    record, checkpoint = printed.stderr.splitlines()
    assert record.startswith(f"ekf-companion: record.path: {tmp_path}/stick/%s.tlog: there is no ")
    assert record.endswith("make it, or name another; the daemon would run without it")
    assert f"checkpoint.file: {tmp_path}: is a folder; name a file in it" in checkpoint
    path.write_text("record: {path: stick/}\n")
    result = CliRunner().invoke(app, ["check-config", str(path)])
    assert (result.exit_code, "'stick/' is no name of a file" in result.stderr) == (2, True)


def keys(table, path=""):
    for key, value in table.items():
        if isinstance(value, dict):
            yield from keys(value, f"{path}{key}.")
        else:
            yield path + key


@pytest.mark.parametrize("command", [["run", "--config"], ["check-config"]])
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("imu: {gyro_nosie: 1.0}", "imu.gyro_nosie: unknown key; did you mean gyro_noise?"),
        (None, "cannot be read: No such file or directory; name a YAML file"),
    ],
)
def test_the_command_line_says_the_sentence_and_exits_with_2(tmp_path, command, text, sentence):
    path = tmp_path / "quad.yaml"
    if text is not None:
        path.write_text(text + "\n")
    result = CliRunner().invoke(app, [*command, str(path)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr == f"ekf-companion: {path}: {sentence}\n"


BOMB = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefgh"))


def test_a_file_of_aliases_to_aliases_is_refused_before_it_is_unfolded(tmp_path):
    with pytest.raises(ConfigError, match=r"is not YAML: \*a is an alias; write the value itself"):
        load(tmp_path, BOMB)


def test_a_file_larger_than_any_configuration_is_not_read(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_text("# comment\n" * 20_000)
    with pytest.raises(ConfigError, match="is larger than 128 KiB, too large for settings"):
        load_config(path)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("kind", ["fifo", "link to a fifo", "loop", "folder", "device", "socket"])
def test_what_is_no_regular_file_is_refused_at_once(tmp_path, kind):
    """Opening a FIFO waits for who writes to it: the thread of a reload would never end."""
    path = tmp_path / "quad.yaml"
    if kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(str(path))
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        os.mkfifo(tmp_path / "fifo")
        path.symlink_to(tmp_path / "fifo")
    with pytest.raises(ConfigError, match=r"quad\.yaml: (is not a regular|cannot be read)"):
        load_config(path)


def test_a_file_that_is_cut_off_within_a_line_is_refused(tmp_path):
    path = tmp_path / "quad.yaml"
    path.write_text("output: {odometry: {mode: never}}\nlink:\n  imu_rate: 25")  # of 250.0
    with pytest.raises(ConfigError, match="line 3 has no end: the file may be cut off, half writt"):
        load_config(path)


def test_a_key_that_vanished_is_no_change_of_mind(tmp_path):
    """A reload of half a file must not set what was in the other half back to its default."""
    path = tmp_path / "quad.yaml"
    whole = "link: {imu_rate: 100}\nbaro: {std: 0.5}\noutput: {odometry: {mode: never}}\n"
    path.write_text(whole)
    file = ConfigFile(path)
    assert file.read().output.odometry.mode == "never"
    for count in range(len(whole)):
        path.write_text(whole[:count])
        with pytest.raises(
            ConfigError, match=r"is empty|has no end|is not YAML|is no longer in it"
        ):
            file.read()
    path.write_text("link: {imu_rate: 100}\noutput: {odometry: {mode: auto}}\n")
    assert file.read().output.odometry.mode == "auto"  # written out; baro.std was the default
    path.write_text("link: {imu_rate: 100}\n")
    assert file.read() == file.read()


@pytest.mark.parametrize(
    "tiles",
    [
        *("https://t.example/{z}/{x}.png", "tiles", "ftp://t.example/{z}/{x}/{y}"),
        *("https://t.example/{z}/{x}/{y}.png; script-src *", "javascript:{z}{x}{y}"),
        *("https://t.example /{z}/{x}/{y}", "https://{s}.t.example/{z}/{x}/{y}", "//t/{z}/{x}/{y}"),
    ],
)
def test_tiles_are_an_address_with_three_places_and_nothing_else(tiles):
    with pytest.raises(ConfigError, match=r"test: http\.tiles: .* is no address of map tiles"):
        parse_config({"http": {"tiles": tiles}}, "test")


def test_tiles_may_have_a_port_and_a_key():
    address = "http://10.0.0.2:8080/osm/{z}/{x}/{y}@2x.png?key=a-b_c"
    assert parse_config({"http": {"tiles": address}}, "test").http.tiles == address
