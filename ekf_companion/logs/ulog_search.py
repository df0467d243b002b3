"""The search for the messages of a .ulg, compiled: one pass, linear in the bytes.

A message is its size (2 bytes, little-endian), its kind (a letter) and as many bytes. Where the
kind is not known, the message is passed over; where that cannot be a message (no kind, no size, or
more than 10 000 bytes) the search goes on behind the next synchronisation message, or where the
file has none, byte by byte.

Source: PX4 user guide, "ULog file format".
"""

from __future__ import annotations

from array import array

import cython
import numpy as np

from ekf_companion.nav.arrays import Bytes, Table

LARGEST = cython.declare(cython.int, 10_000)
"""Bytes of a message of unknown kind, beyond which it is damage."""
FORMAT = cython.declare(cython.int, 70)
FLAGS = cython.declare(cython.int, 66)
PARAMETER = cython.declare(cython.int, 80)
PARAMETER_DEFAULT = cython.declare(cython.int, 81)
INFORMATION = cython.declare(cython.int, 73)
INFORMATION_MULTIPLE = cython.declare(cython.int, 77)
SUBSCRIPTION = cython.declare(cython.int, 65)
TEXT = cython.declare(cython.int, 76)
TEXT_TAGGED = cython.declare(cython.int, 67)
DATA = cython.declare(cython.int, 68)
DROPOUT = cython.declare(cython.int, 79)
SYNC = cython.declare(cython.int, 83)
"""The kinds: the letters F B P Q I M A L C D O S."""


def find_definition(data: Bytes, place: int, state: array[int]) -> tuple[int, int]:
    """Find the next message that defines something: a format, a parameter, flags, a subscription.

    Args:
        data: The file, shape (n,).
        place: Where to begin.
        state: Whether the file has no synchronisation, and whether damage was met; as
            ``find_data`` takes it.

    Returns:
        Its kind, that of an information and of the first logged text too; 0 if none is left. And
        its place.
    """
    end = len(data)
    while place + 3 <= end:
        size, kind = _size_of(data, place), data[place + 2]
        is_first_of_data = kind in (SUBSCRIPTION, TEXT, TEXT_TAGGED)
        if is_first_of_data or kind in (FORMAT, FLAGS, PARAMETER, INFORMATION):
            if place + 3 + size > end:
                break
            return kind, place
        is_known = kind in (INFORMATION_MULTIPLE, PARAMETER_DEFAULT)
        if not is_known and (kind == 0 or size == 0 or size > LARGEST):
            state[1] = 1
            place += 1
        else:
            place += 3 + size
    return 0, end


def find_data(
    data: Bytes,
    place: int,
    end: int,
    sizes: Table[np.int32],
    state: array[int],
    found: Table[np.int64],
) -> tuple[int, int, int]:
    """Find messages with data.

    Args:
        data: The file, shape (n,).
        place: Where to begin.
        end: Where to end, at most n.
        sizes: The least and the largest number of bytes that a message has by its id, behind the
            id; -1: it is not wanted, 0: the id is not known; shape (65536, 2).
        state: Of ``find_definition``.
        found: Receives the place behind the id, and the id, of each wanted message; of a dropout
            the place behind its header, and -1; of a logged text its place, and -2; shape (m, 2).

    Returns:
        The number of messages found, the kind of the message that ended the search, and its place:
        a subscription, any other where ``found`` is full, or 0 where the data ends: its place is
        then ``end``, or that of a last message that is not whole.
    """
    n = 0
    while place + 3 <= end:
        size, kind = _size_of(data, place), data[place + 2]
        after = place + 3 + size
        is_known: bool = _is_passed(kind) or kind == SUBSCRIPTION
        if after > end and (is_known or 0 < size <= LARGEST):
            break
        if kind == DATA and size >= 2:
            if n == len(found):
                return n, kind, place
            number = data[place + 3] | data[place + 4] << 8
            if sizes[number, 0] >= 0:
                if sizes[number, 0] > 0 and sizes[number, 0] <= size - 2 <= sizes[number, 1]:
                    found[n, 0] = place + 5
                    found[n, 1] = number
                    n += 1
                else:
                    state[1] = 1
        elif kind == SUBSCRIPTION:
            return n, kind, place
        elif kind == DROPOUT and size == 2:
            if n == len(found):
                return n, kind, place
            found[n, 0] = place + 3
            found[n, 1] = -1
            n += 1
        elif kind == TEXT and size >= 9:
            if n == len(found):
                return n, kind, place
            found[n, 0] = place
            found[n, 1] = -2
            n += 1
        elif not is_known:
            if kind == 0 or size == 0 or size > LARGEST:
                state[1] = 1
                after = place + 1
                if not state[0]:
                    synced = _find_sync(data, after, end)
                    state[0] = synced < 0
                    after = synced if synced >= 0 else after
            elif not state[0]:
                synced = _find_sync(data, place + 3, after)
                if synced >= 0:
                    state[1] = 1
                    after = synced
        place = after
    return n, 0, place


def _size_of(data: Bytes, place: int) -> int:
    """Return the size that a message's header states."""
    return data[place] | data[place + 1] << 8


def _is_passed(kind: int) -> bool:
    """Return whether messages of a kind are known, and of no use here."""
    if kind in (INFORMATION, INFORMATION_MULTIPLE):
        return True
    if kind in (PARAMETER, PARAMETER_DEFAULT):
        return True
    if kind in (TEXT, TEXT_TAGGED):
        return True
    return kind in (DATA, DROPOUT, SYNC)


def _find_sync(data: Bytes, place: int, end: int) -> int:
    """Return where the next synchronisation bytes (2F 73 13 20 25 0C BB 12) end; -1: nowhere."""
    while place + 8 <= end:
        first: cython.uint = (
            data[place] << 24 | data[place + 1] << 16 | data[place + 2] << 8 | data[place + 3]
        )
        if first == 0x2F731320:
            place += 4
            last: cython.uint = data[place] << 24 | data[place + 1] << 16
            last |= data[place + 2] << 8 | data[place + 3]
            if last == 0x250CBB12:
                return place + 4
            place -= 4
        place += 1
    return -1
