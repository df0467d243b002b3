"""Heading: which source is used, and how it corrects yaw.

The magnetic field of a vehicle is that of the Earth, turned, and its own: three hard-iron states
in the body tell the two apart as soon as the vehicle turns. Its strength and its dip are only
judged by: they say whether this is the Earth's field at all.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import observe
from cython.cimports.ekf_companion.core.filter.rotation import rotate, to_dcm
from cython.cimports.ekf_companion.core.filter.update import (
    apply_yaw_update,
    innovate,
    reset_variance,
)
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_HEADING,
    AZIMUTH_ANTENNA,
    AZIMUTH_FIELD,
    AZIMUTH_MAGNETIC,
    AZIMUTH_OTHER,
    CHOICE_AUTO,
    CHOICE_AUTOPILOT,
    CHOICE_GNSS,
    CHOICE_MAG,
    E_ATT,
    E_HEADING,
    E_IRON,
    MODE_ATTITUDE,
    MODE_LEVEL,
    RESET_HEADING,
    VERDICT_BEFORE_ALIGNMENT,
    VERDICT_DISTURBED,
    VERDICT_FUSED,
    VERDICT_SUPERSEDED,
    N,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import HeadingRow, Observation
from cython.cimports.ekf_companion.core.memory.state import Reference, State
from cython.cimports.ekf_companion.core.start import yaw_reset
from cython.cimports.ekf_companion.core.trust import leap
from cython.cimports.ekf_companion.core.trust.gate import (
    begin_reset,
    count_heading,
    follow_share,
    fuse_judged,
    is_timed_out,
    note_used,
)
from cython.cimports.libc.math import asin, fabs, isnan, sqrt

PREFERRED_AGE = cython.declare(cython.double, 5e9)
"""Silence of a better source after which a worse one is used, ns."""
MOUNTING_STD = cython.declare(cython.double, 0.005)
"""Slow error of a dual antenna: how well its baseline is mounted, rad."""
TRUSTED_STD = cython.declare(cython.double, 0.02)
"""Slow error up to which a heading source that has jumped is right, rad."""
DECLINATION_STD = cython.declare(cython.double, 0.2)
"""One sigma of the declination before the first fix, rad: most people live within it."""
AZIMUTH_STD = cython.declare(cython.double, 0.003)
"""White error of a magnetic azimuth beside that of the field, rad."""
INSISTENCE = cython.declare(cython.double, 9e8)
"""Least time that a heading is refused before it resets anything, ns."""
CONVINCING = cython.declare(cython.double, 10.0)
"""Natural fields in a row that a magnetometer needs once it was disturbed."""
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
LEAST_SHARE = cython.declare(cython.double, 0.05)
"""Least share of the configured variance, for the best of magnetometers."""
NEVER = cython.declare(cython.double, -1e18)
UNKNOWN_HEADING = cython.declare(cython.double, 3.29)
"""Variance of an unknown angle: pi^2 / 3, rad^2."""
ANY_YAW = cython.declare(cython.double, 100.0)
"""Variance of an unknown yaw, rad^2."""


def is_heading_used(x: State, k: Parameters, source: int) -> bool:
    """Return whether a heading is used: the configured source, or the best that is not silent."""
    x.heading_t[source] = x.t
    if k.heading == CHOICE_GNSS:
        return source == 0
    if k.heading == CHOICE_MAG:
        return source == 1
    if k.heading == CHOICE_AUTOPILOT:
        return source == 2
    if source > 0 and x.t - x.mag_t < PREFERRED_AGE:
        return False
    for better in range(source):
        if x.t - x.heading_t[better] < PREFERRED_AGE:
            return False
    return True


def is_field_used(x: State, k: Parameters) -> bool:
    """Return whether the magnetic field gives the heading: not while a dual antenna does."""
    if k.heading == CHOICE_AUTO:
        return x.t - x.heading_t[0] >= PREFERRED_AGE
    return k.heading == CHOICE_MAG


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


def fuse_heading(x: State, k: Parameters, o: Observation, r: Reference, values: HeadingRow) -> None:
    """Fuse a heading: white from a dual antenna, slowly wrong from another compass or filter."""
    std = values.std
    if std < k.heading_floor:
        std = k.heading_floor
    r.direction_b[0] = 1.0
    r.direction_b[1] = 0.0
    r.direction_b[2] = 0.0
    r.azimuth = values.heading
    r.noise = 0.0
    if values.source == 0.0:
        r.std = std
        fuse_azimuth(x, k, o, r, MOUNTING_STD, AZIMUTH_ANTENNA)
    else:
        r.std = k.heading_floor
        fuse_azimuth(x, k, o, r, std, AZIMUTH_OTHER)


def fuse_field(x: State, k: Parameters, o: Observation, r: Reference, mag_b: Vector) -> None:
    """Fuse the magnetic field: it points to the declination, as far as that is known."""
    if not is_natural(x, k, o, mag_b):
        count_heading(x, VERDICT_DISTURBED, AZIMUTH_MAGNETIC)
        x.natural_fields = 0.0
        leap.note_disturbed(x)
        return
    # by chance one of many disturbed fields looks like the Earth's
    x.natural_fields += 1.0
    if x.natural_fields < CONVINCING and x.count[AID_HEADING][VERDICT_DISTURBED] > 0.0:
        count_heading(x, VERDICT_DISTURBED, AZIMUTH_MAGNETIC)
        leap.note_disturbed(x)
        return
    x.mag_t = x.t
    for i in range(3):
        r.direction_b[i] = mag_b[i]
    r.std = AZIMUTH_STD
    r.noise = k.mag_noise
    if isnan(x.field.declination):
        r.azimuth = 0.0
        fuse_azimuth(x, k, o, r, DECLINATION_STD, AZIMUTH_MAGNETIC)
    else:
        r.azimuth = x.field.declination
        fuse_azimuth(x, k, o, r, k.mag_std, AZIMUTH_FIELD)


def fuse_azimuth(
    x: State, k: Parameters, o: Observation, r: Reference, slow: float, source: float
) -> None:
    """Fuse a direction's azimuth: keep it while levelling, begin or correct yaw by it.

    Its error is a slow part (one sigma, rad) and a white one, and the direction's own noise.
    Another source has another slow error; a field has the vehicle's own in it.
    """
    r.has_iron = source >= AZIMUTH_MAGNETIC
    if x.mode == MODE_LEVEL or x.needs_reset != 0.0:
        x.heading_std = slow
        x.azimuth = source
        keep_reference(x, r)
        count_heading(x, VERDICT_BEFORE_ALIGNMENT, source)
        return
    slow = yaw_reset.slow_error(x, slow)
    x.heading_std = slow
    if source != x.azimuth:
        x.azimuth = source
        x.heading_offset = 0.0
        x.walk.heading_share = 1.0
        reset_variance(x, E_HEADING, 1, slow * slow)
        leap.forget(x)
    if not observe.azimuth(x, o, r):
        count_heading(x, VERDICT_SUPERSEDED, source)
        return
    learns = cython.declare(cython.bint, r.noise > 0.0 and k.learn_noise != 0.0)
    nis = innovate_field(x, o) if learns else innovate(x, o)
    if x.has_yaw == 0.0:
        reset_yaw(x, o)
        count_heading(x, VERDICT_FUSED, source)
        return
    z = o.z[0]
    if fuse_judged(x, k, o, AID_HEADING, nis, False):
        if r.has_iron != 0.0:
            leap.keep(x, z)
        return
    if r.has_iron != 0.0:
        leap.look(x, k, z)
    if (
        is_timed_out(x, AID_HEADING, k.timeout_heading)
        and x.t - x.refused_t[AID_HEADING] >= INSISTENCE
    ):
        yield_to_azimuth(x, o, slow)


def use_compass(x: State, k: Parameters, compass: float) -> None:
    """Begin with another compass: what was learnt of the one before does not hold of it.

    Whoever chose it has brought its field to that of the one before, so the states go on from
    their values, as uncertain as at first, and yaw stays.
    """
    if compass == x.compass:
        return
    x.compass = compass
    forget_field_noise(x)
    leap.forget(x)
    if x.mode >= MODE_ATTITUDE:
        reset_variance(x, E_IRON, 3, k.iron_std * k.iron_std)
    if x.azimuth >= AZIMUTH_MAGNETIC:
        x.walk.heading_share = 1.0
        reset_variance(x, E_HEADING, 1, x.heading_std * x.heading_std)


def innovate_field(x: State, o: Observation) -> float:
    """Return the NIS of a field's azimuth with the noise that was learnt, and learn from it.

    A magnetometer shows its noise by how far the mean of two seconds is from that of the two
    before. From one reading to the next it would look better than it is: currents and turns make
    errors that last a second.
    """
    learnt = address(x.field_noise)
    stated = o.R[0][0]
    o.R[0][0] = learnt.share * stated
    nis = innovate(x, o)
    if not x.t - learnt.t < NEXT:
        begin_field_block(x)
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
    begin_field_block(x)
    learnt.last = mean
    learnt.has_last = 1.0
    return nis


def begin_field_block(x: State) -> None:
    """Begin a new block of azimuths of the field."""
    learnt = address(x.field_noise)
    learnt.t0 = x.t
    learnt.n = 0.0
    learnt.sum = 0.0
    learnt.own = 0.0


def forget_field_noise(x: State) -> None:
    """Take the magnetometer's noise for what is configured."""
    x.field_noise.share = 1.0
    x.field_noise.memory = FIRST_MEMORY
    x.field_noise.t = NEVER


