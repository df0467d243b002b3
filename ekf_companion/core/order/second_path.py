"""Samples that are behind: of a clock that was set back, or of a second path.

If the clock was set back, the motion goes on from the newest sample. If a slower path has samples
of its own, between those that were heard, they show the motion of then once more. So they are
compared with both, axis by axis: with what lies around their stamps, from which a sample between
two others may differ as samples one interval apart do; and with the newest, from which those that
follow differ as samples some intervals apart do. Where the vehicle moves as it did then, nothing
tells.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance
from cython.cimports.ekf_companion.core.memory.enums import E_ATT, E_VEL, KIND_IMU
from cython.cimports.ekf_companion.core.memory.overlay import Structs
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.order.events import last_sample, next_sample
from cython.cimports.ekf_companion.core.order.stamps import Held
from cython.cimports.libc.math import atan2, exp, fabs, log, sqrt


def weigh_second_path(rows: Structs, size: int, held: Held, offset: int) -> float:
    """Return the log-likelihood that samples are of a second path beside that of a clock set back.

    What they have in common counts once: an axis is one observation, its mean square difference.

    Args:
        rows: The window, in order of time.
        size: Number of its rows.
        held: Samples that are behind, and events between them.
        offset: To be subtracted from their stamps, ns.
    """
    samples = 0
    for i in range(held.size):
        if held.kind[i] == KIND_IMU:
            samples += 1
    newest = last_sample(rows, size, rows[size - 1].t)
    ratio = cython.declare(cython.double, 0.0)
    for axis in range(6):
        near = _difference(rows, size, axis, 1)
        far = _difference(rows, size, axis, samples)
        if near <= 0.0 or far <= near:
            continue
        again = cython.declare(cython.double, 0.0)
        anew = cython.declare(cython.double, 0.0)
        count = 0
        for i in range(held.size):
            if held.kind[i] != KIND_IMU:
                continue
            t = cython.cast(cython.double, held.t_ns[i] - offset)
            before = last_sample(rows, size, t)
            after = next_sample(rows, size, before)
            if before < 0 or after == size:
                continue
            part = (t - rows[before].t) / (rows[after].t - rows[before].t)
            a = rows[before].values.all[axis]
            b = rows[after].values.all[axis]
            value = held.values[i, axis]
            again += (value - a - part * (b - a)) ** 2
            anew += (value - rows[newest].values.all[axis]) ** 2
            count += 1
        if count > 0:
            ratio += 0.5 * ((anew / far - again / near) / count + log(far / near))
    return ratio


def _difference(rows: Structs, size: int, axis: int, steps: int) -> float:
    """Return the mean square difference of an axis over some samples of the window."""
    total = cython.declare(cython.double, 0.0)
    count = 0
    first = 0
    lead = 0
    for last in range(size):
        if rows[last].kind != KIND_IMU:
            continue
        if lead < steps:
            lead += 1
            continue
        while rows[first].kind != KIND_IMU:
            first += 1
        total += (rows[last].values.all[axis] - rows[first].values.all[axis]) ** 2
        count += 1
        first += 1
    return total / count if count > 0 else 0.0


def inflate_by_second_path(x: State, then: State, ratio: float) -> None:
    """Inflate P by the motion since an earlier state, which may have been heard twice.

    Args:
        x: The state of now.
        then: The state by whose time the samples that are behind begin.
        ratio: As :func:`weigh_second_path` returned it; the two are as probable before it.
    """
    chance = 1.0 / (1.0 + exp(-ratio))
    q = x.q_nb
    p = then.q_nb
    w = q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3]
    a = q[1] * p[0] - q[0] * p[1] - q[2] * p[3] + q[3] * p[2]
    b = q[2] * p[0] - q[0] * p[2] - q[3] * p[1] + q[1] * p[3]
    c = q[3] * p[0] - q[0] * p[3] - q[1] * p[2] + q[2] * p[1]
    sine = sqrt(a * a + b * b + c * c)
    angle = 2.0 * atan2(sine, fabs(w))
    scale = chance * (angle / sine) ** 2 if sine > 0.0 else 0.0
    add_variance(x, E_ATT, scale * a * a)
    add_variance(x, E_ATT + 1, scale * b * b)
    add_variance(x, E_ATT + 2, scale * c * c)
    for i in range(3):
        gained = x.vel_n[i] - then.vel_n[i]
        add_variance(x, E_VEL + i, chance * gained * gained)
