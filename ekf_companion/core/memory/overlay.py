"""Structs laid over arrays of doubles, for the uncompiled kernel; ``overlay.pxd`` for the compiled.

An array is C-contiguous and lives longer than what is laid over it; nothing is copied. Those of
several give something to be indexed.
"""

import ctypes
from typing import Any

import numpy as np

from ekf_companion.core.memory.bank import INSTANCES, Bank, Instance
from ekf_companion.core.memory.declare import Dcm, Numbers, Square, Structs, Vector
from ekf_companion.core.memory.enums import E_VEL, N
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Estimate, Event, OdometryNumbers, TapeRecord
from ekf_companion.core.memory.state import ESTIMATED, State
from ekf_companion.nav.arrays import Array


def as_state(block: Array) -> State:
    """Return a state block, shape (BLOCK,), as a state."""
    return _over(State, block)


def as_states(blocks: Array) -> State:
    """Return state blocks, shape (n, BLOCK), as states."""
    return _over(State, blocks, len(blocks))


def as_parameters(numbers: Array) -> Parameters:
    """Return the filter's numbers, shape (PARAMETERS,), as parameters."""
    return _over(Parameters, numbers)


def as_events(rows: Array) -> Event:
    """Return rows, shape (n, ROW), as events."""
    return _over(Event, rows, len(rows))


def as_estimate(numbers: Array) -> Estimate:
    """Return an estimate's numbers, shape (OUT,), as an estimate."""
    return _over(Estimate, numbers)


def as_odometry(numbers: Array) -> OdometryNumbers:
    """Return ODOMETRY's numbers, shape (ODOMETRY,), as a struct."""
    return _over(OdometryNumbers, numbers)


def as_records(records: Array) -> TapeRecord:
    """Return memory for a tape, shape (n, RECORD), as its records."""
    kind: Any = TapeRecord
    return ctypes.cast(records.ctypes.data, ctypes.POINTER(kind))


def as_banks(numbers: Array) -> Bank:
    """Return memory for banks, shape (n, BANK), as those."""
    kind: Any = Bank
    return ctypes.cast(numbers.ctypes.data, ctypes.POINTER(kind))


def bank_size(bank: Any) -> int:
    """Return how many numbers of a bank outlive a step: as far as it has instances."""
    one: Any = Instance
    return int(Bank.instance.offset + bank.n * ctypes.sizeof(one)) // 8


def copy_bank(to: Any, source: Any) -> None:
    """Copy a bank, as far as it has instances."""
    ctypes.memmove(ctypes.addressof(to), ctypes.addressof(source), 8 * bank_size(source))


def columns_of(bank: Any) -> Any:
    """Return the columns of a bank, flat."""
    return (ctypes.c_double * (3 * N * INSTANCES)).from_buffer(bank, Bank.U.offset)


def copy_state(to: Any, source: Any) -> None:
    """Copy a whole state."""
    ctypes.memmove(ctypes.addressof(to), ctypes.addressof(source), ctypes.sizeof(to))


def errors(x: Any) -> Any:
    """Return what P has errors of beside the attitude, shape (N - 3,), in their order there."""
    return (ctypes.c_double * (N - E_VEL)).from_buffer(x, State.vel_n.offset)


def clear_estimated(x: Any) -> None:
    """Make zero what is estimated."""
    ctypes.memset(ctypes.addressof(x), 0, ESTIMATED * ctypes.sizeof(ctypes.c_double))


def _over(kind: Any, array: Array, count: int = 0) -> Any:
    return (kind * count if count else kind).from_buffer(np.asarray(array))


__all__ = ["Dcm", "Numbers", "Square", "Structs", "Vector"]
