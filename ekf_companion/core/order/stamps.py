"""Events that wait, in the order of their arrival, until it is known what their stamps mean."""

from __future__ import annotations

import numpy as np
from cython.cimports.ekf_companion.core.memory.overlay import Numbers
from cython.cimports.ekf_companion.core.memory.scratch import VALUES


class Held:
    """A list of events, of limited length."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.size = 0
        self.t_ns = np.zeros(capacity, dtype=np.int64)
        self.kind = np.zeros(capacity, dtype=np.int32)
        self.result = np.zeros(capacity, dtype=np.int32)
        self.values = np.zeros((capacity, VALUES))


def add(held: Held, t_ns: int, kind: int, values: Numbers, result: int) -> bool:
    """Append an event and what it was counted as; return False if there is no room for it."""
    if held.size == held.capacity:
        return False
    held.t_ns[held.size] = t_ns
    held.kind[held.size] = kind
    held.result[held.size] = result
    for j in range(VALUES):
        held.values[held.size, j] = values[j]
    held.size += 1
    return True


def remove(held: Held, i: int) -> None:
    """Remove an event; those after it move down."""
    for n in range(i, held.size - 1):
        held.t_ns[n] = held.t_ns[n + 1]
        held.kind[n] = held.kind[n + 1]
        held.result[n] = held.result[n + 1]
        for j in range(VALUES):
            held.values[n, j] = held.values[n + 1, j]
    held.size -= 1
