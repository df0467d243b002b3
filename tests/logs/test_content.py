"""A log under another suffix: its kind is told by its bytes."""

import gzip

import pytest
from typer.testing import CliRunner

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs.content import DATAFLASH, TLOG, ULOG, content_of
from ekf_companion.replay.read import read
from sim_autopilot.__main__ import app as simulator
from tests.logs.test_cut import ulog_bytes
from tests.logs.test_dataflash import new_log


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return the bytes of a log by its true suffix."""
    path = tmp_path_factory.mktemp("logs") / "a.tlog"
    words = ("generate", "--duration", "3", "--imu-rate", "50", "-o", str(path))
    assert CliRunner().invoke(simulator, words).exit_code == 0
    return {".tlog": path.read_bytes(), ".ulg": ulog_bytes(), ".bin": new_log()}


@pytest.mark.parametrize("true", [".tlog", ".ulg", ".bin"])
@pytest.mark.parametrize("given", [".tlog", ".ulg", ".bin", ".csv", ".log", ""])
def test_a_log_under_another_suffix_is_named_with_the_remedy(logs, tmp_path, true, given):
    path = tmp_path / f"flight{given}"
    path.write_bytes(logs[true])
    if given == true:
        read(path, Config())
        return
    with pytest.raises(LogError, match=rf"holds a .*; rename it to flight\{true}$"):
        read(path, Config())


def test_what_is_no_log_has_no_kind(logs):
    kinds = [content_of(logs[one][:1024]) for one in (".tlog", ".ulg", ".bin")]
    assert kinds == [TLOG, ULOG, DATAFLASH]
    for head in (b"", b"time_us,gyro_x", b"\xfd\xa3\x95" * 300, bytes(1024), b"\0" * 8 + b"\xfd"):
        assert content_of(head) is None


FORMAT = "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"


@pytest.mark.parametrize(
    "text",
    [
        FORMAT,
        FORMAT.replace(", ", ","),
        "\ufeff" + FORMAT,
        "\r\n \r\n" + FORMAT,
        "ArduCopter V3.1.5 (3c57e771)\nFree RAM: 990\n" + FORMAT,
        "PARM, RC1_MIN, 1100\n  FMT , 128 , 89, FMT, BBnNZ, Type",
    ],
    ids=["as written", "no blanks", "mark", "empty lines", "firmware first", "parameters first"],
)
@pytest.mark.parametrize(
    "name", ["flight.log", "flight.txt", "flight.csv", "flight.bin", "a.log.gz"]
)
def test_a_dataflash_log_as_text_is_named(tmp_path, name, text):
    path = tmp_path / name
    data = (text + "\n").encode()
    path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    with pytest.raises(LogError, match="as text, which is not read; name"):
        read(path)
