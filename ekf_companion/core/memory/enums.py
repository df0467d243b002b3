"""Numbers that the kernel's modules share: what is enumerated, and where each error state lies.

``setup.py`` makes ``enums.pxd`` from it, where a member is ``PREFIX_MEMBER``: ``MODE_LEVEL``.
"""

from enum import IntEnum, IntFlag
from typing import Any

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.declare import enum_member
from ekf_companion.nav.measurements import GnssFlag, Kind, VehicleType
from ekf_companion.nav.state import Reason, Status

_OTHERS = {
    one.name.upper(): 6 + i
    for i, one in enumerate(one for one in DECLARED if one.kind is not Kind.BARO)
}
"""Numbers of the aids that only their own files name."""


def _add_others(members: dict[str, Any]) -> None:
    for name, number in _OTHERS.items():
        members[name] = number  # its own update makes no members before Python 3.11


class Aid(IntEnum):
    """What corrects the inertial solution."""

    POSITION = 0
    HEIGHT = 1
    VELOCITY = 2
    HEADING = 3
    BARO = 4
    REST = 5
    """Standing still."""
    _add_others(vars())


class Verdict(IntEnum):
    """What became of a measurement of an aid when the filter processed it."""

    FUSED = 0
    GATED = 1
    BEFORE_ALIGNMENT = 2
    SUPERSEDED = 3
    """A better source is in use, or the configuration excludes it."""
    DEWEIGHTED = 4
    """Fused with less weight: between the soft and the hard gate."""
    SUSPECT = 5
    """The receiver itself reports jamming or spoofing."""
    DISTURBED = 6
    """A magnetic field that is not the Earth's."""
    DENIED = 7
    """Within its gate, and contradicted by other evidence: the receiver's own motion, the specific
    force, or the mean of its last innovations."""


class Arrival(IntEnum):
    """What became of a measurement on its arrival."""

    TAKEN = 0
    STALE = 1
    """Older than the window."""
    DUPLICATE = 2
    MALFORMED = 3
    """A value that no sensor can have."""
    RESTARTED = 4
    ESTIMATED = 5
    """The newest inertial sample: there is an estimate for its stamp."""
    HELD = 6
    """An inertial sample whose stamp leaps ahead, until others go on from it."""
    STRAY = 7
    """An inertial sample whose stamp has leapt ahead alone: not used."""


class Mode(IntEnum):
    """What the filter is doing."""

    INIT = 0
    LEVEL = 1
    """Levelling and finding north."""
    ATTITUDE = 2
    """It has an attitude, and no position yet."""
    NAVIGATE = 3


class NeedsReset(IntEnum):
    """What a long inertial gap leaves to be done."""

    NOTHING = 0
    FIX = 1
    """No fix has come since."""
    TILT = 2
    """Fixes have come again, but have not shown the attitude yet."""


class HeadingChoice(IntEnum):
    """Heading sources that the configuration allows."""

    AUTO = 0
    GNSS = 1
    MAG = 2
    AUTOPILOT = 3


class Azimuth(IntEnum):
    """Where the azimuth in use comes from; 0: from nowhere yet."""

    ANTENNA = 1
    """Two antennas of a receiver."""
    OTHER = 2
    """Another estimate."""
    MAGNETIC = 3
    """The magnetic field, before its declination is known."""
    FIELD = 4
    """The magnetic field, and its declination."""


class Voice(IntEnum):
    """Who contradicts the others about the climb."""

    NONE = 0
    HEIGHT = 1
    """The receiver's height."""
    VELOCITY = 2
    """Its vertical velocity."""
    BARO = 3
    ANY = 4
    """They disagree, and no two agree against a third."""


