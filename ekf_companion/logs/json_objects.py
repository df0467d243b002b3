"""JSON objects from rows of numbers, compiled: what is between the numbers is the same in all."""

from __future__ import annotations

import cython
from cython.cimports.libc.string import memcpy

COMMA = cython.declare(cython.int, 0x2C)
CLOSED = cython.declare(cython.int, 0x5D)


def name_numbers(numbers: bytes, names: list[bytes], ends: list[bytes]) -> list[bytes]:
    """Return a text for each row: before each number what is before it, and then the row's end.

    Args:
        numbers: JSON of the rows, ``[[1.5,null],[2.5,3.5]]``.
        names: The text before each number of a row: ``[b'{"x":', b',"y":']``.
        ends: The text behind the numbers, one for each row: ``[b'}', b'}']``.
    """
    rows = []
    out = bytearray(len(b"".join(names)) + len(numbers) + max(map(len, ends), default=0))
    text, line = cython.cast(cython.p_char, numbers), cython.cast(cython.p_char, out)
    place = 1
    for end in ends:
        n = 0
        for piece in names:
            size = len(piece)
            memcpy(line + n, cython.cast(cython.p_char, piece), size)
            n += size
            place += 1  # a bracket or a comma
            stop = place
            while text[stop] != COMMA and text[stop] != CLOSED:
                stop += 1
            memcpy(line + n, text + place, stop - place)
            n += stop - place
            place = stop
        piece = end
        size = len(piece)
        memcpy(line + n, cython.cast(cython.p_char, piece), size)
        place += 2
        rows.append(line[: n + size])
    return rows
