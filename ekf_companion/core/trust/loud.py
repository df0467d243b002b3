"""Inertial noise that leaps: what a vibration that begins has done to velocity and attitude.

No bias that is constant describes it, and what a filter of more noise would do neither: its state
walks. So it is a hypothesis whose size walks too: an error of the velocity (a gyro's: of the
attitude) that goes on from each fix to the next. Along the level it looks like a receiver that is
wrong in no shape, but shows in the vertical as well.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.update import add_columns
from cython.cimports.ekf_companion.core.memory.bank import Bank, Instance
from cython.cimports.ekf_companion.core.memory.constants import EVEN
from cython.cimports.ekf_companion.core.memory.enums import (
    E_ATT,
    E_VEL,
    FAULT_ACCEL_LOUD,
    FAULT_GYRO_LOUD,
    N,
)
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import exp, log


def is_loud(kind: int) -> cython.bint:
    """Return whether a hypothesis is that inertial noise has leapt."""
    return kind == FAULT_ACCEL_LOUD or kind == FAULT_GYRO_LOUD


def likely(b: Bank) -> int:
    """Return which one is more likely than not; -1: none."""
    for i in range(b.n):
        if is_loud(b.instance[i].kind) and b.instance[i].p > EVEN:
            return i
    return -1


def walk(k: Parameters, b: Bank, dt: float) -> None:
    """Let what they have done walk on over dt, s."""
    for i in range(b.n):
        h = address(b.instance[i])
        if is_loud(h.kind):
            for c in range(3):
                h.M[c][c] += k.fault[h.kind].std * k.fault[h.kind].std * dt


def write_until_now(b: Bank, i: int) -> None:
    """Write into ``b.trial.b`` and ``b.trial.M`` what one has done to its states until now."""
    h = address(b.instance[i])
    first = E_ATT if h.kind == FAULT_GYRO_LOUD else E_VEL
    for c in range(3):
        b.trial.b[c] = 0.0
        for e in range(3):
            b.trial.b[c] += b.U[e][first + c][i] * h.b[e]
        for d in range(3):
            b.trial.M[c][d] = 0.0
            for e in range(3):
                for f in range(3):
                    b.trial.M[c][d] += b.U[e][first + c][i] * h.M[e][f] * b.U[f][first + d][i]


def go_on(b: Bank, h: Instance, evidence: float) -> None:
    """Let one that has just begun go on from there, by its evidence until now; from zero: anew."""
    h.evidence = evidence
    h.earlier = evidence
    for c in range(3):
        h.b[c] = b.trial.b[c] if evidence > 0.0 else 0.0
        for d in range(3):
            h.M[c][d] = b.trial.M[c][d] if evidence > 0.0 else 0.0


def take_in(x: State, k: Parameters, b: Bank) -> None:
    """Take in what a likely one has done: the state is as uncertain, and the noise now as large.

    To be called once a second: for a fix or two a jump of the receiver looks alike.
    """
    i = likely(b)
    if i < 0:
        return
    h = address(b.instance[i])
    std = k.gyro_noise if h.kind == FAULT_GYRO_LOUD else k.accel_noise
    for e in range(N):
        b.work[e] = 0.0
        for c in range(3):
            b.work[e] += b.U[c][e][i] * h.b[c]
    add_columns(x, b, i, b.work, 1.0)
    b.log_share = log(exp(b.log_share) + k.fault[h.kind].std * k.fault[h.kind].std / (std * std))
    x.doubt = exp(b.log_share)
    h.evidence = 0.0
    h.earlier = 0.0
