"""Innovations of a receiver: what share of its noise is white, and whether they are one-sided."""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.memory.constants import SAME_CAUSE
from cython.cimports.ekf_companion.core.memory.enums import AID_POSITION, AID_VELOCITY, E_VEL, N
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Fix, Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import gate, slide
from cython.cimports.libc.math import isnan

WHITE_MEMORY = cython.declare(cython.double, 100.0)
"""Fixes over which a receiver's white noise is learnt."""
NEXT = cython.declare(cython.double, 3e9)
"""Longest time between innovations that are compared, ns."""
FIRST_MEMORY = cython.declare(cython.double, 25.0)
"""Weight of the initial share, in fixes."""
FIRST_VELOCITY_MEMORY = cython.declare(cython.double, 15.0)
"""The same of a velocity beside good samples: it has three axes to be learnt from, and hardly a
slow error."""
PROVEN_DOUBT = cython.declare(cython.double, 0.03)
"""Doubt below which samples are good."""
LEAST_SHARE = cython.declare(cython.double, 0.01)
"""Least white share: receivers overstate their white error at most ten times."""
MEAN_TIME = cython.declare(cython.double, 3.0)
"""Time constant of the mean of the innovations, s."""
LARGEST_TERM = cython.declare(cython.double, 4.0)
"""Largest contribution of one fix to that mean, sigmas."""
LARGEST_MEAN = cython.declare(cython.double, 1.5)
"""Mean of the innovations beyond which the receiver is refused, sigmas of one innovation."""
MEAN_SIGMAS = cython.declare(cython.double, 5.5)
"""The same in sigmas of the mean itself; both must be exceeded."""
SHOWN_SIGMAS = cython.declare(cython.double, 2.0)
"""Way in sigmas of a fix that would have shown in the positions."""


def white_share(x: State, k: Parameters, aid: int) -> float:
    """Return the white share of a stated variance: the configured or the learnt one."""
    if aid != AID_VELOCITY and not isnan(k.white_share):
        return k.white_share
    return x.white_share[aid] if x.white_share[aid] > LEAST_SHARE else LEAST_SHARE


def learn_white_share(x: State, o: Observation, aid: int, stated_var: float) -> None:
    """Learn what share of the stated variance is white, from an observation that was judged.

    White is what changes from one innovation to the next, beyond the filter's own doubt. Where that
    doubt is large they tell little of it, and weigh less.
    """
    seen = 0.0
    own = 0.0
    noise = 0.0
    memory = FIRST_MEMORY + x.nis_n[aid]
    if aid == AID_VELOCITY and x.doubt < PROVEN_DOUBT:
        memory = FIRST_VELOCITY_MEMORY + x.nis_n[aid]
    is_next = cython.declare(cython.bint, x.t - x.last_z_t[aid] < NEXT)
    x.last_z_t[aid] = x.t
    for r in range(o.rows):
        change = o.z[r] - x.last_z[aid][r]
        seen += 0.5 * change * change
        x.last_z[aid][r] = o.z[r]
        noise += o.R[r][r]
        for j in range(N):
            own += o.H[r][j] * o.PHt[r][j]
    if not is_next:
        return
    seen = (seen - own) / (o.rows * stated_var)
    if memory > WHITE_MEMORY:
        memory = WHITE_MEMORY
    x.white_share[aid] = gate.follow_share(x.white_share[aid], seen, noise, own, memory)
    if x.white_share[aid] < 0.0:
        x.white_share[aid] = 0.0


def is_dragged(x: State, o: Observation, fix: Fix, aid: int) -> bool:
    """Return whether the fixes deviate to one side, each by too little for its gate.

    The mean of the whitened innovations over some seconds is near zero unless fixes and motion
    disagree; a receiver that is dragged off shows so long before any single fix does. While the
    inertial samples are in doubt, what is within the sigma that it states is no drag.
    """
    first = 0 if aid == AID_POSITION else 2
    gain = x.fix_dt / (x.fix_dt + MEAN_TIME)
    size = 0.0
    way = 0.0
    for r in range(o.rows):
        y = o.y[r]
        y = y if y < LARGEST_TERM else LARGEST_TERM
        y = y if y > -LARGEST_TERM else -LARGEST_TERM
        x.innovation_mean[first + r] += gain * (y - x.innovation_mean[first + r])
        size += x.innovation_mean[first + r] * x.innovation_mean[first + r]
        off = x.innovation_mean[first + r] * o.L[r][r]
        way += off * off
    shown = MEAN_SIGMAS * MEAN_SIGMAS * gain / (2.0 - gain)
    if x.is_one_sided[aid] != 0.0:
        shown *= 0.25
    x.is_one_sided[aid] = (
        1.0
        if size > shown
        and (x.doubt <= 1.0 or way > fix.stated_var[aid] or slide.contradicts_itself(x, fix))
        else 0.0
    )
    return x.is_one_sided[aid] != 0.0 and size > LARGEST_MEAN * LARGEST_MEAN


def is_denied_by_position(x: State, fix: Fix, o: Observation) -> bool:
    """Return whether the receiver's positions move as our velocity says, and not as its own.

    Were ours wrong by what its velocities have said since they are refused, the positions would
    deviate to one side within some seconds.
    """
    n = x.run[AID_VELOCITY].n + 1.0
    own = 0.0
    now = 0.0
    mean = 0.0
    for r in range(2):
        z = (x.run[AID_VELOCITY].z[r] + o.z[r]) / n
        own += x.P[E_VEL + r][E_VEL + r]
        now += o.z[r] * o.z[r]
        mean += z * z
    way = MEAN_TIME * MEAN_TIME * mean
    return (
        not gate.is_timed_out(x, AID_POSITION, SAME_CAUSE)
        and x.is_one_sided[AID_POSITION] == 0.0
        and way > SHOWN_SIGMAS * SHOWN_SIGMAS * fix.std[AID_POSITION] * fix.std[AID_POSITION]
        and mean > own
        and now > 0.1 * mean
    )
