"""Search for the delay of the fixes: at which the receiver's velocity is what ours was.

A delay that leaps by a second, as a link's does that begins to buffer, is no slope times a small
change: the velocity is another one then. So each fix is compared with the velocity of many earlier
times, and what fits best is where a hypothesis of the delay begins.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.past import gained_until
from cython.cimports.ekf_companion.core.memory.bank import DELAYS, Bank
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import AID_VELOCITY
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import exp, log

STEP = cython.declare(cython.double, 0.1)
"""Between two delays that are compared, s: in half of it a velocity changes by little more than its
noise."""
EARLIER = cython.declare(cython.int, 10)
"""Steps by which a fix may be less late than now: a link that no longer buffers."""
MEMORY = cython.declare(cython.double, 0.6)
"""Time constant over which a fit counts, s: three usual fixes; before that it was another delay."""


def forget(b: Bank) -> None:
    """Begin anew: no delay is better than another."""
    for g in range(DELAYS):
        b.delay_cost[g] = 0.0
    b.delay_rows = 0.0


def compare(x: State, b: Bank, o: Observation) -> None:
    """Add what a velocity costs if it is so much later, or less late, than taken to be."""
    kept = exp(-x.fix_dt / MEMORY)
    b.delay_rows = kept * b.delay_rows + o.rows
    for g in range(DELAYS):
        late = x.gnss_delay + (g - EARLIER) * STEP
        gained_until(x, x.t - late * 1e9, b.work)
        b.delay_cost[g] *= kept
        for r in range(o.rows):
            e = o.z[r] - (b.work[r] - o.then.until[r])
            s = 0.0
            for c in range(r + 1):
                s += o.L[r][c] * o.L[r][c]
            q = e * e / s
            if q > THREE_SIGMA2:
                q = THREE_SIGMA2 * (1.0 + log(q / THREE_SIGMA2))
            b.delay_cost[g] += q


def may_have_leapt(x: State) -> bool:
    """Return whether a delay that has leapt may not be found yet: the fixes of before tell nothing.

    So long the velocities have been refused that all of those have been compared.
    """
    return x.t - x.used_t[AID_VELOCITY] < (DELAYS - EARLIER) * STEP * 1e9


def best(b: Bank) -> float:
    """Return how much later than taken to be the fixes are best explained, s; 0: no better."""
    found = EARLIER
    for g in range(DELAYS):
        if b.delay_cost[g] < b.delay_cost[found]:
            found = g
    # where none fits, as of a vehicle that shakes, a better one is hardly the right one
    noise = b.delay_cost[found] / b.delay_rows if b.delay_rows > 0.0 else 1.0
    noise = noise if noise > 1.0 else 1.0
    if b.delay_cost[EARLIER] - b.delay_cost[found] < THREE_SIGMA2 * noise:
        return 0.0
    return (found - EARLIER) * STEP
