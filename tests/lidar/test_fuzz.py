from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ekf_companion.lidar.readers import custom_message, pcd
from ekf_companion.lidar.readers.point_cloud import Field, unpack
from tests.lidar import recordings

NUMBERS = st.integers(-5, 40)


@settings(max_examples=200, deadline=None)
@given(
    st.binary(max_size=400),
    st.lists(
        st.builds(
            Field, st.sampled_from(["x", "y", "z", "t", "ring", ""]), NUMBERS, NUMBERS, NUMBERS
        ),
        max_size=6,
    ),
    NUMBERS,
    NUMBERS,
    NUMBERS,
    st.integers(-5, 500),
    st.booleans(),
)
def test_any_cloud_is_read_or_refused(data, fields, width, height, step, row, big):
    try:
        cloud = unpack(
            data, fields, width=width, height=height, point_step=step, row_step=row,
            is_bigendian=big,
        )  # fmt: skip
    except ValueError:
        return
    assert cloud.points.shape == (width * height, 3)


def _file(tmp_path, form) -> bytes:
    rows = recordings.table(recordings.small(), 0)[:40]
    recordings.write_pcd(tmp_path / "a.pcd", rows, form)
    return (tmp_path / "a.pcd").read_bytes()


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_any_pcd_is_read_or_refused(tmp_path, form):
    whole = _file(tmp_path, form)
    rows = recordings.table(recordings.small(), 0)[:40]
    assert np.array_equal(pcd.parse(whole).points[:, 0], rows["x"])
    assert np.array_equal(pcd.parse(whole).times, rows["t"])
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(600):
        data = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        for place in rng.integers(0, len(data), rng.integers(0, 4)):
            data[place] = rng.integers(0, 256)
        try:
            pcd.parse(bytes(data))
        except ValueError:
            refused += 1
    assert refused > 100


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=3000))
def test_lzf_unpacks_what_was_packed(data):
    assert pcd.unpack_lzf(recordings.pack_lzf(data), len(data)) == data


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200), st.integers(0, 4000))
def test_any_packed_bytes_are_unpacked_or_refused(data, size):
    with contextlib.suppress(ValueError):
        assert len(pcd.unpack_lzf(data, size)) == size


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_any_custom_message_is_read_or_refused(data, is_ros2):
    head = struct.pack("<4sIII", b"\0\1\0\0", 1, 2, 3) + data
    with contextlib.suppress(ValueError):
        custom_message.decode(head if is_ros2 else head[4:], is_ros2)
