"""Bytes that are no log: a sentence, in a time that grows with their number and no faster.

What was quadratic took minutes for a megabyte; here the time-out of a test tells.
"""

import gzip
import lzma
import mmap
import tempfile
import tracemalloc

import numpy as np
import pytest
import zstandard

from ekf_companion.config.config import Config
from ekf_companion.errors import LogError
from ekf_companion.logs import (
    dataflash_records,
    source,
    stored_rows,
    table,
    tlog,
    tlog_search,
    ulog_messages,
)
from ekf_companion.logs.dataflash_records import read_tables
from ekf_companion.logs.source import MappedFile, Source
from ekf_companion.logs.table import Table
from ekf_companion.logs.ulog_messages import HEADER, MAGIC
from ekf_companion.replay.log_source import open_log
from ekf_companion.review.convert import convert
from tests.logs import sources
from tests.logs.test_dataflash import new_log
from tests.logs.test_tlog import small_log as small_tlog
from tests.logs.test_ulog import small_log as small_ulog

SIZE = 4_000_000
PATTERNS = {
    "MAVLink 2 starts": b"\xfd",
    "MAVLink 1 starts": b"\xfe",
    "both starts": b"\xfd\xfe",
    "zeros": b"\0",
    "ones": b"\xff",
    "DataFlash starts": b"\xa3\x95",
    "DataFlash formats": b"\xa3\x95\x80",
    "ULog data": b"\x03\x00D\x00\x00\x00",
    "ULog subscriptions": b"\x04\x00A\x00\x00\x00x",
    "ULog formats": b"\x04\x00Fa:b ",
    "ULog synchronisation": b"\x2f\x73\x13\x20\x25\x0c\xbb\x12",
    "half of it": b"\x2f\x73\x13\x20",
    "lines": b"\n",
    "cells": b",",
    "quotes": b'"',
    "digits": b"1",
    "rows": b"1,2,3\n",
}
CSV_HEAD = b"time_us,gyro_x_rps,gyro_y_rps,gyro_z_rps,accel_x_mps2,accel_y_mps2,accel_z_mps2\n"
HEADS = {
    ".tlog": (b"", b"".join(small_tlog(n=2))),
    ".bin": (b"", new_log(n=2)),
    ".ulg": (MAGIC + bytes(HEADER - len(MAGIC)), small_ulog(n=2)),
    ".csv": (b"", CSV_HEAD),
    ".txt": (b"",),
    ".mat": (b"",),
}


