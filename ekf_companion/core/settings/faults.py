"""What may begin to be wrong: how large, how often, and where it shows.

Widths and rates are what devices do, all of them in the same units, so that the odds of two faults
can be compared; none is a threshold. Where two sources can say the same, both have the same shapes.
"""

from dataclasses import dataclass

from ekf_companion.core.memory.enums import Fault, Shows, Source


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a kind of fault before it shows."""

    source: Source
    """Whose it is."""
    rows: int
    """Its components."""
    std: float
    """One sigma of each, in its unit."""
    tail: float
    """The same of the tenth that is larger by orders of magnitude; as ``std``: none is."""
    rate: float
    """How often it begins in an hour."""
    every: float
    """Time between two onsets that are told apart, s; 0: each reading is one."""
    shows: Shows


STEP, RAMP = 0.0, 1.0
"""A step of nine sigma between two onsets would fit neither; of a ramp a second more or less is
hardly seen."""
LEVEL, VERTICAL, ALL = Shows.LEVEL, Shows.VERTICAL, Shows.ALL

FAULTS = {
    # of the receiver: m, m/s, m/s^2, a share, s, rad; three steps in ten hours, by reflections
    Fault.POSITION_STEP: Prior(Source.POSITION, 2, 30.0, 1000.0, 0.3, STEP, LEVEL),
    Fault.POSITION_RAMP: Prior(Source.POSITION, 2, 1.0, 10.0, 0.3, RAMP, LEVEL),
    Fault.DRAG: Prior(Source.DRAG, 2, 1.0, 30.0, 0.1, RAMP, LEVEL),
    Fault.DRAG_RAMP: Prior(Source.DRAG, 2, 2.0, 20.0, 0.02, RAMP, LEVEL),
    Fault.VELOCITY_STEP: Prior(Source.VELOCITY, 2, 1.0, 30.0, 0.1, STEP, LEVEL),
    Fault.VELOCITY_SCALE: Prior(Source.VELOCITY, 1, 0.05, 0.05, 0.02, RAMP, ALL),
    Fault.VELOCITY_LAG: Prior(Source.VELOCITY, 1, 0.3, 0.3, 0.02, RAMP, ALL),
    Fault.VELOCITY_TURN: Prior(Source.VELOCITY, 1, 0.1, 0.1, 0.02, RAMP, LEVEL),
    Fault.CLIMB_STEP: Prior(Source.CLIMB, 1, 1.0, 30.0, 0.1, STEP, VERTICAL),
    Fault.HEIGHT_STEP: Prior(Source.HEIGHT, 1, 15.0, 300.0, 0.3, STEP, VERTICAL),
    Fault.HEIGHT_RAMP: Prior(Source.HEIGHT, 1, 0.5, 5.0, 0.3, RAMP, VERTICAL),
    Fault.FALL: Prior(Source.FALL, 1, 1.0, 30.0, 0.1, RAMP, VERTICAL),
    Fault.FALL_RAMP: Prior(Source.FALL, 1, 2.0, 20.0, 0.1, RAMP, VERTICAL),
    # of the barometer: m, m/s, m at 15 m/s, a share
    Fault.BARO_STEP: Prior(Source.BARO, 1, 5.0, 100.0, 0.1, STEP, VERTICAL),
    Fault.BARO_RAMP: Prior(Source.BARO, 1, 0.3, 3.0, 0.3, RAMP, VERTICAL),
    Fault.BARO_SPEED: Prior(Source.BARO, 1, 2.0, 2.0, 0.1, RAMP, VERTICAL),
    Fault.BARO_SCALE: Prior(Source.BARO, 1, 0.05, 0.05, 0.1, RAMP, VERTICAL),
    # of the inertial sensors: m/s^2, rad/s; and of what was integrated of them: rad, rad, m/s
    Fault.ACCEL_STEP: Prior(Source.ACCEL, 3, 0.2, 2.0, 0.1, RAMP, ALL),
    Fault.GYRO_STEP: Prior(Source.GYRO, 3, 0.02, 0.2, 0.05, RAMP, ALL),
    Fault.TILT: Prior(Source.STATE, 2, 0.05, 0.5, 1.0, RAMP, ALL),
    Fault.YAW: Prior(Source.STATE, 1, 0.3, 0.3, 0.02, RAMP, ALL),
    Fault.KICK: Prior(Source.STATE, 3, 0.5, 0.5, 1.0, RAMP, ALL),
    # the tenth of these that has no shape any more: a blow, a gyro that turns by itself
    Fault.STATE_WILD: Prior(Source.STATE, 1, 1.0, 1.0, 0.1, RAMP, ALL),
    # a share of the way that it may have moved meanwhile, and of its speed
    Fault.LED: Prior(Source.STATE, 2, 0.3, 1.0, 1.0, STEP, LEVEL),
    Fault.LED_ON: Prior(Source.STATE, 4, 0.3, 1.0, 1.0, STEP, LEVEL),
    # of the heading: gauss, gauss, rad
    Fault.FIELD: Prior(Source.COMPASS, 2, 0.1, 1.0, 0.3, STEP, LEVEL),
    Fault.BODY_FIELD: Prior(Source.COMPASS, 3, 0.1, 1.0, 0.1, STEP, LEVEL),
    Fault.HEADING_STEP: Prior(Source.HEADING, 1, 0.3, 3.0, 0.3, STEP, LEVEL),
    # of the installation: s (and one, times what the delay it is about adds), m
    Fault.DELAY: Prior(Source.DELAY, 2, 0.15, 0.15, 0.1, RAMP, ALL),
    Fault.LEVER: Prior(Source.LEVER, 3, 0.5, 0.5, 0.1, RAMP, ALL),
    # of a receiver that has just begun, m: it may settle in 5, 20 or 60 s, one of ten does by more
    # than it states; its rate is that by the second of its only onset
    Fault.SETTLE: Prior(Source.SETTLING, 2, 10.0, 100.0, 120.0, RAMP, LEVEL),
    Fault.SETTLE_HEIGHT: Prior(Source.SETTLING_HEIGHT, 1, 15.0, 150.0, 120.0, RAMP, VERTICAL),
    # of what was declared, a share: its end, once a minute: all at once, that a slide stops, or
    # that the receiver settles again; the logarithm of its time constant
    Fault.RECOVERY: Prior(Source.POSITION, 1, 0.02, 0.02, 60.0, RAMP, LEVEL),
    Fault.RECOVERY_HEIGHT: Prior(Source.HEIGHT, 1, 0.02, 0.02, 60.0, RAMP, VERTICAL),
    Fault.HALT: Prior(Source.POSITION, 1, 0.02, 0.02, 60.0, RAMP, LEVEL),
    Fault.HALT_HEIGHT: Prior(Source.HEIGHT, 1, 0.02, 0.02, 60.0, RAMP, VERTICAL),
    Fault.HALT_BARO: Prior(Source.BARO, 1, 0.02, 0.02, 60.0, RAMP, VERTICAL),
    Fault.FADE: Prior(Source.POSITION, 2, 0.02, 0.02, 60.0, RAMP, LEVEL),
    Fault.FADE_HEIGHT: Prior(Source.HEIGHT, 2, 0.02, 0.02, 60.0, RAMP, VERTICAL),
    # the same of a heading: of one that was off from the first one on, as an autopilot's before it
    # aligns in flight, and of one that was declared; the logarithm of the rate at which that fades
    Fault.RECOVERY_HEADING: Prior(Source.HEADING, 2, 0.3, 3.0, 60.0, STEP, LEVEL),
    # our yaw is off by any angle since the first heading, 1: of a circle about "by half a turn" in
    # these two; one start of a thousand, by a compass that is mounted the wrong way or beside iron
    Fault.ALIGNMENT: Prior(Source.HEADING, 2, 0.7071, 0.7071, 0.0, STEP, LEVEL),
    # what has no shape: a receiver among houses, a port in the wind; it has no size. As rare as an
    # offset of a velocity: of 32 flights of erratic and jumping receivers (seeds 113, 115 to 117 of
    # make truth) 12 s are OK and wrong, at a third of the rate 13 s, at three times 26 s
    Fault.POSITION_WILD: Prior(Source.POSITION, 1, 1.0, 1.0, 0.1, RAMP, LEVEL),
    Fault.RECEIVER_WILD: Prior(Source.DRAG, 1, 1.0, 1.0, 0.1, RAMP, LEVEL),
    Fault.VELOCITY_WILD: Prior(Source.VELOCITY, 1, 1.0, 1.0, 0.1, RAMP, LEVEL),
    Fault.CLIMB_WILD: Prior(Source.CLIMB, 1, 1.0, 1.0, 0.1, RAMP, VERTICAL),
    Fault.HEIGHT_WILD: Prior(Source.HEIGHT, 1, 1.0, 1.0, 0.1, RAMP, VERTICAL),
    Fault.FALL_WILD: Prior(Source.FALL, 1, 1.0, 1.0, 0.1, RAMP, VERTICAL),
    Fault.BARO_WILD: Prior(Source.BARO, 1, 1.0, 1.0, 0.1, RAMP, VERTICAL),
    # a vibration that begins: velocity, m/s, and attitude, rad, walk by so much in a second, as by
    # the larger steps of these sensors; as rare as a receiver that is wrong in no shape
    Fault.ACCEL_LOUD: Prior(Source.NOISE, 3, 2.0, 2.0, 0.1, RAMP, ALL),
    Fault.GYRO_LOUD: Prior(Source.NOISE, 3, 0.2, 0.2, 0.1, RAMP, ALL),
    # no fault: its share of the noise follows from what a second of it does
    Fault.ACCEL_NOISE: Prior(Source.NOISE, 3, 1.0, 1.0, 0.0, RAMP, ALL),
    Fault.GYRO_NOISE: Prior(Source.NOISE, 3, 1.0, 1.0, 0.0, RAMP, ALL),
}
