"""Score: the inertial noise, learnt from what the fixes say of each second.

A noise parameter is a small bias that is always there, constant over its window. Over a window the
readings say ``lam = sum T' y`` of such a bias, to ``Lam = sum T' T``; the slope of the likelihood
by the logarithm of the noise follows from both, and is zero in the mean exactly where the noise is
right. A log-normal prior holds it where nothing is said.

Source: the score of a variance, e.g. Harville 1977; INS/GNSS windows: Mehra 1970.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.memory.bank import Bank
from cython.cimports.ekf_companion.core.memory.constants import EVEN, NEVER, THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import WEIGH_ACT
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import loud
from cython.cimports.libc.math import exp, log

LONGEST_WINDOW = cython.declare(cython.double, 2.0)
"""s; after a silence of the fixes a window says nothing."""
NOISE_MEMORY = cython.declare(cython.double, 60.0)
"""Time constant with which what the noise was is forgotten, s."""
USUAL_LOG_SHARE = cython.declare(cython.double, -3.5)
"""ln 0.03: of what is configured, beside what the samples show themselves."""
LOG_SHARE_VAR = cython.declare(cython.double, 4.0)
"""Log-normal prior: seven times more or less."""
LARGEST_STEP = cython.declare(cython.double, 0.7)
"""Largest step of that logarithm: a window doubles the variance at most."""
HELD = cython.declare(cython.double, 1.2e9)
"""How long nothing is declared, nor good, after the noise has grown by half of that, ns: until the
next window has shown whether that was all."""


def begin(x: State, b: Bank) -> None:
    """Begin with the usual noise, or with what was learnt before.

    Who begins in motion has not felt yet how it shakes: with what is configured.
    """
    b.window_t = NEVER
    if b.information == 0.0:
        b.log_share = USUAL_LOG_SHARE if x.at_rest != 0.0 else 0.0


def add_to_window(b: Bank, first: int, o: Observation) -> None:
    """Add a reading to the window by which the inertial noise is learnt."""
    if b.astray > EVEN:  # it contradicts our yaw
        return
    for r in range(o.rows):
        if b.wrong[1 if b.group[r] != 0.0 else 0] > EVEN:  # what is wrong says nothing of ours
            continue
        for c in range(3):
            b.lam[first + c] += b.trial.T[r][c] * o.y[r]
            b.Lam[first + c] += b.trial.T[r][c] * b.trial.T[r][c]


def end_window(x: State, k: Parameters, b: Bank) -> None:
    """Learn the share of the configured inertial noise from a window, and begin another one.

    A noise is a bias that is constant over its window: the slope of the log-likelihood by the
    logarithm of its variance is ``(M lam^2 - M Lam) / 2``, whose mean is zero where M is right.
    """
    span = (x.t - b.window_t) * 1e-9
    if b.information == 0.0 and x.doubt > 1.0:  # the start has found more than is configured
        b.log_share = log(x.doubt)
    before = b.log_share
    if k.weighs_faults != WEIGH_ACT:
        b.log_share = log(x.doubt)
    elif b.window_t > NEVER and span < LONGEST_WINDOW:
        b.log_share += find_step(x, k, b, span)
        x.doubt = exp(b.log_share)
        loud.take_in(x, k, b)
    has_leapt = cython.declare(
        cython.bint, b.window_t > NEVER and b.log_share - before >= 0.5 * LARGEST_STEP
    )
    for i in range(b.n):
        h = address(b.instance[i])
        if has_leapt:
            h.evidence = h.earlier
        h.earlier = h.evidence
    if has_leapt:
        if x.t <= b.proven_t:  # nor is the start proven by fixes that the noise has misled
            b.proven_t = x.t + HELD
        b.hold_t = x.t + HELD
        if k.weighs_faults == WEIGH_ACT and x.proven_t < b.hold_t:
            x.proven_t = b.hold_t
    b.window_t = x.t
    for j in range(6):
        b.lam[j] = 0.0
        b.Lam[j] = 0.0


def find_step(x: State, k: Parameters, b: Bank, span: float) -> float:
    """Return the step of the logarithm of the share that a window of so many seconds asks for."""
    share = exp(b.log_share)
    slope = 0.0
    information = 0.0
    for j in range(6):
        configured = k.gyro_noise if j >= 3 else k.accel_noise
        configured *= configured * share
        learnt = x.noise[j - 3] if j >= 3 else x.noise[j + 3]
        part = configured / (configured + learnt)
        M = (configured + learnt) / span
        square = b.lam[j] * b.lam[j]
        most = THREE_SIGMA2 * (b.Lam[j] + M * b.Lam[j] * b.Lam[j])
        square = square if square < most else most
        # as far as the bias is known from the window
        scale = part / (1.0 + M * b.Lam[j])
        slope += 0.5 * scale * M * (square / (1.0 + M * b.Lam[j]) - b.Lam[j])
        information += 0.5 * scale * scale * M * M * b.Lam[j] * b.Lam[j]
    kept = exp(-span / NOISE_MEMORY)
    b.information = kept * b.information + information
    slope -= (1.0 - kept) * (b.log_share - USUAL_LOG_SHARE) / LOG_SHARE_VAR
    step = slope / (b.information + 1.0 / LOG_SHARE_VAR)
    step = step if step < LARGEST_STEP else LARGEST_STEP
    return step if step > -LARGEST_STEP else -LARGEST_STEP


def is_noisy(x: State) -> bool:
    """Return whether the inertial samples are noisier than configured: they may be what is erratic.

    Nor is there anything to go on by, then, without the source.
    """
    return x.doubt > 1.0
