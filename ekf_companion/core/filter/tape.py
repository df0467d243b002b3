"""The tape: a record of each step of the filter, for the smoother.

The step finds the tape in its scratch memory, if there is one. A record is the state after
something happened, and how its error follows from that before (:class:`~.enums.Link`).
"""

from __future__ import annotations

from cython import address
from cython.cimports.ekf_companion.core.filter.covariance import write_transition
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    LINK_CUT,
    LINK_FRESH,
    LINK_MOVED,
    LINK_SAME,
    MODE_ATTITUDE,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import copy_state
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Scratch
from cython.cimports.ekf_companion.core.memory.state import State


def append(x: State, w: Scratch, link: int) -> int:
    """Append a record of the state; return its index."""
    index = w.tape.length
    record = address(w.tape.record[index])
    w.tape.length += 1
    record.link = link
    record.is_sample = 0.0
    copy_state(address(record.state), x)
    return index


def record_motion(x: State, k: Parameters, w: Scratch, dt: float) -> None:
    """Record that the state moved by dt (s), right after P was propagated."""
    index = append(x, w, LINK_MOVED)
    write_transition(k, address(w.motion), dt, w.tape.record[index].Phi)


def record_gap(x: State, w: Scratch) -> None:
    """Record that the error grew where it was: Phi is one."""
    record = address(w.tape.record[append(x, w, LINK_MOVED)])
    for i in range(N):
        for j in range(N):
            record.Phi[i][j] = 0.0
        record.Phi[i][i] = 1.0


def record_event(x: State, w: Scratch) -> None:
    """Record the state after an event."""
    record_state(x, w, 0.0)


def record_sample(x: State, w: Scratch) -> None:
    """Record the state at the end of a sample."""
    record_state(x, w, 1.0)


def record_state(x: State, w: Scratch, is_sample: float) -> None:
    """Record the state, and how it follows from the one before.

    An attitude, or a part of it, drawn anew turns the axes that all else is expressed in; and
    before there was one there is nothing to go back to: both cut.
    """
    link = LINK_SAME
    index = append(x, w, link)
    record = address(w.tape.record[index])
    record.is_sample = is_sample
    if index == 0:
        link = LINK_CUT
    else:
        before = address(w.tape.record[index - 1].state)
        if x.mode < MODE_ATTITUDE or before.mode < MODE_ATTITUDE:
            link = LINK_CUT
        else:
            for i in range(N):
                if x.redrawn[i] != before.redrawn[i]:
                    if E_ATT <= i < E_ATT + 3:
                        link = LINK_CUT
                    elif link == LINK_SAME:
                        link = LINK_FRESH
    record.link = link