@pytest.mark.parametrize("suffix", HEADS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_any_pattern_is_refused_by_a_sentence_and_soon(tmp_path, suffix, pattern):
    bytes_ = PATTERNS[pattern]
    for head in HEADS[suffix]:
        path = tmp_path / f"hostile{suffix}"
        path.write_bytes(head + bytes_ * (SIZE // len(bytes_)))
        with pytest.raises(LogError, match=rf"hostile\{suffix}: ") as refused:
            convert(path, tmp_path / "out.csv", Config())
        assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("suffix", HEADS)
def test_noise_is_refused_by_a_sentence(tmp_path, suffix):
    rng = np.random.default_rng(1)
    alphabet = np.frombuffer(b"\xfd\xfe\x00\xa3\x95\x80DAF1,\n", dtype=np.uint8)
    for head in HEADS[suffix]:
        for noise in (rng.bytes(SIZE), rng.choice(alphabet, SIZE).tobytes()):
            path = tmp_path / f"hostile{suffix}"
            path.write_bytes(head + noise)
            with pytest.raises(LogError, match=rf"hostile\{suffix}: "):
                convert(path, tmp_path / "out.csv", Config())


def damaged(whole, seed):
    """Return a log with bits flipped, bytes lost, and bytes put in."""
    rng = np.random.default_rng(seed)
    data = bytearray(whole)
    for _ in range(int(rng.integers(1, 20))):
        place, size = int(rng.integers(len(data))), int(rng.integers(1, 300))
        change = rng.integers(4)
        if change == 0:
            data[place] ^= 1 << int(rng.integers(8))
        elif change == 1:
            del data[place : place + size]
        elif change == 2:
            data[place:place] = rng.bytes(size)
        else:
            data[place : place + size] = rng.choice([0xFD, 0xFE, 0x00, 0xA3, 0x95], size).tolist()
    return bytes(data[: int(rng.integers(20, len(data) + 1))])


@pytest.mark.parametrize("seed", range(20))
def test_the_searches_find_the_same_uncompiled(monkeypatch, tmp_path, seed):
    def found():
        path = tmp_path / "flight.tlog"
        path.write_bytes(damaged(b"".join(small_tlog()), seed))
        records, count = tlog._find_records(Source(path, ""))
        path = tmp_path / "flight.bin"
        path.write_bytes(damaged(new_log(), seed))
        bins = dataflash_records._find_records(MappedFile(path, ""), None)
        path = tmp_path / "flight.ulg"
        whole = small_ulog()
        path.write_bytes(whole[:500] + damaged(whole[500:], seed))
        ulog = ulog_messages.read(path, {"sensor_combined", "vehicle_gps_position"})
        places = {kind: rows.all().tobytes() for kind, rows in bins.tables.items()}
        tables = [(one.topic, one.instance, one.rows.all().tobytes()) for one in ulog.tables]
        totals = (count, bins.damaged, ulog.is_damaged, ulog.parameters, ulog.dropouts)
        return records.all().tolist(), places, tables, totals

    compiled = found()
    for room, name in (
        (tlog, "tlog_search"),
        (dataflash_records, "dataflash_search"),
        (ulog_messages, "ulog_search"),
    ):
        monkeypatch.setattr(room, name, sources.load(name))
    assert found() == compiled


@pytest.mark.parametrize("seed", range(5))
def test_a_large_file_is_mapped_and_reads_the_same(monkeypatch, tmp_path, seed):
    lines = ["time_us,gyro_x_rps,mag_x_gauss", *(f"{4000 * n},{n * 0.1!r}," for n in range(99_999))]
    logs = {
        "flight.bin": (damaged(new_log(500), seed), lambda path: bin_rows(path)),
        "flight.ulg": (small_ulog(n=500), lambda path: ulog_rows(path)),
        "flight.csv": ("\n".join(lines).encode(), lambda path: Table(path).read(["gyro_x_rps"])),
    }
    for name, (data, read) in logs.items():
        path = tmp_path / name
        path.write_bytes(data)
        monkeypatch.setattr(source, "LARGE", 1 << 40)
        whole = read(path)
        monkeypatch.setattr(source, "LARGE", 1)
        monkeypatch.setattr(dataflash_records, "AT_ONCE", 16)
        monkeypatch.setattr(ulog_messages, "AT_ONCE", 16)
        monkeypatch.setattr(table, "BLOCK", 1 << 16)
        mapped = read(path)
        assert [*mapped] == [*whole]
        for key in whole:
            assert mapped[key].tobytes() == whole[key].tobytes()


def ulog_rows(path):
    found = ulog_messages.read(path, {"sensor_combined", "vehicle_gps_position"})
    return {one.topic: one.rows.all() for one in found.tables}


def bin_rows(path):
    return {name: rows.all() for name, rows in read_tables(path)[0].items()}


@pytest.mark.parametrize("block", [2048, 4096, 7001])
def test_a_log_read_in_blocks_has_the_same_records(monkeypatch, tmp_path, block):
    path = tmp_path / "flight.tlog"
    path.write_bytes(damaged(b"".join(small_tlog(n=200)), seed=block))
    whole = list(tlog.read(path).frames())
    monkeypatch.setattr(tlog, "BLOCK", block)
    monkeypatch.setattr(stored_rows, "AT_ONCE", 7)
    assert list(tlog.read(path).frames()) == whole


def test_every_checksum_is_that_of_the_library():
    from fastcrc import crc16

    rng = np.random.default_rng(2)
    data = rng.bytes(400)
    steps, moves = tlog_search.byte_steps(), tlog_search.zero_moves()
    sums = np.empty(len(data) + 1, dtype=np.uint16)
    tlog_search.checksum_all(memoryview(data), steps, sums)
    for count in range(len(moves)):
        first = int(rng.integers(len(data) - count + 1))
        begun = int(sums[first]) ^ 0xFFFF
        value = sums[first + count] ^ moves[count, begun & 0xFF] ^ moves[count, 256 + (begun >> 8)]
        assert value == crc16.mcrf4xx(data[first : first + count])


@pytest.mark.parametrize("suffix", [".tlog", ".csv", ".txt"])
@pytest.mark.parametrize("packing", [".gz", ".zst"])
def test_what_unpacks_to_more_than_a_flight_is_refused_in_little_memory(tmp_path, suffix, packing):
    pack = {".gz": gzip.compress, ".zst": zstandard.ZstdCompressor().compress}[packing]
    path = tmp_path / f"bomb{suffix}{packing}"
    path.write_bytes(pack(bytes(4 * source.LARGE)))
    tracemalloc.start()
    with pytest.raises(LogError, match="holds more than 64 MiB, more than a log of its size"):
        open_log(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2.5 * source.LARGE


@pytest.mark.parametrize("packing", ["", ".gz", ".zst"])
def test_what_is_large_lies_in_a_file_and_reads_the_same(tmp_path, monkeypatch, packing):
    pack = {"": bytes, ".gz": gzip.compress, ".zst": zstandard.ZstdCompressor().compress}[packing]
    path = tmp_path / f"flight.ulg{packing}"
    path.write_bytes(pack(MAGIC + bytes(HEADER - len(MAGIC)) + small_ulog(n=50)))
    whole = bytes(MappedFile(path, "log").data)
    monkeypatch.setattr(source, "LARGE", 100)
    mapped = MappedFile(path, "log")
    assert isinstance(mapped.data.obj, mmap.mmap)
    assert bytes(mapped.data) == whole


def test_a_device_has_no_end(tmp_path):
    path = tmp_path / "flight.csv"
    path.symlink_to("/dev/zero")
    with pytest.raises(LogError, match="a device, which has no end"):
        open_log(path)


def test_without_room_to_unpack_it_says_where(tmp_path, monkeypatch):
    path = tmp_path / "flight.csv.gz"
    path.write_bytes(gzip.compress(CSV_HEAD + b"1,2,3,4,5,6,7\n" * 1000))
    monkeypatch.setattr(source, "LARGE", 100)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
    with pytest.raises(LogError, match=r"no room to unpack it in .*absent \(No such file.*TMPDIR"):
        open_log(path)


@pytest.mark.parametrize("suffix", [".gz", ".zst"])
@pytest.mark.parametrize("content", [CSV_HEAD, lzma.compress(CSV_HEAD), b"PK\3\4" + CSV_HEAD])
def test_what_is_not_packed_as_its_name_says_is_not_called_damaged(tmp_path, suffix, content):
    path = tmp_path / f"flight.csv{suffix}"
    path.write_bytes(content)
    with pytest.raises(LogError, match="is not packed, or by another program than its name says"):
        open_log(path)


def test_what_may_be_skipped_stands_before_the_content(tmp_path):
    path = tmp_path / "flight.ulg.zst"
    content = MAGIC + bytes(HEADER - len(MAGIC)) + small_ulog(n=50)
    skipped = b"\x50\x2a\x4d\x18" + (4).to_bytes(4, "little") + b"abcd"
    path.write_bytes(skipped + zstandard.compress(content))
    assert bytes(MappedFile(path, "log").data) == content


def test_a_line_that_no_table_has_is_refused_in_little_memory(tmp_path):
    path = tmp_path / "flight.csv"
    path.write_bytes(CSV_HEAD + b"1,2,3,4,5,6,7\n" * 10 + b"1," * (1 << 25))
    tracemalloc.start()
    with pytest.raises(LogError, match="a line is longer than 1 MiB"):
        open_log(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2.5 * source.LARGE


def test_lines_of_other_widths_are_refused_in_little_memory(tmp_path):
    """The whole table was copied four times."""
    path = tmp_path / "flight.csv"
    path.write_bytes(CSV_HEAD + b"1,2,3,4,5,6,7\n" * 10 + b"1,2\n" * (1 << 25))
    tracemalloc.start()
    with pytest.raises(LogError, match="at row 11"):
        open_log(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < source.LARGE


def test_a_table_is_the_same_in_blocks_where_lines_differ(tmp_path, monkeypatch):
    path = tmp_path / "flight.csv"
    lines = [f'{n},"{n * 0.5}",,,1{", 7" * (n % 3)}\r\n' for n in range(300)]
    path.write_text("a,b,c,d,e\n" + "".join(lines), newline="")
    whole = Table(path).read(["a", "b", "d", "e"])
    monkeypatch.setattr(table, "BLOCK", 100)
    pieces = Table(path).read(["a", "b", "d", "e"])
    assert [*pieces["a"]] == [*range(300)]
    assert np.isnan(pieces["d"]).all()
    for name, column in whole.items():
        assert pieces[name].tobytes() == column.tobytes()
