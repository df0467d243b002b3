"""The search for the records of a DataFlash log, compiled: one pass, linear in the bytes."""

from __future__ import annotations

from array import array

import cython
import numpy as np

from ekf_companion.nav.arrays import Bytes, Column, Table

FORMAT = cython.declare(cython.int, 0x80)
"""The type of the records that declare others."""


def find_records(
    data: Bytes,
    place: int,
    sizes: Table[np.int32],
    counts: Column[np.int64],
    state: array[int],
    found: Table[np.int64],
    n: int,
) -> tuple[int, int]:
    """Find records up to the next that declares a type, as :mod:`.dataflash_records` finds them.

    Args:
        data: The file, shape (n,).
        place: Where to begin.
        sizes: Bytes of a record by its type, 0 of an unknown one; and whether it is to be found,
            shape (256, 2).
        counts: Receives the number of records by type, shape (256,).
        state: The place of the record before, -1 where none is; and the damaged places so far.
        found: Receives place and type of each record, shape (m, 2).
        n: Records that it holds already: the last one is dropped where none begins at its end.

    Returns:
        The number of records that it holds then, and where to go on: behind a declaration, where
        ``found`` is full, or the end of the data.
    """
    end = len(data)
    while place + 3 <= end:
        kind = data[place + 2]
        size = sizes[kind, 0]
        if data[place] == 0xA3 and data[place + 1] == 0x95 and size > 0:
            if place + size > end:
                break
            if n == len(found):
                return n, place
            counts[kind] += 1
            state[0] = place
            place += size
            if sizes[kind, 1]:
                found[n, 0] = state[0]
                found[n, 1] = kind
                n += 1
            if kind == FORMAT:
                return n, place
            continue
        # The last record ends where none begins: it, or what follows it, is damaged
        last = state[0]
        if last >= 0:
            counts[data[last + 2]] -= 1
            if n > 0 and found[n - 1, 0] == last:
                n -= 1
            place = last + 2
        state[0] = -1
        place = _resume(data, place + 1, sizes)
        if place < end:
            state[1] += 1
    return n, end


def _resume(data: Bytes, place: int, sizes: Table[np.int32]) -> int:
    """Return the next place where a record of known type begins and another at its end."""
    end = len(data)
    while place + 3 <= end:
        if data[place] == 0xA3 and data[place + 1] == 0x95:
            size = sizes[data[place + 2], 0]
            after = place + size
            if size > 0 and after == end:
                return place
            is_followed: bool = size > 0 and after + 3 <= end and sizes[data[after + 2], 0] > 0
            if is_followed and data[after] == 0xA3 and data[after + 1] == 0x95:
                return place
        place += 1
    return end
