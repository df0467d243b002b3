"""Protection level: the distance that the position error exceeds with a stated probability.

What is shown is the mean of a mixture: with probability p the fault i is there, and the right
estimate is ``x + U b`` with ``P + U M U'``. The level is the distance beyond which the tails of all
these, each by its probability, add up to the risk; it is found by bisection, from above.

- Vertical: both tails of the normal distribution.
- Horizontal: an error is no farther from what is shown than its mean is, and itself from that; and
  that is farther than r no more often than if its covariance were round, of the larger eigenvalue
  (Anderson 1955): ``exp(-r^2 / 2 var)``, Rayleigh's tail. It is an upper bound, and the exact tail
  where nothing is wrong and the error is round.
- A fault of the level and one of the vertical may be there at once. Each counts in both directions
  by its own probability; that nothing is wrong counts beside those that show in that direction.

Source: Joerger and Pervan 2013 (integrity risk over fault hypotheses); Anderson 1955, "The integral
of a symmetric unimodal function over a symmetric convex set".
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter import columns
from cython.cimports.ekf_companion.core.memory.bank import INSTANCES, Bank
from cython.cimports.ekf_companion.core.memory.constants import NAN
from cython.cimports.ekf_companion.core.memory.enums import (
    E_POS,
    FAULT_ACCEL_NOISE,
    MODE_NAVIGATE,
    SHOWS_ALL,
    SHOWS_LEVEL,
    SHOWS_VERTICAL,
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Protection, Scratch
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust import repair
from cython.cimports.libc.math import erfc, exp, fabs, isfinite, sqrt

SHARE = cython.declare(cython.double, 0.01)
"""Share of the risk that may be taken as exceeded at any distance: of what is too improbable to be
looked at. It moves the level by less than a hundredth of itself."""
HALVINGS = cython.declare(cython.int, 7)
"""Of the interval from one distance to its double: the level is too large by 1 % at most."""
FARTHEST = cython.declare(cython.double, 1e9)
"""m: farther than anything on the Earth."""
ROOT_HALF = cython.declare(cython.double, 0.7071067811865476)


def find_levels(x: State, k: Parameters, w: Scratch) -> None:
    """Find the protection levels of what is shown now.

    NaN where the hypotheses do not decide, or there is no position.
    """
    q = address(w.protection)
    q.horizontal = NAN
    q.vertical = NAN
    if not w.observation.has_bank or k.weighs_faults != WEIGH_ACT or x.mode != MODE_NAVIGATE:
        return
    fill(x, k, address(w.observation.bank[0]), q)
    if isfinite(larger_eigenvalue(q, 0)) and isfinite(q.dd[0]):
        q.horizontal = find_level(q, k.risk, False)
        q.vertical = find_level(q, k.risk, True)


def fill(x: State, k: Parameters, b: Bank, q: Protection) -> None:
    """Write where the error is by each hypothesis, and how probable that is."""
    repair.mix(x, k, b)
    q.n = 0
    q.rest = 0.0
    q.nothing = 1.0
    q.nothing_vertical = 1.0
    for e in range(E_POS, E_POS + 3):
        shows = SHOWS_VERTICAL if e == E_POS + 2 else SHOWS_LEVEL
        b.work[e] = -shown(b, shows, e)
    add(x, b, q, 0.0)
    for i in range(b.n):
        h = address(b.instance[i])
        shows = k.fault[h.kind].shows
        if h.kind >= FAULT_ACCEL_NOISE or not h.p > 0.0:
            continue
        if shows != SHOWS_VERTICAL:
            q.nothing -= h.p
        if shows != SHOWS_LEVEL:
            q.nothing_vertical -= h.p
        if h.p < SHARE * k.risk / INSTANCES:
            q.rest += h.p
            continue
        for e in range(E_POS, E_POS + 3):
            b.work[e] = -shown(b, shows, e)
        for c in range(h.rows):
            columns.look_ahead(b, i, c, b.ahead[c])
            for e in range(E_POS, E_POS + 3):
                b.work[e] += b.ahead[c][e] * h.b[c]
        add(x, b, q, h.p)
        for c in range(h.rows):
            for d in range(h.rows):
                widen(q, b.ahead[c], b.ahead[d], h.M[c][d])


def shown(b: Bank, shows: int, e: int) -> float:
    """Return what is added to a state in what is shown, but for faults that are independent."""
    if shows == SHOWS_ALL:
        return b.mean[e]
    return b.means[SHOWS_ALL][e] + b.means[shows][e]


def add(x: State, b: Bank, q: Protection, p: float) -> None:
    """Add a component whose mean is ``b.work`` from what is shown, of the filter's covariance."""
    north = b.work[E_POS]
    east = b.work[E_POS + 1]
    q.p[q.n] = p
    q.far[q.n] = sqrt(north * north + east * east)
    q.down[q.n] = fabs(b.work[E_POS + 2])
    q.nn[q.n] = x.P[E_POS][E_POS]
    q.ne[q.n] = x.P[E_POS][E_POS + 1]
    q.ee[q.n] = x.P[E_POS + 1][E_POS + 1]
    q.dd[q.n] = x.P[E_POS + 2][E_POS + 2]
    q.n += 1


def widen(q: Protection, u: Vector, v: Vector, covariance: float) -> None:
    """Add what is not known of two components of its fault to the component added last."""
    i = q.n - 1
    q.nn[i] += u[E_POS] * v[E_POS] * covariance
    q.ne[i] += u[E_POS] * v[E_POS + 1] * covariance
    q.ee[i] += u[E_POS + 1] * v[E_POS + 1] * covariance
    q.dd[i] += u[E_POS + 2] * v[E_POS + 2] * covariance


def find_level(q: Protection, risk: float, is_vertical: bool) -> float:
    """Return the distance that the error exceeds with the risk, at most."""
    high = sqrt(q.dd[0] if is_vertical else larger_eigenvalue(q, 0))
    while not exceeded(q, high, is_vertical) <= risk and high < FARTHEST:
        high *= 2.0
    low = 0.5 * high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if exceeded(q, middle, is_vertical) <= risk:
            high = middle
        else:
            low = middle
    return high


def exceeded(q: Protection, far: float, is_vertical: bool) -> float:
    """Return the probability, at most, that the error is farther than a distance, m."""
    total = q.rest
    for i in range(q.n):
        p = q.p[i]
        if i == 0:
            p = q.nothing_vertical if is_vertical else q.nothing
        if p <= 0.0:
            continue
        if is_vertical:
            s = ROOT_HALF / sqrt(q.dd[i])
            total += 0.5 * p * (erfc(s * (far - q.down[i])) + erfc(s * (far + q.down[i])))
        else:
            beyond = far - q.far[i]
            if beyond > 0.0:
                p *= exp(-0.5 * beyond * beyond / larger_eigenvalue(q, i))
            total += p
    return total


def larger_eigenvalue(q: Protection, i: int) -> float:
    """Return the larger eigenvalue of a component's horizontal covariance, m^2."""
    apart = q.nn[i] - q.ee[i]
    return 0.5 * (q.nn[i] + q.ee[i] + sqrt(apart * apart + 4.0 * q.ne[i] * q.ne[i]))
