"""Columns of the fault hypotheses: what the filter's own steps do to the error by each fault.

The filter knows nothing of a fault b; so the state is off by U b, and U follows from each step that
was really taken: ``U <- Phi U`` between, ``U <- U - K (H U + D)`` at a correction, where D is what
the fault adds to the reading itself. The transitions of many samples are multiplied up first, and
the columns follow by all at once when a reading comes.

The same number of all instances lies in a row, so that each step is one pass over such rows:
``U[component][error state][instance]``, ``T[component][row][instance]``. Instances of more
components stand before those of fewer, so that each component has a row without gaps.

Source: Friedland 1969 (separated bias), in the form of Willsky and Jones 1976.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.memory.bank import COMPONENTS, MOVING, Bank
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_VELOCITY,
    E_ATT,
    E_BA,
    E_BARO,
    E_BG,
    E_DELAY,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_POS,
    E_VEL,
    FAULT_ALIGNMENT,
    FAULT_BARO_RAMP,
    FAULT_BARO_STEP,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector, columns_of, copy_bank
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion, Observation
from cython.cimports.ekf_companion.core.memory.state import State


def stand(b: Bank) -> None:
    """Begin to multiply transitions anew: the columns have followed."""
    for i in range(MOVING):
        for j in range(MOVING):
            b.Phi[i][j] = 0.0
        b.Phi[i][i] = 1.0
    for i in range(3):
        b.faded[i] = 1.0
    b.has_moved = 0


def move(b: Bank, k: Parameters, m: Motion, dt: float) -> None:
    """Multiply in the transition over which P was just carried on; see ``covariance``."""
    h = 0.5 * dt
    b.has_moved = 1
    for i in range(3):
        for j in range(MOVING):
            force = 0.0
            turn = 0.0
            for r in range(3):
                force += m.S[i][r] * b.Phi[E_ATT + r][j] + m.G[i][r] * b.Phi[E_BA + r][j]
                turn += m.SG[i][r] * b.Phi[E_BG + r][j]
            m.row[j] = force
            m.row2[j] = turn
        for j in range(MOVING):
            b.Phi[E_POS + i][j] += dt * b.Phi[E_VEL + i][j] + h * (
                m.row[j] + (2.0 / 3.0) * m.row2[j]
            )
            b.Phi[E_VEL + i][j] += m.row[j] + m.row2[j]
    for i in range(3):
        for j in range(MOVING):
            for r in range(3):
                b.Phi[E_ATT + i][j] += m.G[i][r] * b.Phi[E_BG + r][j]
    if m.slow_dt > 0.0:
        b.faded[0] *= 1.0 - m.heading_faded
        b.faded[1] *= k.gnss_offset_time / (m.slow_dt + k.gnss_offset_time)
        b.faded[2] *= k.gnss_vel_offset_time / (m.slow_dt + k.gnss_vel_offset_time)


def with_component(b: Bank, c: int) -> int:
    """Return how many instances have more than so many components: the first ones."""
    if c == 0:
        return b.n
    if c == 1:
        return b.pairs
    return b.triples if c == 2 else b.fours


def add_row(to: Vector, factor: float, of: Vector, n: int) -> None:
    """Add a multiple of a row to another one."""
    for i in range(n):
        to[i] += factor * of[i]


def add_rows(
    to: Vector, f0: float, f1: float, f2: float, u0: Vector, u1: Vector, u2: Vector, n: int
) -> None:
    """Add multiples of three rows to another one."""
    for i in range(n):
        to[i] += f0 * u0[i] + f1 * u1[i] + f2 * u2[i]


def scale_row(row: Vector, factor: float, n: int) -> None:
    """Multiply a row."""
    for i in range(n):
        row[i] *= factor


def follow(x: State, b: Bank) -> None:
    """Let all columns follow the state's motion, and what was drawn anew meanwhile."""
    if b.has_moved != 0:
        for c in range(COMPONENTS):
            follow_component(b, c, with_component(b, c))
        i = alignment(b)
        if i >= 0:
            for e in range(E_VEL, E_POS + 3, 3):
                b.U[0][e][i] += b.Phi[e + 1][E_ATT + 2]
                b.U[0][e + 1][i] -= b.Phi[e][E_ATT + 2]
    for e in range(N):
        if x.redrawn[e] != b.redrawn[e]:
            b.redrawn[e] = x.redrawn[e]
            draw_anew(x, b, e)
    if b.has_moved != 0:
        stand(b)


