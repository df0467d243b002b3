"""Recordings that a kill, a full disk or a power cut left: what was whole before comes out."""

import itertools

import pytest

from ekf_companion.errors import LogError
from ekf_companion.logs import tlog
from tests.logs.test_tlog import record, small_log

RECORDS = small_log(n=12)
WHOLE = b"".join(RECORDS)
ENDS = list(itertools.accumulate(map(len, RECORDS)))
BLOCK = 4096


def read(tmp_path, data):
    path = tmp_path / "cut.tlog"
    path.write_bytes(data)
    log = tlog.read(path)
    return [record(*one) for one in log.frames()], log.notes


def before(cut):
    """Return how many records are whole before a place."""
    return sum(end <= cut for end in ENDS)


@pytest.mark.campaign
def test_cut_at_any_byte_it_gives_every_whole_record_before(tmp_path):
    for cut in range(ENDS[0], len(WHOLE) + 1):
        found, notes = read(tmp_path, WHOLE[:cut])
        assert found == RECORDS[: before(cut)]
        rest = cut - ENDS[before(cut) - 1]
        words = f"the last {rest} bytes are no whole record: the recording was cut off there"
        # Of a stamp of this century the first byte is zero
        assert notes == ((words if rest > 1 else words.replace("no whole record", "zeros"),)[:rest])


@pytest.mark.parametrize("cut", [0, 1, 8, ENDS[0] - 1])
def test_cut_before_the_first_record_ends_it_is_a_sentence(tmp_path, cut):
    with pytest.raises(LogError, match=r"cut\.tlog: (an empty file|holds no stamped)"):
        read(tmp_path, WHOLE[:cut])


@pytest.mark.parametrize("zeros", [1, 7, 8, 15, 16, 17, 100, BLOCK, 3 * BLOCK + 5])
def test_zeros_behind_the_cut_are_no_records(tmp_path, zeros):
    """After a power cut ext4 may leave a file longer than what was written."""
    for cut in range(ENDS[3], ENDS[8], 5):
        found, notes = read(tmp_path, WHOLE[:cut] + bytes(zeros))
        assert found[: before(cut)] == RECORDS[: before(cut)]
        # Zeros cannot make a frame whole but where they are what it ended with
        assert found in (RECORDS[: before(cut)], RECORDS[: before(cut) + 1])
        assert notes == () or notes[-1].endswith("the recording was cut off there")


def test_of_zeros_alone_the_note_says_so(tmp_path):
    _, notes = read(tmp_path, WHOLE + bytes(BLOCK))
    assert notes == (f"the last {BLOCK} bytes are zeros: the recording was cut off there",)


@pytest.mark.parametrize("size", [1, 9, 40, 200, 700])
def test_a_hole_of_zeros_costs_the_records_that_it_touches(tmp_path, size):
    """A block that was never written, between two that were."""
    spans = list(zip([0, *ENDS], ENDS, strict=False))
    for start in range(ENDS[2], ENDS[2] + 400, 7):
        data = WHOLE[:start] + bytes(size) + WHOLE[start + size :]
        found, notes = read(tmp_path, data)
        kept = [data[first:last] for first, last in spans]
        whole = [one for one, as_kept in zip(RECORDS, kept, strict=True) if one == as_kept]
        assert [one for one in found if one in whole] == whole
        # Where zeros hit nothing but a stamp's low bytes, the frame is good
        assert all(one[8:] in {known[8:] for known in RECORDS} for one in found)
        assert all(one in kept for one in found)
        left = len(WHOLE) - sum(map(len, found))
        words = f"1 run of damaged bytes, {left} bytes in all, was left out"
        assert notes == ((words,) if left else ())