class Fault(IntEnum):
    """What may have begun to be wrong; ``settings/faults.py`` has the numbers of each.

    Those that a fix, the barometer or a compass is the first to show stand together.
    """

    POSITION_STEP = 0
    """The receiver's position is off."""
    POSITION_RAMP = 1
    """It slides."""
    DRAG = 2
    """Position and velocity are led away together."""
    DRAG_RAMP = 3
    """The same, ever faster."""
    VELOCITY_STEP = 4
    """The receiver's horizontal velocity is off."""
    VELOCITY_SCALE = 5
    """All of its velocity is too long, or too short."""
    VELOCITY_LAG = 6
    """It lags behind the position."""
    VELOCITY_TURN = 7
    """It is turned about the vertical."""
    CLIMB_STEP = 8
    """Its vertical velocity is off."""
    HEIGHT_STEP = 9
    HEIGHT_RAMP = 10
    FALL = 11
    """Height and vertical velocity are led away together."""
    FALL_RAMP = 12
    """The same, ever faster."""
    BARO_STEP = 13
    BARO_RAMP = 14
    BARO_SPEED = 15
    """Dynamic pressure: by the square of the speed."""
    BARO_SCALE = 16
    """By the height, from where that was when it began."""
    BARO_WILD = 17
    """It is wrong in no shape."""
    ACCEL_STEP = 18
    """The accelerometer's bias has changed."""
    GYRO_STEP = 19
    TILT = 20
    """Our roll and pitch are off."""
    YAW = 21
    KICK = 22
    """Our velocity is off: a shock beyond what the samples show."""
    STATE_WILD = 23
    """Our attitude, velocity and position are wrong in no shape."""
    FIELD = 24
    """A magnetic field beside the Earth's, fixed in n."""
    BODY_FIELD = 25
    """The same, fixed in the vehicle."""
    HEADING_STEP = 26
    """A heading of another source is off."""
    DELAY = 27
    """The fixes are later than they are taken for."""
    LEVER = 28
    """The antenna is elsewhere."""
    RECOVERY = 29
    """Position and horizontal velocity are right again: what was declared of them has ended."""
    RECOVERY_HEIGHT = 30
    """Height and vertical velocity are."""
    HALT = 31
    """A declared slide of the position has ended where it was."""
    HALT_HEIGHT = 32
    HALT_BARO = 33
    FADE = 34
    """What was declared of the position fades, as a receiver settles again."""
    FADE_HEIGHT = 35
    POSITION_WILD = 36
    """It is wrong in no shape: no reading says anything of the next one."""
    RECEIVER_WILD = 37
    """Position and horizontal velocity are."""
    VELOCITY_WILD = 38
    CLIMB_WILD = 39
    HEIGHT_WILD = 40
    FALL_WILD = 41
    """Height and vertical velocity are."""
    SETTLE = 42
    """The position settles after the first fix, from which ours began."""
    SETTLE_HEIGHT = 43
    LED = 44
    """Our position was led away while no receiver could contradict that."""
    LED_ON = 45
    """It was, and our velocity still is."""
    RECOVERY_HEADING = 46
    """A heading is right that was off from the first one on; or what was declared of it fades."""
    ALIGNMENT = 47
    """Our yaw is off since the first heading, by any angle: its cosine less one, and its sine."""
    ACCEL_LOUD = 48
    """What an accelerometer whose noise has leapt has done to the velocity."""
    GYRO_LOUD = 49
    """What such a gyro has done to the attitude."""
    ACCEL_NOISE = 50
    """No fault: what the accelerometer's noise does in a second, by which it is learnt."""
    GYRO_NOISE = 51


class Source(IntEnum):
    """Whose fault it is: what has the same consequence is declared together."""

    POSITION = 0
    DRAG = 1
    """Never declared: no other source can ever contradict it, nor confirm it."""
    VELOCITY = 2
    CLIMB = 3
    HEIGHT = 4
    BARO = 5
    ACCEL = 6
    GYRO = 7
    STATE = 8
    """What was integrated, before."""
    COMPASS = 9
    HEADING = 10
    DELAY = 11
    LEVER = 12
    FALL = 13
    SETTLING = 14
    SETTLING_HEIGHT = 15
    NOISE = 16