def alignment(b: Bank) -> int:
    """Return the place of the hypothesis that our yaw is off by any angle; -1: there is none.

    Under it what we have gained of velocity and position is turned by that: its columns are this,
    and this turned by a quarter. So are the corrections of our tilt.
    """
    for i in range(b.triples, b.pairs):
        if b.instance[i].kind == FAULT_ALIGNMENT:
            return i
    return -1


def draw_anew(x: State, b: Bank, e: int) -> None:
    """Let the columns of an error state begin anew.

    A copy of an error and a reading has the fault of both in it; nothing else owes to what was
    before.
    """
    source = cython.cast(cython.Py_ssize_t, x.copied[e])
    for c in range(COMPONENTS):
        for i in range(with_component(b, c)):
            b.U[c][e][i] = b.U[c][source][i] if source >= 0 else 0.0
    if e == E_BARO:
        for i in range(b.n):
            h = address(b.instance[i])
            if h.kind == FAULT_BARO_STEP:
                b.U[0][e][i] -= 1.0
            elif h.kind == FAULT_BARO_RAMP:
                b.U[0][e][i] -= (x.t - h.t0) * 1e-9


def follow_component(b: Bank, c: int, n: int) -> None:
    """Let the columns of one component of n instances follow; what owes to others comes first."""
    if n == 0:
        return
    for i in range(E_POS, E_POS + 3):
        add_row(b.U[c][i], b.Phi[i][E_VEL + i - E_POS], b.U[c][E_VEL + i - E_POS], n)
        add_moved(b, c, i, E_ATT, n)
        add_moved(b, c, i, E_BG, n)
        add_moved(b, c, i, E_BA, n)
    for i in range(E_VEL, E_VEL + 3):
        add_moved(b, c, i, E_ATT, n)
        add_moved(b, c, i, E_BG, n)
        add_moved(b, c, i, E_BA, n)
    for i in range(E_ATT, E_ATT + 3):
        add_moved(b, c, i, E_BG, n)
    scale_row(b.U[c][E_HEADING], b.faded[0], n)
    for i in range(3):
        scale_row(b.U[c][E_GNSS + i], b.faded[1], n)
        scale_row(b.U[c][E_GNSS_VEL + i], b.faded[2], n)


def add_moved(b: Bank, c: int, i: int, j: int, n: int) -> None:
    """Add to the columns of an error state what owes to three others, from the j-th on."""
    add_rows(
        b.U[c][i],
        b.Phi[i][j],
        b.Phi[i][j + 1],
        b.Phi[i][j + 2],
        b.U[c][j],
        b.U[c][j + 1],
        b.U[c][j + 2],
        n,
    )


def look_ahead(b: Bank, i: int, c: int, out: Vector) -> None:
    """Write attitude, velocity and position of a column as of now; the column stays behind."""
    for e in range(9):
        out[e] = b.U[c][e][i]
        if b.has_moved != 0:
            for j in range(MOVING):
                if j != e:
                    out[e] += b.Phi[e][j] * b.U[c][j][i]
    if b.has_moved != 0 and c == 0 and b.instance[i].kind == FAULT_ALIGNMENT:
        for e in range(E_VEL, E_POS + 3, 3):
            out[e] += b.Phi[e + 1][E_ATT + 2]
            out[e + 1] -= b.Phi[e][E_ATT + 2]


def observe(b: Bank, o: Observation, n: int) -> None:
    """Write into T what each component does to the rows of an observation, by the state: H U."""
    for c in range(COMPONENTS):
        many = with_component(b, c)
        for r in range(o.rows):
            for i in range(many):
                b.T[c][r][i] = 0.0
            for e in range(n):
                if o.H[r][e] != 0.0:
                    add_row(b.T[c][r], o.H[r][e], b.U[c][e], many)


def take_rows(x: State, b: Bank, o: Observation) -> None:
    """Take T for a correction: as it was judged, or else by the state alone."""
    if b.is_observed == 0:
        follow(x, b)
        observe(b, o, carried(x))
    b.is_observed = 0


