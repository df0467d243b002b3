"""The search for the records of a .tlog, compiled: linear in the bytes, whatever they are.

A checksum costs the same however long its frame is. CRC-16/MCRF4XX is linear: the register after
the bytes from a to b is that after all bytes up to b, exclusive-or that after all up to a moved on
by b - a zero bytes. So one pass over the data (:func:`checksum_all`) and a table of such moves
(:func:`zero_moves`) answer for every frame that may begin anywhere.

Source: CRC-16/MCRF4XX as in the MAVLink guide (0x1021 reflected, begins with 0xFFFF); its
linearity: Warren 2012, Hacker's Delight, 2nd ed., ch. 14.
"""

from __future__ import annotations

from array import array

import cython
import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Bytes, Column, Table

Words = npt.NDArray[np.uint16]

MOVES = 255 + 10
"""Zero bytes at most, and one: under a checksum lie a header without its start, and a payload."""
LOOK_AHEAD = cython.declare(cython.Py_ssize_t, 1024)
"""Bytes behind a record's start that may decide whether it is valid: three frames, rounded up."""
PLAUSIBLE_US = cython.declare(cython.ulonglong, 3 * 86_400_000_000)
"""Largest plausible difference of a stamp from the last good one, us."""
STATE = 4
"""Numbers that are kept from one block of data to the next, in this order: whether the search goes
on byte by byte, the stamp of the last record, whether there is one, and the number of damaged
places."""


def byte_steps() -> Words:
    """Return the change of the register for each value of its low byte, shape (256,)."""
    table = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ 0x8408, table >> 1).astype(np.uint16)
    return table


def zero_moves() -> Words:
    """Return the register after a number of zero bytes, shape (MOVES, 512).

    The register's low byte selects among the first 256 columns, its high byte among the others; the
    result is the exclusive-or of both.
    """
    steps = byte_steps()
    moves = np.empty((MOVES, 512), dtype=np.uint16)
    moves[0] = [*range(256), *range(0, 1 << 16, 256)]
    for count in range(1, MOVES):
        moves[count] = (moves[count - 1] >> 8) ^ steps[moves[count - 1] & 0xFF]
    return moves


def checksum_all(data: Bytes, steps: Column[np.uint16], sums: Column[np.uint16]) -> None:
    """Write the register after each number of bytes, starting from zero, shape (n + 1,)."""
    value: cython.uint = 0
    sums[0] = 0
    for i in range(len(data)):
        value = (value >> 8) ^ steps[(value ^ data[i]) & 0xFF]
        sums[i + 1] = value


def find_records(
    data: Bytes,
    sums: Column[np.uint16],
    steps: Column[np.uint16],
    moves: Table[np.uint16],
    extras: Column[np.int16],
    state: array[int],
    records: Table[np.int64],
    is_end: bool,
) -> tuple[int, int]:
    """Find the records, as defined in :mod:`.tlog`, in a block of data.

    Args:
        data: Bytes, shape (n,).
        sums: Of ``checksum_all``, shape (n + 1,).
        steps: Of ``byte_steps``.
        moves: Of ``zero_moves``.
        extras: The seed that ends the bytes under a checksum, by message id; -1: unknown.
        state: Zeros before the first block, then as the last call has left it.
        records: Receives stamp (us), position in the block, size and message id, shape at least
            (n // 16 + 1, 4).
        is_end: Whether the file ends with the block; else its last bytes are left for the next one.

    Returns:
        The number of records, and the position in the block where the search continues.
    """
    n, end, start = 0, len(data), 0
    reach = 16 if is_end else LOOK_AHEAD  # the shortest frame has 8 bytes
    while start + reach <= end:
        place = start + 8
        after = place + _frame_size(data, place, end)
        stamp: cython.ulonglong = _stamp_at(data, start)
        if after == place or after > end:
            good = False
        elif _seed(data, place, extras) >= 0:
            good = _is_whole(data, place, sums, steps, moves, extras)
            good = good and _is_plausible(data, after, end, stamp, state)
        else:
            # No checksum can be tested: damage must not swallow the records after it
            good = not state[0] and _continues(data, after, end, stamp)
            inside = place + 1
            while good and inside < after + 8 and inside + 8 <= end:
                good = not _may_resume(data, inside, end, sums, steps, moves, extras, state)
                inside += 1
        if good:
            state[1] = stamp & 0x7FFF_FFFF_FFFF_FFFF
            state[2] = 1
            records[n, 0] = state[1]
            records[n, 1] = place
            records[n, 2] = after - place
            records[n, 3] = _message_id(data, place)
            n += 1
            start = after
        else:
            state[3] += not state[0]
            start += 1
        state[0] = not good
    return n, start


