"""A damaged declaration makes a column of a log any other type: text, a float, half as wide."""

import re

import pytest

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs.ulog_messages import HEADER, MAGIC
from ekf_companion.review.convert import convert
from tests.logs.test_dataflash_instances import Flight
from tests.logs.test_ulog import small_log as small_ulog

DATAFLASH = ("bBM", "hHcCg", "iIfeELn", "qQd", "aZ")
"""Types of the same size."""
ULOG = (
    ("uint8_t", "int8_t", "bool", "char"),
    ("uint16_t", "int16_t"),
    ("uint32_t", "int32_t", "float"),
    ("uint64_t", "int64_t", "double"),
)


def others(kind, groups):
    """Return the other types of the same size."""
    return [one for group in groups if kind in group for one in group if one != kind]


def redeclared_dataflash():
    """Yield logs in which one column is of another type of the same size, and which it is."""
    log = Flight()
    log.lane, log.fuses = (lambda s: int(s >= 12)), (lambda lane, s: (lane, lane))
    log.parameters = {b"EK3_IMU_MASK": 3.0}
    data = log.write()[:60_000]
    for found in {one.start(): one for one in re.finditer(b"\xa3\x95\x80", data)}.values():
        record = data[found.start() : found.start() + 89]
        types, names = record[9:25].rstrip(b"\0").decode(), record[25:].rstrip(b"\0").decode()
        for place, (kind, name) in enumerate(zip(types, names.split(","), strict=True)):
            for other in others(kind, DATAFLASH):
                changed = bytearray(data)
                changed[found.start() + 9 + place] = ord(other)
                yield f"{record[5:9].decode()}.{name}: {other}", bytes(changed)


def redeclared_ulog():
    """Yield logs in which one field is of another type of the same size, and which it is."""
    data = MAGIC + bytes(HEADER - len(MAGIC)) + small_ulog(n=40)
    for found in re.finditer(rb"(..)F(?=[a-z_0-9]+:)", data, re.DOTALL):
        end = found.end() + int.from_bytes(found[1], "little")
        topic, _, text = data[found.end() : end].decode().partition(":")
        fields = text.split(";")
        for place, field in enumerate(fields[:-1]):
            kind = re.match("[a-z0-9_]+", field)[0]
            for other in others(kind, ULOG):
                new = [*fields[:place], other + field[len(kind) :], *fields[place + 1 :]]
                body = f"{topic}:{';'.join(new)}".encode()
                head = data[: found.start()] + len(body).to_bytes(2, "little") + b"F"
                yield f"{topic} {field}: {other}", head + body + data[end:]


@pytest.mark.parametrize(
    ("suffix", "logs", "least"),
    [(".bin", redeclared_dataflash, 200), (".ulg", redeclared_ulog, 40)],
)
def test_a_column_of_any_type_leaves_an_estimate_or_a_sentence(tmp_path, suffix, logs, least):
    path, tried = tmp_path / f"flight{suffix}", 0
    for what, data in logs():
        path.write_bytes(data)
        try:
            convert(path, tmp_path / "out.csv", Config())
        except LogError:
            pass
        except Exception as error:
            raise AssertionError(what) from error
        tried += 1
    assert tried > least
