"""Magnetic field: whether it is the Earth's, and how noisy the magnetometer is.

Its strength and its dip are only judged by: they say whether this is the Earth's field at all.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.filter.rotation import to_dcm
from cython.cimports.ekf_companion.core.filter.update import innovate
from cython.cimports.ekf_companion.core.memory.constants import NEVER, THREE_SIGMA2
from cython.cimports.ekf_companion.core.memory.enums import MODE_ATTITUDE, N
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.ekf_companion.core.trust.gate import follow_share
from cython.cimports.libc.math import asin, fabs, sqrt

STEADY = cython.declare(cython.double, 0.1)
"""Share by which the strength of an undisturbed field may differ from its own mean."""
STEADY_TIME = cython.declare(cython.double, 10.0)
"""Time constant of that mean, s."""
DISTURBED_TIME = cython.declare(cython.double, 60.0)
"""Time constant of the mean while the field differs: a lasting change is adopted, s."""
NEXT = cython.declare(cython.double, 1e9)
"""Silence of the magnetometer after which its noise is learnt from a new block, ns."""
FIELD_BLOCK = cython.declare(cython.double, 1.9e9)
"""Least length of a block, ns."""
FIRST_MEMORY = cython.declare(cython.double, 3.0)
"""Blocks that what is configured counts for."""
LARGEST_MEMORY = cython.declare(cython.double, 25.0)
"""Blocks over which the noise is learnt."""
LARGEST_SHARE = cython.declare(cython.double, 9.0)
"""Largest share: noise is understated at most three times."""
WHITE_MEMORY = cython.declare(cython.double, 500.0)
"""Azimuths over which it is learnt how much they differ by: as long as those blocks at 10 Hz."""
LEAST_SHARE = cython.declare(cython.double, 0.05)
"""Least share of the configured variance, for the best of magnetometers."""


def is_natural(x: State, k: Parameters, o: Observation, mag_b: Vector) -> bool:
    """Return whether a magnetic field (gauss) is the Earth's.

    By the strength and the dip that the World Magnetic Model gives (the dip once the tilt is
    known), and by its own mean strength, from which a passing piece of iron makes it differ.
    """
    mx = mag_b[0] - x.hard_iron[0]
    my = mag_b[1] - x.hard_iron[1]
    mz = mag_b[2] - x.hard_iron[2]
    size = sqrt(mx * mx + my * my + mz * mz)
    if not size > 0.0 or not is_steady(x, size):
        return False
    if x.field.strength > 0.0:
        if fabs(size - x.field.strength) > k.field_strength * x.field.strength:
            return False
        if x.mode >= MODE_ATTITUDE and x.needs_reset == 0.0:
            to_dcm(x.q_nb, o.C_nb)
            d = (o.C_nb[2][0] * mx + o.C_nb[2][1] * my + o.C_nb[2][2] * mz) / size
            d = 1.0 if d > 1.0 else (-1.0 if d < -1.0 else d)
            if fabs(asin(d) - x.field.inclination) > k.field_dip:
                return False
    return True


def is_steady(x: State, size: float) -> bool:
    """Return whether a field is as strong as its own mean, which follows slowly while it is not."""
    if not x.strength > 0.0:
        x.strength = size
        x.strength_t = x.t
        x.strength_t0 = x.t
    steady = cython.declare(cython.bint, fabs(size - x.strength) <= STEADY * x.strength)
    gain = (x.t - x.strength_t) * 1e-9
    memory = DISTURBED_TIME
    if steady:
        memory = (x.t - x.strength_t0) * 1e-9
        memory = memory if memory < STEADY_TIME else STEADY_TIME
    if gain > 0.0:
        gain = gain / (gain + memory)
    x.strength += gain * (size - x.strength)
    x.strength_t = x.t
    return steady


def innovate_azimuth(x: State, o: Observation) -> float:
    """Return the NIS of a field's azimuth with the noise that was learnt, and learn from it.

    A magnetometer shows its noise by how far the mean of two seconds is from that of the two
    before. From one reading to the next it would look better than it is: currents and turns make
    errors that last a second.
    """
    learnt = address(x.field_noise)
    stated = o.R[0][0]
    o.R[0][0] = (learnt.share if learnt.share > learnt.white else learnt.white) * stated
    nis = innovate(x, o)
    if not x.t - learnt.t < NEXT:
        begin_block(x)
        learnt.has_last = 0.0
    learnt.t = x.t
    learnt.n += 1.0
    learnt.sum += o.z[0]
    for j in range(N):
        learnt.own += o.H[0][j] * o.PHt[0][j]
    if x.t - learnt.t0 < FIELD_BLOCK:
        return nis
    mean = learnt.sum / learnt.n
    if learnt.has_last != 0.0:
        own = learnt.own / learnt.n
        change = mean - learnt.last
        seen = (0.5 * learnt.n * change * change - own) / stated
        memory = learnt.memory if learnt.memory < LARGEST_MEMORY else LARGEST_MEMORY
        learnt.memory += 1.0
        learnt.share = follow_share(learnt.share, seen, o.R[0][0], own, memory)
        if learnt.share < LEAST_SHARE:
            learnt.share = LEAST_SHARE
    begin_block(x)
    learnt.last = mean
    learnt.has_last = 1.0
    return nis


def compare(x: State, o: Observation) -> None:
    """Learn how much an azimuth differs from the last one: no less is the magnetometer's noise.

    That is known in a second, before anything that it makes can be taken for a fault.
    """
    learnt = address(x.field_noise)
    change = o.z[0] - learnt.z
    seen = 0.5 * change * change / o.R[0][0]
    if x.t - learnt.t < NEXT:
        if learnt.looks == 0.0:
            learnt.white = 1.0
        learnt.looks += 1.0 if learnt.looks < WHITE_MEMORY else 0.0
        seen = seen if seen < THREE_SIGMA2 * LARGEST_SHARE else THREE_SIGMA2 * LARGEST_SHARE
        learnt.white += (seen - learnt.white) / (FIRST_MEMORY + learnt.looks)
    learnt.z = o.z[0]


def begin_block(x: State) -> None:
    """Begin a new block of azimuths of the field."""
    learnt = address(x.field_noise)
    learnt.t0 = x.t
    learnt.n = 0.0
    learnt.sum = 0.0
    learnt.own = 0.0


def forget_noise(x: State) -> None:
    """Take the magnetometer's noise for what is configured."""
    x.field_noise.share = 1.0
    x.field_noise.white = 0.0
    x.field_noise.looks = 0.0
    x.field_noise.memory = FIRST_MEMORY
    x.field_noise.t = NEVER