def _frame_size(data: Bytes, place: int, end: int) -> int:
    """Return the size of a frame that begins here, even beyond the data; 0: none begins."""
    if data[place] == 0xFE:
        return 8 + data[place + 1]
    if data[place] == 0xFD and place + 12 <= end:
        return 12 + data[place + 1] + 13 * (data[place + 2] & 1)
    return 0


def _message_id(data: Bytes, place: int) -> int:
    """Return the message id of a frame."""
    if data[place] == 0xFE:
        return data[place + 5]
    return data[place + 7] | data[place + 8] << 8 | data[place + 9] << 16


def _seed(data: Bytes, place: int, extras: Column[np.int16]) -> int:
    """Return the seed of a frame's checksum; -1: unknown id."""
    number = _message_id(data, place)
    return extras[number] if number < len(extras) else -1


def _stamp_at(data: Bytes, start: int) -> cython.ulonglong:
    """Return a recorder's stamp, us."""
    stamp: cython.ulonglong = 0
    for i in range(8):
        stamp = stamp << 8 | data[start + i]
    return stamp


def _is_whole(
    data: Bytes,
    place: int,
    sums: Column[np.uint16],
    steps: Column[np.uint16],
    moves: Table[np.uint16],
    extras: Column[np.int16],
) -> bool:
    """Return whether the checksum of a frame of known id is right."""
    tail = place + data[place + 1] + (6 if data[place] == 0xFE else 10)
    count = tail - place - 1
    begun: cython.uint = sums[place + 1] ^ 0xFFFF
    value: cython.uint = sums[tail] ^ moves[count, begun & 0xFF] ^ moves[count, 256 + (begun >> 8)]
    value = (value >> 8) ^ steps[(value ^ _seed(data, place, extras)) & 0xFF]
    return value == data[tail] | data[tail + 1] << 8


def _is_near(stamp: cython.ulonglong, other: cython.ulonglong) -> bool:
    """Return whether two stamps are plausible in one recording."""
    return (stamp - other if stamp > other else other - stamp) < PLAUSIBLE_US


def _continues(data: Bytes, start: int, end: int, stamp: cython.ulonglong) -> bool:
    """Return whether a record with a stamp near this one begins here, or the file ends."""
    if start == end:
        return True
    if start + 16 > end or data[start + 8] < 0xFD or data[start + 8] > 0xFE:
        return False
    return _is_near(_stamp_at(data, start), stamp)


def _is_plausible(
    data: Bytes, after: int, end: int, stamp: cython.ulonglong, state: array[int]
) -> bool:
    """Return whether a stamp is near the last one, or the record after it is near the stamp."""
    if not state[2] or _is_near(stamp, state[1]):
        return True
    return _continues(data, after, end, stamp)


def _may_resume(
    data: Bytes,
    place: int,
    end: int,
    sums: Column[np.uint16],
    steps: Column[np.uint16],
    moves: Table[np.uint16],
    extras: Column[np.int16],
    state: array[int],
) -> bool:
    """Return whether a frame of known id, right checksum and plausible stamp begins here.

    Its signature may lie beyond the data.
    """
    size = _frame_size(data, place, end)
    if size == 0 or _seed(data, place, extras) < 0:
        return False
    signature = 13 * (data[place + 2] & 1) if data[place] == 0xFD else 0
    if place + size - signature > end:
        return False
    if not _is_whole(data, place, sums, steps, moves, extras):
        return False
    return _is_plausible(data, place + size, end, _stamp_at(data, place - 8), state)
