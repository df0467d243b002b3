"""Columns of the fault hypotheses: what the filter's own steps do to the error by each fault.

The filter knows nothing of a fault b; so the state is off by U b, and U follows from each step that
was really taken: ``U <- Phi U`` between, ``U <- U - K (H U + D)`` at a correction, where D is what
the fault adds to the reading itself. The transitions of many samples are multiplied up first, and
the columns follow by all at once when a reading comes.

Source: Friedland 1969 (separated bias), in the form of Willsky and Jones 1976.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.memory.bank import MOVING, Bank
from cython.cimports.ekf_companion.core.memory.enums import (
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
    FAULT_BARO_RAMP,
    FAULT_BARO_STEP,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
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


def move(b: Bank, k: Parameters, m: Motion, dt: float) -> None:
    """Multiply in the transition over which P was just carried on; see ``covariance``."""
    h = 0.5 * dt
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


def follow(x: State, b: Bank) -> None:
    """Let all columns follow the state's motion, and what was drawn anew meanwhile."""
    for i in range(b.n):
        h = address(b.instance[i])
        for c in range(h.rows):
            follow_column(b, h.U[c])
    for e in range(N):
        if x.redrawn[e] != b.redrawn[e]:
            b.redrawn[e] = x.redrawn[e]
            # a copy of an error and a reading has the fault of both in it; nothing else owes to
            # what was before
            source = cython.cast(cython.Py_ssize_t, x.copied[e])
            for i in range(b.n):
                h = address(b.instance[i])
                for c in range(h.rows):
                    h.U[c][e] = h.U[c][source] if source >= 0 else 0.0
                if e == E_BARO and h.kind == FAULT_BARO_STEP:
                    h.U[0][e] -= 1.0
                elif e == E_BARO and h.kind == FAULT_BARO_RAMP:
                    h.U[0][e] -= (x.t - h.t0) * 1e-9
    stand(b)


def follow_column(b: Bank, u: Vector) -> None:
    """Let one column follow."""
    look_ahead(b, u, b.work)
    for i in range(9):
        u[i] = b.work[i]
    u[E_HEADING] *= b.faded[0]
    for i in range(3):
        u[E_GNSS + i] *= b.faded[1]
        u[E_GNSS_VEL + i] *= b.faded[2]


def look_ahead(b: Bank, u: Vector, out: Vector) -> None:
    """Write attitude, velocity and position of a column as of now; the column stays behind."""
    for i in range(3):
        turn = u[E_ATT + i]
        vel = u[E_VEL + i]
        pos = u[E_POS + i] + b.Phi[E_POS + i][E_VEL + i] * vel
        for r in range(3):
            turn += b.Phi[E_ATT + i][E_BG + r] * u[E_BG + r]
            vel += (
                b.Phi[E_VEL + i][E_ATT + r] * u[E_ATT + r]
                + b.Phi[E_VEL + i][E_BG + r] * u[E_BG + r]
                + b.Phi[E_VEL + i][E_BA + r] * u[E_BA + r]
            )
            pos += (
                b.Phi[E_POS + i][E_ATT + r] * u[E_ATT + r]
                + b.Phi[E_POS + i][E_BG + r] * u[E_BG + r]
                + b.Phi[E_POS + i][E_BA + r] * u[E_BA + r]
            )
        out[E_ATT + i] = turn
        out[E_VEL + i] = vel
        out[E_POS + i] = pos


def observe(x: State, b: Bank, o: Observation) -> None:
    """Write into T what each component does to the rows of an observation, by the state: H U."""
    for i in range(b.n):
        for r in range(o.rows):
            for c in range(3):
                b.T[i][r][c] = 0.0
    n = carried(x)
    for r in range(o.rows):
        for e in range(n):
            slope = o.H[r][e]
            if slope != 0.0:
                for i in range(b.n):
                    h = address(b.instance[i])
                    for c in range(h.rows):
                        b.T[i][r][c] += slope * h.U[c][e]


def take_rows(x: State, b: Bank, o: Observation) -> None:
    """Take T for a correction: as it was judged, or else by the state alone."""
    if b.is_observed == 0:
        follow(x, b)
        observe(x, b, o)
    b.is_observed = 0


def correct(x: State, o: Observation) -> None:
    """Let the columns follow a correction that was just made by all rows at once.

    ``o.PHt`` holds the gains of the whitened rows, ``o.L`` the factor of S that they were made
    with, ``o.dx`` what the state was moved by.
    """
    b = address(o.bank[0])
    take_rows(x, b, o)
    n = carried(x)
    for i in range(b.n):
        h = address(b.instance[i])
        for c in range(h.rows):
            delay = h.U[c][E_DELAY]
            for r in range(o.rows):
                s = b.T[i][r][c]
                for j in range(r):
                    s -= o.L[r][j] * b.T[i][j][c]
                s /= o.L[r][r]
                b.T[i][r][c] = s
                for e in range(n):
                    h.U[c][e] -= o.PHt[r][e] * s
            if o.shows_delay == 0:
                h.U[c][E_DELAY] = delay
            turn(h.U[c], o.dx)


def correct_yaw(x: State, o: Observation) -> None:
    """The same of a correction of yaw alone, by ``o.gain``."""
    b = address(o.bank[0])
    take_rows(x, b, o)
    n = carried(x)
    for i in range(b.n):
        h = address(b.instance[i])
        for c in range(h.rows):
            for e in range(n):
                h.U[c][e] -= o.gain[e] * b.T[i][0][c]
            turn(h.U[c], o.dx)


def correct_delay(x: State, o: Observation, gain: float) -> None:
    """The same of a correction of the fixes' delay alone, by its gain."""
    b = address(o.bank[0])
    take_rows(x, b, o)
    for i in range(b.n):
        h = address(b.instance[i])
        for c in range(h.rows):
            h.U[c][E_DELAY] -= gain * b.T[i][0][c]


def turn(u: Vector, dx: Vector) -> None:
    """Turn a column's attitude as the error was, when dx was moved into the state."""
    p0 = u[0]
    p1 = u[1]
    p2 = u[2]
    u[0] = p0 + 0.5 * (dx[1] * p2 - dx[2] * p1)
    u[1] = p1 + 0.5 * (dx[2] * p0 - dx[0] * p2)
    u[2] = p2 + 0.5 * (dx[0] * p1 - dx[1] * p0)