def keep_reference(x: State, r: Reference) -> None:
    """Keep a direction of known azimuth, to find north by."""
    reference = address(x.alignment.reference)
    reference.is_known = 1.0
    reference.t = x.t
    for i in range(3):
        reference.direction_b[i] = r.direction_b[i]
    reference.std = r.std
    reference.noise = r.noise
    reference.has_iron = r.has_iron
    reference.azimuth = r.azimuth


def yield_to_azimuth(x: State, o: Observation, slow: float) -> None:
    """Resolve an azimuth that has been refused too long: reset yaw, heading offset or both."""
    is_compass = cython.declare(cython.bint, x.has_leapt != 0.0 and not yaw_reset.is_ready(x))
    if is_compass or yaw_reset.agrees(x):
        # the compass has jumped: the gyro saw no turn, or the motion confirms our yaw
        leap.forget(x)
        reset_variance(x, E_HEADING, 1, UNKNOWN_HEADING)
        innovate(x, o)
        apply_yaw_update(x, o)
        note_used(x, AID_HEADING)
        return
    begin_reset(x, RESET_HEADING)
    if slow > TRUSTED_STD:
        # the compass or our yaw has jumped, unknown which: raise the variance of both
        reset_variance(x, E_HEADING, 1, 1.0)
        x.P[E_ATT + 2][E_ATT + 2] += o.z[0] * o.z[0]
        x.redrawn[E_ATT + 2] += 1.0
        innovate(x, o)
        apply_yaw_update(x, o)
        x.moved.yaw += o.dx[E_ATT + 2]
        note_used(x, AID_HEADING)
    else:
        reset_yaw(x, o)


def reset_yaw(x: State, o: Observation) -> None:
    """Set the yaw by an observed azimuth; it shares the slow errors from then on."""
    rotate(x.q_nb, 0.0, 0.0, o.z[0])
    x.moved.yaw += o.z[0]
    o.z[0] = 0.0
    reset_variance(x, E_ATT + 2, 1, ANY_YAW)
    innovate(x, o)
    apply_yaw_update(x, o)
    x.has_yaw = 1.0
    x.used_t[AID_HEADING] = x.t
