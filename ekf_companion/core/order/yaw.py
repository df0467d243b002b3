"""Heading: which source is used, and how it corrects yaw.

The magnetic field of a vehicle is that of the Earth, turned, and its own: three hard-iron states
in the body tell the two apart as soon as the vehicle turns.
"""

from __future__ import annotations

import cython
from cython import address
from cython.cimports.ekf_companion.core.aids import heading
from cython.cimports.ekf_companion.core.filter.slow_error import add_variance, reset_variance
from cython.cimports.ekf_companion.core.filter.update import apply_yaw_update, innovate
from cython.cimports.ekf_companion.core.memory.constants import UNKNOWN_ANGLE
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
    WEIGH_ACT,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import HeadingRow, Observation
from cython.cimports.ekf_companion.core.memory.state import Reference, State
from cython.cimports.ekf_companion.core.start import yaw_reset
from cython.cimports.ekf_companion.core.trust import leap, magnetic_field
from cython.cimports.ekf_companion.core.trust.gate import (
    begin_reset,
    count_heading,
    fuse_judged,
    is_timed_out,
    note_used,
)
from cython.cimports.libc.math import isnan

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
    if not magnetic_field.is_natural(x, k, o, mag_b):
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
    if not heading.azimuth(x, o, r):
        count_heading(x, VERDICT_SUPERSEDED, source)
        return
    learns = cython.declare(cython.bint, r.noise > 0.0 and k.learn_noise != 0.0)
    if learns and k.weighs_faults == WEIGH_ACT:
        magnetic_field.compare(x, o)
    nis = magnetic_field.innovate_azimuth(x, o) if learns else innovate(x, o)
    if x.has_yaw == 0.0:
        yaw_reset.reset_yaw(x, o)
        count_heading(x, VERDICT_FUSED, source)
        return
    z = o.z[0]
    if fuse_judged(x, k, o, AID_HEADING, nis, False):
        if r.has_iron != 0.0:
            leap.keep(x, z)
        return
    if k.weighs_faults == WEIGH_ACT:
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
    magnetic_field.forget_noise(x)
    leap.forget(x)
    if x.mode >= MODE_ATTITUDE:
        reset_variance(x, E_IRON, 3, k.iron_std * k.iron_std)
    if x.azimuth >= AZIMUTH_MAGNETIC:
        x.walk.heading_share = 1.0
        reset_variance(x, E_HEADING, 1, x.heading_std * x.heading_std)


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
        reset_variance(x, E_HEADING, 1, UNKNOWN_ANGLE)
        innovate(x, o)
        apply_yaw_update(x, o)
        note_used(x, AID_HEADING)
        return
    begin_reset(x, RESET_HEADING)
    if slow > TRUSTED_STD:
        # the compass or our yaw has jumped, unknown which: raise the variance of both
        reset_variance(x, E_HEADING, 1, 1.0)
        add_variance(x, E_ATT + 2, o.z[0] * o.z[0])
        x.redrawn[E_ATT + 2] += 1.0
        x.copied[E_ATT + 2] = -1.0
        innovate(x, o)
        apply_yaw_update(x, o)
        x.moved.yaw += o.dx[E_ATT + 2]
        note_used(x, AID_HEADING)
    else:
        yaw_reset.reset_yaw(x, o)
