"""Clouds as .pcd files of the Point Cloud Library: ascii, binary, binary_compressed."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from ekf_companion.errors import LogError
from ekf_companion.lidar.readers.point_cloud import Cloud, from_columns
from ekf_companion.lidar.readers.source import Stored

MOST_POINTS = 10_000_000
"""Of one scan: a header may claim anything."""


def read_pcd(path: Path) -> Cloud:
    """Return the cloud of a .pcd file.

    Raises:
        LogError: It is none, or ends early.
    """
    try:
        return parse(path.read_bytes())
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise LogError(f"{path}: no .pcd that can be read: {error}") from None


def parse(data: bytes) -> Cloud:
    """Return the cloud of the bytes of a .pcd file.

    Raises:
        ValueError: They are none, or end early.
    """
    head, at = _header(data)
    names = head.get("FIELDS", [])
    try:
        sizes = [int(one) for one in head["SIZE"]]
        kinds = [{"F": "f", "I": "i", "U": "u"}[one] for one in head["TYPE"]]
        counts = [int(one) for one in head.get("COUNT", ["1"] * len(names))]
        count = int(head["POINTS"][0] if "POINTS" in head else head["WIDTH"][0])
        formats = [np.dtype(f"<{kind}{size}") for kind, size in zip(kinds, sizes, strict=True)]
        if not len(names) == len(formats) == len(counts) or min(counts, default=0) < 1:
            raise ValueError("FIELDS, SIZE, TYPE and COUNT have different lengths")
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f"the header lacks or misspells {error}") from None
    if not 0 <= count <= MOST_POINTS or sum(counts) > 1000:
        raise ValueError(f"{count} points of {sum(counts)} numbers are claimed")
    # A field of several numbers, and the padding named _, are passed over
    width = [dtype.itemsize * many for dtype, many in zip(formats, counts, strict=True)]
    kept = [k for k, name in enumerate(names) if name != "_" and counts[k] == 1]
    if len({names[k] for k in kept}) < len(kept):
        raise ValueError("a field stands twice")
    form = head.get("DATA", [""])[0].lower()
    columns: dict[str, Stored]
    if form == "ascii":
        firsts = np.cumsum([0, *counts])
        words = data[at:].split()
        if len(words) < count * sum(counts):
            raise ValueError(f"it ends after {len(words) // sum(counts)} of {count} points")
        table = np.array(words[: count * sum(counts)]).reshape(count, sum(counts))
        # Integers by way of Python's: nanoseconds have no room in a double
        columns = {names[k]: _numbers(table[:, firsts[k]], formats[k]) for k in kept}
        return from_columns(columns)
    if form == "binary":
        body = data[at : at + count * sum(width)]
        if len(body) < count * sum(width):
            raise ValueError(f"it ends after {len(body) // sum(width)} of {count} points")
        layout = np.dtype(
            {
                "names": [names[k] for k in kept],
                "formats": [formats[k] for k in kept],
                "offsets": [sum(width[:k]) for k in kept],
                "itemsize": sum(width),
            }
        )
        rows = np.frombuffer(body, layout, count)
        return from_columns({names[k]: rows[names[k]] for k in kept})
    if form == "binary_compressed":
        if len(data) < at + 8:
            raise ValueError("it ends before its sizes")
        packed, size = struct.unpack_from("<II", data, at)
        if size != count * sum(width):
            raise ValueError(f"{size} bytes are claimed for {count} points of {sum(width)}")
        body = unpack_lzf(data[at + 8 : at + 8 + packed], size)
        columns, begin = {}, 0
        for k, name in enumerate(names):
            if k in kept:
                columns[name] = np.frombuffer(body, formats[k], count, begin)
            begin += width[k] * count
        return from_columns(columns)
    raise ValueError(f"DATA {form or 'is missing'}: ascii, binary or binary_compressed is read")


def _numbers(words: Stored, dtype: np.dtype[np.generic]) -> Stored:
    if dtype.kind == "f":
        return words.astype(np.float64).astype(dtype)
    try:
        return np.array([int(word) for word in words], dtype)
    except OverflowError as error:
        raise ValueError(str(error)) from None


def _header(data: bytes) -> tuple[dict[str, list[str]], int]:
    """Return the words of each line of the header, and where the data begin."""
    head = dict[str, list[str]]()
    at = 0
    while at < min(len(data), 4096):
        end = data.find(b"\n", at)
        if end < 0:
            break
        words = data[at:end].decode("ascii", errors="replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            head[words[0].upper()] = words[1:]
            if words[0].upper() == "DATA":
                return head, at
    raise ValueError("its header has no line DATA")


def unpack_lzf(data: bytes, size: int) -> bytes:
    """Return what LZF has packed (Lehmann's liblzf: literals, and copies of what came before).

    Raises:
        ValueError: The data are damaged, or do not unpack to so many bytes.
    """
    out = bytearray()
    at, end = 0, len(data)
    try:
        while at < end:
            control = data[at]
            at += 1
            if control < 32:
                if at + control + 1 > end:
                    raise IndexError
                out += data[at : at + control + 1]
                at += control + 1
            else:
                length = control >> 5
                if length == 7:
                    length += data[at]
                    at += 1
                begin = len(out) - ((control & 31) << 8) - data[at] - 1
                at += 1
                if begin < 0:
                    raise IndexError
                length += 2
                piece = out[begin : begin + length]
                # A copy that overlaps itself repeats
                out += (piece * (length // max(len(piece), 1) + 1))[:length]
            if len(out) > size:
                raise IndexError
    except IndexError:
        raise ValueError("its compressed data are damaged") from None
    if len(out) != size:
        raise ValueError(f"its compressed data end after {len(out)} of {size} bytes")
    return bytes(out)
