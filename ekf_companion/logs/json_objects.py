"""JSON objects from rows of numbers, compiled: the text between the numbers is constant."""

from __future__ import annotations

import cython
import numpy as np
from cython.cimports.libc.string import memcpy

from ekf_companion.nav.arrays import Column, Const

COMMA = cython.declare(cython.int, 0x2C)
NULL = cython.declare(cython.int, 0x6E)
OPEN = cython.declare(cython.int, 0x7B)
CLOSED = cython.declare(cython.int, 0x5D)
MESSAGE = cython.declare(cython.int, 0x05)
"""Opcode of an MCAP message record."""
HEAD = 31
"""Bytes of an MCAP message before its content."""


def write_messages(
    numbers: bytes,
    names: list[bytes],
    ends: list[bytes],
    channel: int,
    stamp_ns: Const[Column[np.int64]],
    out: bytearray,
    behind: Column[np.int64],
    has_gaps: bool,
) -> None:
    """Write an MCAP message for each row: text and numbers in turn, then the row's end.

    Args:
        numbers: JSON of the rows, ``[[1.5,null],[2.5,3.5]]``.
        names: The text before each number of a row: ``[b'{"x":', b',"y":']``.
        ends: The text behind the numbers, one for each row: ``[b'}', b'}']``.
        channel: Its number, at most 255.
        stamp_ns: Time of logging and publishing of each, shape (n,).
        out: Receives the messages, with room for the bytes of all arguments, and the heads.
        behind: Receives the end of each message in ``out``, shape (n,).
        has_gaps: A number that is null is left out with its name; the object is flat.
    """
    text: cython.p_char = cython.cast(cython.p_char, numbers)
    line: cython.p_char = cython.cast(cython.p_char, cython.address(out[0]))
    piece: bytes
    row: int
    place = 1
    n: int = 0
    for row, end in enumerate(ends):
        start = n
        n += HEAD
        skip: int = 0  # the comma of what comes first
        for piece in names:
            place += 1  # a bracket or a comma
            stop = place
            while text[stop] != COMMA and text[stop] != CLOSED:
                stop += 1
            if has_gaps and text[place] == NULL:
                place = stop
                if n == start + HEAD:
                    line[n] = OPEN
                    n += 1
                    skip = 1
                continue
            size = len(piece) - skip
            memcpy(line + n, cython.cast(cython.p_char, piece) + skip, size)
            n += size
            skip = 0
            memcpy(line + n, text + place, stop - place)
            n += stop - place
            place = stop
        piece = end
        size = len(piece) - skip
        memcpy(line + n, cython.cast(cython.p_char, piece) + skip, size)
        n += size
        place += 2
        line[start] = MESSAGE
        _put_number(line + start + 1, n - start - 9)
        # Its channel, and a count of the messages that is not kept
        _put_number(line + start + 9, channel)
        _put_number(line + start + 15, stamp_ns[row])
        _put_number(line + start + 23, stamp_ns[row])
        behind[row] = n


def _put_number(line: cython.p_char, number: int) -> None:
    """Write the eight bytes of a number, the lowest first."""
    for i in range(8):
        line[i] = number >> 8 * i & 0xFF
