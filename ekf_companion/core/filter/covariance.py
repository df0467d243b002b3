"""Error covariance over the motion since it was last carried on.

The attitude error is a rotation vector in n: ``C_true = exp(theta) C``. The transition is of second
order in the interval, so that it serves 10 Hz as well as 1 kHz.

Source: Groves 2013, chapter 14; Sola 2017, section 7 (global angular error).
"""

from __future__ import annotations

from cython.cimports.ekf_companion.core.filter.slow_error import carried
from cython.cimports.ekf_companion.core.filter.strapdown import forget_pending
from cython.cimports.ekf_companion.core.memory.enums import (
    CORE,
    E_ATT,
    E_BA,
    E_BARO,
    E_BG,
    E_GNSS,
    E_GNSS_VEL,
    E_HEADING,
    E_IRON,
    E_POS,
    E_VEL,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Square
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Motion
from cython.cimports.ekf_companion.core.memory.state import State


def propagate_covariance(x: State, k: Parameters, m: Motion) -> None:
    """Propagate P over the motion that is pending: Phi P Phi' + Q.

    With ``G = -C dt`` (from a bias) and ``S = -[dv x]`` (from attitude to velocity):

    ``theta += G bg``; ``v += S theta + S G/2 bg + G ba``;
    ``p += dt v + S dt/2 theta + S G dt/6 bg + G dt/2 ba``.
    """
    dt = x.pending.dt
    if dt == 0.0:
        return
    n = carried(x)
    write_transition_blocks(x, m)
    multiply_rows(x, m, dt, n)
    multiply_columns(x, m, dt)
    add_noise(x, k, m, dt)

    if m.slow_dt > 0.0:
        fade_slow_errors(x, k, m, m.slow_dt)

    # Both halves the same: within the nine rows the lower triangle follows the upper,
    # but for velocity by position, which was made as position by velocity; then the rows below
    for i in range(3):
        for j in range(3):
            x.P[E_VEL + i][E_POS + j] = x.P[E_POS + j][E_VEL + i]
    for i in range(9):
        for j in range(i + 1, 9):
            x.P[j][i] = x.P[i][j]
    for i in range(9):
        for j in range(9, n):
            x.P[j][i] = x.P[i][j]
    forget_pending(x)


def write_transition_blocks(x: State, m: Motion) -> None:
    """Write G, S and S G / 2 of the motion that is pending."""
    for i in range(3):
        m.dv_n[i] = x.pending.dv_n[i]
        for j in range(3):
            m.G[i][j] = -x.pending.C_nb_dt[i][j]
    m.S[0][0] = 0.0
    m.S[0][1] = m.dv_n[2]
    m.S[0][2] = -m.dv_n[1]
    m.S[1][0] = -m.dv_n[2]
    m.S[1][1] = 0.0
    m.S[1][2] = m.dv_n[0]
    m.S[2][0] = m.dv_n[1]
    m.S[2][1] = -m.dv_n[0]
    m.S[2][2] = 0.0
    for i in range(3):
        for j in range(3):
            m.SG[i][j] = 0.5 * (
                m.S[i][0] * m.G[0][j] + m.S[i][1] * m.G[1][j] + m.S[i][2] * m.G[2][j]
            )


def multiply_rows(x: State, m: Motion, dt: float, n: int) -> None:
    """Multiply P by Phi from the left: the nine rows of position, velocity, attitude."""
    h = 0.5 * dt
    # position first, then velocity, then attitude: each from what is still old
    for i in range(3):
        s0 = m.S[i][0]
        s1 = m.S[i][1]
        s2 = m.S[i][2]
        g0 = m.G[i][0]
        g1 = m.G[i][1]
        g2 = m.G[i][2]
        b0 = m.SG[i][0]
        b1 = m.SG[i][1]
        b2 = m.SG[i][2]
        for j in range(n):
            # the force's part of the velocity's row serves the position too, halved by dt/2
            m.row[j] = (s0 * x.P[E_ATT][j] + s1 * x.P[E_ATT + 1][j] + s2 * x.P[E_ATT + 2][j]) + (
                g0 * x.P[E_BA][j] + g1 * x.P[E_BA + 1][j] + g2 * x.P[E_BA + 2][j]
            )
            m.row2[j] = b0 * x.P[E_BG][j] + b1 * x.P[E_BG + 1][j] + b2 * x.P[E_BG + 2][j]
        for j in range(n):
            x.P[E_POS + i][j] += dt * x.P[E_VEL + i][j] + h * (m.row[j] + (2.0 / 3.0) * m.row2[j])
        for j in range(n):
            x.P[E_VEL + i][j] += m.row[j] + m.row2[j]
    for i in range(3):
        g0 = m.G[i][0]
        g1 = m.G[i][1]
        g2 = m.G[i][2]
        for j in range(n):
            x.P[E_ATT + i][j] += g0 * x.P[E_BG][j] + g1 * x.P[E_BG + 1][j] + g2 * x.P[E_BG + 2][j]


def multiply_columns(x: State, m: Motion, dt: float) -> None:
    """Multiply P by Phi' from the right: the columns of the nine rows that moved."""
    h = 0.5 * dt
    for r in range(9):
        for j in range(3):
            s0 = (m.S[j][0] * x.P[r][0] + m.S[j][1] * x.P[r][1] + m.S[j][2] * x.P[r][2]) + (
                m.G[j][0] * x.P[r][E_BA]
                + m.G[j][1] * x.P[r][E_BA + 1]
                + m.G[j][2] * x.P[r][E_BA + 2]
            )
            s1 = (
                m.SG[j][0] * x.P[r][E_BG]
                + m.SG[j][1] * x.P[r][E_BG + 1]
                + m.SG[j][2] * x.P[r][E_BG + 2]
            )
            x.P[r][E_POS + j] += dt * x.P[r][E_VEL + j] + h * (s0 + (2.0 / 3.0) * s1)
            x.P[r][E_VEL + j] += s0 + s1
        for j in range(3):
            x.P[r][j] += (
                m.G[j][0] * x.P[r][E_BG]
                + m.G[j][1] * x.P[r][E_BG + 1]
                + m.G[j][2] * x.P[r][E_BG + 2]
            )


def add_noise(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Add Q to the upper triangle of P: white noise of rate and force, walks of the slow states."""
    h = 0.5 * dt
    for i in range(3):
        for j in range(i, 3):
            s0 = 0.0
            s1 = 0.0
            for r in range(3):
                g0 = m.C_nb[i][r] * m.C_nb[j][r]
                s0 += g0 * m.q[r]
                s1 += g0 * m.q[r + 3]
            x.P[E_ATT + i][E_ATT + j] += s0
            x.P[E_VEL + i][E_VEL + j] += s1
            x.P[E_POS + i][E_VEL + j] += h * s1
            if j > i:
                x.P[E_POS + j][E_VEL + i] += h * s1
            x.P[E_POS + i][E_POS + j] += (dt * dt / 3.0) * s1
    for j in range(3):
        x.P[E_BG + j][E_BG + j] += m.gyro_walk
        x.P[E_BA + j][E_BA + j] += m.accel_walk
        x.P[E_BA + j][E_BA + j] += m.new_bias
        x.P[E_IRON + j][E_IRON + j] += k.iron_walk * k.iron_walk * dt
    x.P[E_BARO][E_BARO] += m.slow_walk[E_BARO]
    for e in range(CORE, carried(x)):
        x.P[e][e] += m.slow_walk[e]


def fade_slow_errors(x: State, k: Parameters, m: Motion, dt: float) -> None:
    """Let the slow errors of heading and GNSS forget themselves; each is kept at its level."""
    x.heading_offset -= m.heading_faded * x.heading_offset
    decay(x, E_HEADING, m.heading_faded, m.heading_level)
    faded = dt / (dt + k.gnss_offset_time)
    for i in range(3):
        x.gnss_offset[i] -= faded * x.gnss_offset[i]
        decay(x, E_GNSS + i, faded, x.gnss_offset_var[0 if i < 2 else 1])
    faded = dt / (dt + k.gnss_vel_offset_time)
    for i in range(3):
        x.gnss_vel_offset[i] -= faded * x.gnss_vel_offset[i]
        decay(x, E_GNSS_VEL + i, faded, x.gnss_vel_offset_var[0 if i < 2 else 1])


def write_transition(k: Parameters, m: Motion, dt: float, Phi: Square) -> None:
    """Write the Phi of the interval that P was just propagated over, shape (N, N).

    The filter never forms it; who goes back over the interval needs it.
    """
    for i in range(N):
        for j in range(N):
            Phi[i][j] = 0.0
        Phi[i][i] = 1.0
    for i in range(3):
        Phi[E_POS + i][E_VEL + i] = dt
        for j in range(3):
            s = m.S[i][j]
            g = m.G[i][j]
            b = m.SG[i][j]
            Phi[E_ATT + i][E_BG + j] = g
            Phi[E_VEL + i][E_ATT + j] = s
            Phi[E_VEL + i][E_BG + j] = b
            Phi[E_VEL + i][E_BA + j] = g
            Phi[E_POS + i][E_ATT + j] = 0.5 * dt * s
            Phi[E_POS + i][E_BG + j] = dt / 3.0 * b
            Phi[E_POS + i][E_BA + j] = 0.5 * dt * g
    faded = m.slow_dt
    Phi[E_HEADING][E_HEADING] = 1.0 - m.heading_faded
    for i in range(3):
        Phi[E_GNSS + i][E_GNSS + i] = 1.0 - faded / (faded + k.gnss_offset_time)
        Phi[E_GNSS_VEL + i][E_GNSS_VEL + i] = 1.0 - faded / (faded + k.gnss_vel_offset_time)


def decay(x: State, e: int, g: float, level: float) -> None:
    """Decay the Gauss-Markov error state e by the share g, towards its stationary variance.

    Within the first nine rows only the column is written: those are mirrored afterwards.
    """
    n = carried(x)
    for j in range(n):
        x.P[j][e] -= g * x.P[j][e]
    for j in range(9, n):
        x.P[e][j] -= g * x.P[e][j]
    x.P[e][e] += g * (2.0 - g) * level