def correct(x: State, o: Observation) -> None:
    """Let the columns follow a correction that was just made by all rows at once.

    ``o.PHt`` holds the gains of the whitened rows, ``o.L`` the factor of S that they were made
    with, ``o.dx`` what the state was moved by.
    """
    b = address(o.bank[0])
    is_led = cython.declare(cython.bint, b.is_observed != 0 and b.judged < AID_VELOCITY)
    take_rows(x, b, o)
    states = carried(x)
    for c in range(COMPONENTS):
        n = with_component(b, c)
        for r in range(o.rows):
            for j in range(r):
                add_row(b.T[c][r], -o.L[r][j], b.T[c][j], n)
            scale_row(b.T[c][r], 1.0 / o.L[r][r], n)
        for e in range(states):
            if e == E_DELAY and o.shows_delay == 0:
                continue
            for r in range(o.rows):
                add_row(b.U[c][e], -o.PHt[r][e], b.T[c][r], n)
        turn_rows(b, c, o.dx, n)
    i = alignment(b)
    if i >= 0:
        b.U[0][E_ATT][i] -= o.dx[E_ATT]
        b.U[0][E_ATT + 1][i] -= o.dx[E_ATT + 1]
        b.U[1][E_ATT][i] += o.dx[E_ATT + 1]
        b.U[1][E_ATT + 1][i] -= o.dx[E_ATT]
    for r in range(o.rows if is_led else 0):
        for e in range(states):
            b.led[b.judged][r] -= o.H[r][e] * o.dx[e]


def correct_yaw(x: State, o: Observation) -> None:
    """The same of a correction of yaw alone, by ``o.gain``."""
    b = address(o.bank[0])
    take_rows(x, b, o)
    states = carried(x)
    for c in range(COMPONENTS):
        n = with_component(b, c)
        for e in range(states):
            if o.gain[e] != 0.0:
                add_row(b.U[c][e], -o.gain[e], b.T[c][0], n)
        turn_rows(b, c, o.dx, n)


def correct_delay(x: State, o: Observation, gain: float) -> None:
    """The same of a correction of the fixes' delay alone, by its gain."""
    b = address(o.bank[0])
    take_rows(x, b, o)
    for c in range(COMPONENTS):
        add_row(b.U[c][E_DELAY], -gain, b.T[c][0], with_component(b, c))


def turn_rows(b: Bank, c: int, dx: Vector, n: int) -> None:
    """Turn the attitude of n columns as the error was, when dx was moved into the state."""
    for i in range(n):
        turn(b, c, i, dx)


def turn(b: Bank, c: int, i: int, dx: Vector) -> None:
    """Turn a column's attitude likewise."""
    p0 = b.U[c][0][i]
    p1 = b.U[c][1][i]
    p2 = b.U[c][2][i]
    b.U[c][0][i] = p0 + 0.5 * (dx[1] * p2 - dx[2] * p1)
    b.U[c][1][i] = p1 + 0.5 * (dx[2] * p0 - dx[0] * p2)
    b.U[c][2][i] = p2 + 0.5 * (dx[0] * p1 - dx[1] * p0)


def save(to: Bank, b: Bank, n: int) -> None:
    """Copy a bank for later, without what is empty: the columns of n error states, close together.

    Those of the error states beyond are zero: no correction has moved them yet.
    """
    copy_bank(to, b)
    to.carried = n
    flat = columns_of(to)
    at = 0
    for c in range(COMPONENTS):
        many = with_component(b, c)
        for e in range(n):
            for i in range(many):
                flat[at + i] = b.U[c][e][i]
            at += many


def load(b: Bank, saved: Bank) -> None:
    """Go on with a bank that was saved."""
    copy_bank(b, saved)
    flat = columns_of(saved)
    at = 0
    for c in range(COMPONENTS):
        many = with_component(b, c)
        for e in range(N):
            for i in range(many):
                b.U[c][e][i] = flat[at + i] if e < saved.carried else 0.0
            at += many if e < saved.carried else 0


def copy_saved(to: Bank, saved: Bank) -> None:
    """Copy a bank that was saved."""
    copy_bank(to, saved)
    flat = columns_of(saved)
    copied = columns_of(to)
    for i in range(saved.carried * (saved.n + saved.pairs + saved.triples + saved.fours)):
        copied[i] = flat[i]
