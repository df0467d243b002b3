"""Lines of comma-separated text from rows of JSON, compiled: one pass over the text."""

from __future__ import annotations

from array import array

import cython
from cython import address, cast
from cython.cimports.libc.string import memchr, memcpy

from ekf_companion.nav.arrays import Bytes

PLACES = 3
"""Numbers that are kept from one call to the next: where to go on in each text."""
COMMA = cython.declare(cython.int, 0x2C)
CLOSED = cython.declare(cython.int, 0x5D)
NULL = cython.declare(cython.int, 0x6E)
"""The first letter of ``null``; no number has it."""


def join_lines(
    numbers: Bytes, stamps: Bytes, end: Bytes, count: int, out: bytearray, places: array[int]
) -> None:
    """Write lines that begin with a stamp each and have the same end.

    A cell without a number, ``null``, becomes an empty one.

    Args:
        numbers: The cells between, ``[[1.5,null],[2.5,3.5]]``.
        stamps: The first cells, ``[1,2]``.
        end: The last cells with the comma before them, and the line's end.
        count: The number of lines.
        out: Receives the lines, with room for the bytes of all that is given.
        places: Where the next row of numbers, the next stamp and the next line begin, shape
            (PLACES,): 1, 1 and 0 at first. They are moved on.
    """
    size = len(numbers)
    start, at, n = places[0], places[1], places[2]
    tail = len(end)
    for _ in range(count):
        while stamps[at] != COMMA and stamps[at] != CLOSED:
            out[n] = stamps[at]
            n += 1
            at += 1
        at += 1
        out[n] = COMMA
        n += 1
        start += 1
        first = address(numbers[start])
        last = memchr(first, CLOSED, size - start)
        length = cast(cython.p_const_uchar, last) - first
        if memchr(first, NULL, length) == cython.NULL:
            memcpy(address(out[n]), first, length)
            n += length
        else:
            stop = start + length
            n = _copy_known(numbers, start, stop, out, n)
        start += length + 2
        memcpy(address(out[n]), address(end[0]), tail)
        n += tail
    places[0], places[1], places[2] = start, at, n


def _copy_known(numbers: Bytes, start: int, stop: int, out: bytearray, n: int) -> int:
    """Copy cells without their ``null``; return where the next byte goes."""
    while start < stop:
        if numbers[start] == NULL:
            start += 4
            continue
        out[n] = numbers[start]
        n += 1
        start += 1
    return n
