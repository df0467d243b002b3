"""Events that wait, in the order of their arrival, until it is known what their stamps mean."""

from __future__ import annotations

import numpy as np
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.scratch import VALUES


class Held:
    """A list of events, of limited length."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.size = 0
        self.t_ns = np.zeros(capacity, dtype=np.int64)
        self.kind = np.zeros(capacity, dtype=np.intc)
        self.result = np.zeros(capacity, dtype=np.intc)
        self.values = np.zeros((capacity, VALUES))

    def add(self, t_ns: int, kind: int, values: Vector, result: int) -> bool:
        """Append an event and what it was counted as; return False if there is no room for it."""
        if self.size == self.capacity:
            return False
        self.t_ns[self.size] = t_ns
        self.kind[self.size] = kind
        self.result[self.size] = result
        for j in range(VALUES):
            self.values[self.size, j] = values[j]
        self.size += 1
        return True

    def remove(self, i: int) -> None:
        """Remove an event; those after it move down."""
        for n in range(i, self.size - 1):
            self.t_ns[n] = self.t_ns[n + 1]
            self.kind[n] = self.kind[n + 1]
            self.result[n] = self.result[n + 1]
            for j in range(VALUES):
                self.values[n, j] = self.values[n + 1, j]
        self.size -= 1