class Weigh(IntEnum):
    """What the fault hypotheses are for."""

    OFF = 0
    REPORT = 1
    """They tell what they find, and change nothing."""
    ACT = 2
    """They decide."""


class Shows(IntEnum):
    """In which rows a fault shows: what is level and what is vertical can fail apart."""

    ALL = 0
    LEVEL = 1
    VERTICAL = 2


class Reset(IntEnum):
    """Why the state jumped."""

    NONE = 0
    POSITION = 1
    VELOCITY = 2
    HEIGHT = 3
    HEADING = 4
    GAP = 5
    CLOCK = 6
    BOUNDS = 7
    MOTION = 8
    """The heading contradicted the motion."""
    RESTART = 9
    ORIGIN = 10
    """The receiver's first fix is far from the autopilot's own position: a new origin."""


class Link(IntEnum):
    """How a record of the tape follows from the one before."""

    SAME = 0
    """Whatever was measured in between, it is the same error of the same true state."""
    MOVED = 1
    """By the transition that the record holds, and noise."""
    FRESH = 2
    """The same, but some error states were drawn anew meanwhile."""
    CUT = 3
    """It does not follow: a new stretch begins."""


ENUMS: dict[str, type[IntEnum] | type[IntFlag]] = {
    "KIND": Kind,
    "FLAG": GnssFlag,
    "VEHICLE": VehicleType,
    "STATUS": Status,
    "REASON": Reason,
    "ARRIVAL": Arrival,
    "MODE": Mode,
    "AID": Aid,
    "VERDICT": Verdict,
    "NEEDS": NeedsReset,
    "CHOICE": HeadingChoice,
    "AZIMUTH": Azimuth,
    "RESET": Reset,
    "LINK": Link,
    "VOICE": Voice,
    "FAULT": Fault,
    "SHOWS": Shows,
    "WEIGH": Weigh,
    "SOURCE": Source,
}
"""Enumerations that the kernel knows, by the prefix of their members: ``MODE_LEVEL``."""


def __getattr__(name: str) -> int:
    """Return a member of an enumeration as the compiled kernel has it: a plain number."""
    return enum_member(ENUMS, __name__, name)


# Where each error state begins, in this order in the covariance
E_ATT = 0
"""Attitude: a rotation vector in n."""
E_VEL = 3
E_POS = 6
E_BG = 9
"""Gyro bias."""
E_BA = 12
"""Accelerometer bias."""
E_BARO = 15
"""Offset of the barometer."""
E_DELAY = 16
"""How much later than its stamp a fix is."""
E_HEADING = 17
"""Slow error of the heading in use."""
E_GNSS = 18
"""Slow error of the receiver's position, in n."""
E_IRON = 21
"""Hard iron: the vehicle's own magnetic field, in b."""
E_GNSS_VEL = 24
"""Slow error of the receiver's velocity, in n."""
CORE = 27
"""Error states that are there without any aid that only its own file names."""
N = CORE
SLOW_ERRORS = {"baro": E_BARO}
"""Where the slow errors of each aid begin; of those that only their own files name, at the end."""
MOST_SLOW_ERRORS = max((len(_one.slow_errors) for _one in DECLARED), default=1)
for _one in DECLARED:
    if _one.slow_errors and _one.name not in SLOW_ERRORS:
        SLOW_ERRORS[_one.name] = N
        globals()[f"E_{_one.name.upper()}"] = N
        N += len(_one.slow_errors)

AIDS = len(Aid)
FAULTS = len(Fault)
SOURCES = len(Source)
VERDICTS = len(Verdict)
HEADINGS = 3
"""Kinds of sensor of a heading: two antennas, another estimate, a compass; an :class:`Azimuth` less
one, both of the magnetic field as one."""
RUNS = 3
"""Aids whose refused innovations are tested for consistency: position, height, velocity."""
PAST = 64
"""Velocities that are kept, 35 ms apart: of two seconds, as a fix may be late."""
YAW_FILTERS = 8
YAW_N = 9
"""States of one yaw filter: velocity (2), yaw, tilt (2), gyro bias (3), delay."""
