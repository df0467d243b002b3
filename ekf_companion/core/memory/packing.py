"""Fault hypotheses as they are kept outside of the kernel: no place that is empty."""

from typing import Any

import numpy as np

from ekf_companion.core.memory.bank import BANK, COMPONENTS, INSTANCES, Bank
from ekf_companion.core.memory.enums import N
from ekf_companion.core.memory.overlay import as_banks, bank_size
from ekf_companion.nav.arrays import Array

AT = Bank.U.offset // 8


def _counts(bank: Any) -> tuple[int, ...]:
    """Return how many instances have each component."""
    return bank.n, bank.pairs, bank.triples, bank.fours


def pack(numbers: Array) -> Array:
    """Return of a bank, shape (BANK,), what outlives a step: instances, then their columns."""
    banks: Any = as_banks(numbers[None])
    bank = banks[0]
    U = numbers[AT : AT + COMPONENTS * N * INSTANCES].reshape(COMPONENTS, N, INSTANCES)
    parts = [U[c, :, :n].ravel() for c, n in enumerate(_counts(bank))]
    return np.concatenate([numbers[: bank_size(bank)], *parts])


def unpack(packed: Array) -> Array:
    """Return a bank, shape (BANK,), of what :func:`pack` made of it; of nothing an empty one.

    Raises:
        ValueError: It holds too few numbers, or too many, for the instances that it names.
    """
    numbers = np.zeros(BANK)
    if not len(packed):
        return numbers
    head = min(len(packed), AT)
    numbers[:head] = packed[:head]
    banks: Any = as_banks(numbers[None])
    bank = banks[0]
    counts = _counts(bank)
    size = bank_size(bank)
    is_whole = len(packed) == size + N * sum(counts)
    if not ([INSTANCES, *counts, 0] == sorted([INSTANCES, *counts, 0], reverse=True) and is_whole):
        raise ValueError(f"{len(packed)} numbers are no bank of fault hypotheses")
    numbers[size:head] = 0.0
    U = numbers[AT : AT + COMPONENTS * N * INSTANCES].reshape(COMPONENTS, N, INSTANCES)
    rest = packed[size:]
    for c, n in enumerate(counts):
        U[c, :, :n] = rest[: N * n].reshape(N, n)
        rest = rest[N * n :]
    return numbers
