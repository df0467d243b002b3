"""The filter's state: all that it estimates, and all that its decisions depend on.

One block of doubles without a gap, so that a snapshot is one copy and a checkpoint one write; the
order of the fields is that of the checkpoints. ``setup.py`` makes ``state.pxd`` from it.

Times are nanoseconds since the timeline's epoch, whole numbers, exact in a double for 104 days.
Flags are 0 or 1. What is not known is NaN.
"""

from typing import Annotated

from ekf_companion.core.memory.aid import DECLARED
from ekf_companion.core.memory.declare import Real, Structs, Vector, doubles, struct
from ekf_companion.core.memory.enums import (
    AIDS,
    E_GNSS_VEL,
    HEADINGS,
    PAST,
    RUNS,
    SLOW_ERRORS,
    VERDICTS,
    YAW_FILTERS,
    YAW_N,
    N,
)


@struct
class Origin:
    """Origin of the local frame."""

    lat: Real
    """rad."""
    lon: Real
    """rad."""
    alt: Real
    """Above mean sea level, m."""
    scale_n: Real
    """Metres north per radian of latitude."""
    scale_e: Real
    """Metres east per radian of longitude."""
    is_known: Real


@struct
class Field:
    """The Earth's magnetic field at the last fix, by the World Magnetic Model."""

    declination: Real
    """rad, east positive."""
    inclination: Real
    """rad, down positive."""
    strength: Real
    """gauss."""


@struct
class Moved:
    """What the last reset moved."""

    pos_n: Annotated[Vector, 3]
    vel_n: Annotated[Vector, 3]
    yaw: Real


@struct
class Pending:
    """The motion since P was carried on."""

    dt: Real
    """Its time, s."""
    dv_n: Annotated[Vector, 3]
    """Velocity increment of the force, m/s."""
    C_nb_dt: Annotated[Vector, 3, 3]
    """Integral of C_nb, s."""


@struct
class NoiseBlock:
    """Means over blocks of inertial samples, from whose second differences noise is learnt."""

    sum: Annotated[Vector, 6]
    """Of the block that is being filled: rate, specific force."""
    n: Real
    dt: Real
    """Its length, s."""
    blocks: Real
    """Full ones in a row."""
    last: Annotated[Vector, 6]
    """Mean of the last full block."""
    before: Annotated[Vector, 6]
    """Mean of the one before that."""


@struct
class Run:
    """A run of refused innovations: the sums that a straight line through them needs."""

    n: Real
    t0: Real
    """Time of the first, ns."""
    t: Real
    """Sum of the times since then, s."""
    tt: Real
    """Sum of their squares."""
    z: Annotated[Vector, 3]
    """Sum of the innovations."""
    tz: Annotated[Vector, 3]
    """Sum of the innovations times their times."""
    zz: Real
    """Sum of the squares of the innovations."""


@struct
class Drag:
    """Drag across a multirotor's axis: what the sideways force tells of the velocity."""

    t0: Real
    """Begin of the block of samples, ns."""
    n: Real
    force: Annotated[Vector, 3]
    """Sum of the specific forces, m/s^2."""
    theta: Annotated[Vector, 3]
    """Coefficient (1/s); coefficient times wind, north and east (m/s^2)."""
    P: Annotated[Vector, 3, 3]
    variance: Real
    """Of what the model leaves of the force, m^2/s^4."""


@struct
class FieldNoise:
    """Noise of the magnetometer, as its azimuths show it."""

    share: Real
    """Of the configured variance."""
    memory: Real
    """Blocks of azimuths that it was learnt from, and what the configured one counts for."""
    t0: Real
    """Begin of the block, ns."""
    t: Real
    """Last azimuth, ns."""
    n: Real
    """Azimuths in the block."""
    sum: Real
    """Of their innovations, rad."""
    own: Real
    """Of the filter's own variance of them, rad^2."""
    last: Real
    """Mean innovation of the block before, rad."""
    has_last: Real
    """There is one."""
    z: Real
    """Innovation of the last azimuth, rad."""
    white: Real
    """Share that azimuths differ by from one to the next, with ``weigh_faults: act``."""
    looks: Real
    """How many of these that is from; 0: it is not learnt so."""


@struct
class Walk:
    """How slow errors were corrected since a stretch began: of gyro, heading and barometer."""

    dt: Real
    """Its time so far, s."""
    bias: Annotated[Vector, 3]
    """The gyro's at its begin, rad/s."""
    var: Annotated[Vector, 3]
    """Their variances then."""
    added: Annotated[Vector, 3]
    """What their walk has added since."""
    last: Annotated[Vector, 3]
    """Sum of their corrections in the stretch before, sigmas."""
    slow_dt: Real
    """Time since the stretch of heading and barometer began, s."""
    offset: Real
    """The heading's slow error at its begin, faded since, rad."""
    offset_var: Real
    """Its variance then, faded since."""
    offset_added: Real
    """What was added to that since."""
    drift: Real
    """How many times larger the variance of the gyro's walk is than the doubt makes it."""
    heading_share: Real
    """Share of the configured rate at which the heading's slow error changes."""
    baro: Real
    """The barometer's offset at its begin, m."""
    baro_var: Real
    """Its variance then."""
    baro_added: Real
    """What its walk has added since."""
    speed_added: Real
    """Of that, what the speed has added."""
    least_speed: Real
    largest_speed: Real
    """Of the stretch, squares, (m/s)^2."""
    redrawn: Real
    """How often the barometer's offset had been given a new variance."""
    speed_share: Real
    """Share of the configured walk of the barometer by speed, variances."""


@struct
class Voices:
    """What receiver and barometer say of the climb, and who contradicts the others."""

    t: Real
    """Of the last fix, ns."""
    height: Real
    """Its altitude, m."""
    down: Real
    """Its vertical velocity, m/s."""
    has_vel: Real
    baro: Real
    """Mean pressure altitude before the last fix that it was heard before, m."""
    baro_t: Real
    """Of that fix, ns."""
    by_height: Real
    """Climb since that fix by the receiver's height, m."""
    by_velocity: Real
    """The same by its vertical velocity; NaN: not known."""
    baro_sum: Real
    """Since the last fix, m."""
    baro_n: Real
    difference: Annotated[Vector, 3]
    """Of the climbs lately: height less velocity, baro less height, baro less velocity, m."""
    smooth: Annotated[Vector, 3]
    """The same without a height's noise, m."""
    apart_t: Real
    """Until when height and velocity were apart, ns."""
    rush: Real
    """Climb over the last second, barometer less velocity, m."""
    is_rushing: Real
    """The receiver's vertical velocity is contradicted by barometer and inertial samples."""
    loser: Real
    """:class:`Voice`."""


@struct
class Slide:
    """How far the positions that are fused slide off from the receiver's own velocity, n e."""

    t: Real
    """Of the last position that was fused, ns."""
    pos: Annotated[Vector, 2]
    """That position, m."""
    way: Annotated[Vector, 2]
    """Integral of the receiver's velocity since, m; NaN: not known."""
    jump: Annotated[Vector, 2]
    """What the first position that was refused since had moved beside that, m."""
    led: Annotated[Vector, 2]
    """What the estimate was led by over half a minute, beside the velocity's integral, m."""
    smooth: Annotated[Vector, 2]
    """The same without a position's noise, m."""
    begin_t: Real
    """Since when position and velocity are compared, ns."""
    onset_t: Real
    """Since when they contradict each other, ns."""
    apart_t: Real
    """Until when they were apart, ns."""
    is_sliding: Real
    """They contradict each other."""


@struct
class RestWindow:
    """Sums over a window of inertial samples: was the vehicle at rest?"""

    t0: Real
    """Its begin, ns."""
    n: Real
    gyro: Annotated[Vector, 3]
    """Sum of the rates, rad/s."""
    accel: Annotated[Vector, 3]
    """Sum of the specific forces, m/s^2."""
    gyro2: Annotated[Vector, 3]
    """Sum of the squares of the rates."""
    accel2: Annotated[Vector, 3]
    """Sum of the squares of the specific forces."""
    gyro_t: Annotated[Vector, 3]
    """Sum of the rates times the time since t0, rad."""
    accel_t: Annotated[Vector, 3]
    """Likewise of the specific forces, m/s."""
    t1: Real
    """Sum of these times, s."""
    t2: Real
    """Sum of their squares, s^2."""
    vel_n: Annotated[Vector, 3]
    """Sum of the receiver's velocities, m/s."""
    vel_var: Real
    """Sum of their white variances, (m/s)^2."""
    vel_count: Real
    mag_b: Annotated[Vector, 3]
    """Sum of the magnetic fields, gauss."""
    mag_n: Real


@struct
class Stillness:
    """Consecutive windows of rest: does the magnetic field turn in the body?"""

    t0: Real
    """Middle of the first window, ns; 0: there is none."""
    mag_b: Annotated[Vector, 3]
    """Mean field of the first window, gauss."""
    turn: Real
    """Integral since then of the rate about the vertical, by the gyro, rad."""


@struct
class MotionWindow:
    """The motion since a fix, to level by: the specific force in a frame that the gyro holds."""

    q: Annotated[Vector, 4]
    """From b to that frame."""
    dv: Annotated[Vector, 3]
    """Integral of the specific force in it, m/s."""
    has_fix: Real
    fix_t: Real
    """ns."""
    fix_vel: Annotated[Vector, 3]
    """Velocity of the antenna then, n e d, m/s."""
    fix_std: Real
    """One sigma per axis, m/s."""
    force: Annotated[Vector, 3]
    """Specific force then, m/s^2."""


@struct
class Reference:
    """A direction of the body whose azimuth is known, to find north by."""

    is_known: Real
    t: Real
    """ns."""
    direction_b: Annotated[Vector, 3]
    """The forward axis, or the magnetic field in gauss."""
    std: Real
    """White error of its azimuth, one sigma, rad."""
    noise: Real
    """White noise of the direction itself, in its units."""
    has_iron: Real
    """It is a magnetic field, with the vehicle's own in it."""
    azimuth: Real
    """In n, rad."""


@struct
class Alignment:
    """Sums for the initial alignment."""

    rest: RestWindow
    still: Stillness
    motion: MotionWindow
    reference: Reference
    start_t: Real
    """When levelling began, ns."""


@struct
class YawFilter:
    """One filter of the bank: a hypothesis of the yaw of the bank's frame s."""

    weight: Real
    """Probability of its being the right one."""
    x: Annotated[Vector, YAW_N]
    """Velocity north, east (m/s); yaw of s (rad); tilt of s about x, y (rad); gyro bias (rad/s);
    delay of the receiver (s)."""
    P: Annotated[Vector, YAW_N, YAW_N]


@struct
class YawSums:
    """What the bank has summed in its frame s since the last fix."""

    dv: Annotated[Vector, 3]
    """Integral of the specific force, m/s."""
    turn: Annotated[Vector, 3, 3]
    """Integral of C_sb, s: what a gyro bias does to s."""
    dt: Real
    """s."""


@struct
class YawBank:
    """A bank of yaw filters, with an attitude of its own, independent of the main filter."""

    is_running: Real
    """0: it still levels its frame."""
    q_sb: Annotated[Vector, 4]
    """From b to the frame s: nearly level, pointing anywhere."""
    gyro_bias: Annotated[Vector, 3]
    gyro_bias_std: Real
    sums: YawSums
    accel: Annotated[Vector, 2]
    """Horizontal acceleration in s, smoothed, m/s^2: corrects for the delay of a fix."""
    vel_var: Real
    """Learnt variance of the receiver's velocity, (m/s)^2."""
    refused: Real
    """Fixes refused less fixes believed."""
    vel_mean: Annotated[Vector, 2]
    """Mean velocity of the last seconds, n e, m/s."""
    has_moved: Real
    """The velocity has changed by enough to show a heading."""
    yaw: Real
    """Of s against north, rad."""
    yaw_std: Real
    tilt_std: Real
    good: Real
    """Consecutive fixes with a narrow yaw."""
    nis: Real
    """Recent mean of the main filter's velocity NIS, per degree of freedom."""
    failing_t: Real
    """Since when that has been too large, ns."""
    repairs: Real
    """How often the main filter's yaw was reset by the bank."""
    repair_t: Real
    """When it was last, ns."""
    filter: Annotated[Structs, YawFilter, YAW_FILTERS]


@struct
class Past:
    """The velocity that the samples have gained, now and over the last two seconds."""

    gained: Annotated[Vector, 3]
    """Until now, in n, m/s."""
    kept: Annotated[Vector, PAST, 3]
    """Until some earlier times."""
    kept_t: Annotated[Vector, PAST]
    """Those times, ns."""


@struct
class GainEnd:
    """A fix at which a gain of velocity begins or ends."""

    t: Real
    """ns; never: there is none."""
    delay: Real
    """What was known of it by then, s."""
    vel_n: Annotated[Vector, 2]
    """Its velocity, m/s."""
    until: Annotated[Vector, 2]
    """What the samples had gained when it was true, m/s."""
    turn: Annotated[Vector, 2, 3]
    """What velocity a lever arm had, n e by b, 1/s."""
    accel_n: Annotated[Vector, 2]
    """Acceleration when it was true, m/s^2."""


@struct
class Gain:
    """The gain of velocity between two fixes, by which their delay is learnt."""

    begin: GainEnd
    end: GainEnd
    var: Real
    """Learnt variance of the receiver's gain less that of the samples, an axis, (m/s)^2."""
    n: Real
    """Gains that it was learnt from, two a pair of fixes."""
    change: Real
    """Mean square of the change of acceleration over the last gains, an axis, (m/s^2)^2."""
    shown: Real
    """Sum of the squares of how they depend on the delay, (m/s^2)^2."""


@struct
class Lag:
    """How much later the velocity of a fix is true than its position, and the gain that goes on."""

    late: Real
    """s."""
    t: Real
    """At which the gain has begun, ns."""
    pos: Annotated[Vector, 2]
    """North and east of the antenna by the fix then, m."""
    vel: Annotated[Vector, 2]
    """Its velocity, m/s."""
    way: Annotated[Vector, 2]
    """What the velocities have added up to since, m."""
    last_t: Real
    """Of the last fix, ns; never: there is none."""
    last_vel: Annotated[Vector, 2]
    changed2: Real
    """Sum of the squares of what the velocity gained, (m/s)^2."""
    changed4: Real
    """Of their squares, (m/s)^4."""
    product: Real
    """Of what the velocity and what the position gained beyond it, m^2/s."""
    left2: Real
    """Of the squares of what is left, each times that of the velocity, m^4/s^2."""


@struct
class Lever:
    """What fixes in turns have shown of the lever arm beside the one that is configured."""

    arm_b: Annotated[Vector, 3]
    """Of its configured sigma."""
    P: Annotated[Vector, 3, 3]
    """Its covariance, of the configured variance."""
    change: Real
    """Mean square of the change of rate over the last gains of velocity, all axes, (rad/s)^2."""


class Estimates:
    """What is estimated.

    From ``vel_n`` on the errors are differences, in their order in P: :func:`~.overlay.errors`.
    """

    q_nb: Annotated[Vector, 4]
    vel_n: Annotated[Vector, 3]
    """m/s."""
    pos_n: Annotated[Vector, 3]
    """From the origin, m."""
    gyro_bias: Annotated[Vector, 3]
    """rad/s."""
    accel_bias: Annotated[Vector, 3]
    """m/s^2."""
    baro_offset: Real
    """Pressure altitude less altitude, m."""
    gnss_delay: Real
    """How much later than the configured delay a fix is, s."""
    heading_offset: Real
    """Slow error of the heading in use, rad."""
    gnss_offset: Annotated[Vector, 3]
    """Slow error of the receiver's position, n e d, m."""
    hard_iron: Annotated[Vector, 3]
    """The vehicle's own magnetic field, b, gauss."""
    gnss_vel_offset: Annotated[Vector, 3]
    """Slow error of the receiver's velocity, in n, m/s."""


AidErrors = type(
    "AidErrors",
    (),
    {
        "__annotations__": {
            f"{one.name}_{error}": Real
            for one in DECLARED
            for error in one.slow_errors
            if SLOW_ERRORS[one.name] > E_GNSS_VEL
        }
    },
)
"""Slow errors of the aids that only their own files name: ``aid_error``, in its unit."""


AidKept = type(
    "AidKept",
    (),
    {
        "__annotations__": {
            f"{one.name}_{name}": Real if kept.size == 1 else Annotated[Vector, kept.size]
            for one in DECLARED
            for name, kept in one.kept.items()
        }
    },
)
"""What the aids keep beside their slow errors: ``aid_name``."""


class Learnt:
    """What belongs to the estimates: their covariance, and what they were learnt from."""

    P: Annotated[Vector, N, N]
    """Covariance of the error states, in the order of the estimates."""
    pending: Pending
    gyro: Annotated[Vector, 3]
    """Of the last inertial sample, rad/s."""
    accel: Annotated[Vector, 3]
    """Of the last inertial sample, m/s^2."""
    accel_n: Annotated[Vector, 3]
    """Acceleration in n, smoothed over some samples, m/s^2."""
    dt: Real
    """Usual interval between inertial samples, s."""
    noise: Annotated[Vector, 6]
    """Learnt white noise of rate and force, variance times interval: (rad/s)^2 s, (m/s^2)^2 s."""
    white_share: Annotated[Vector, RUNS]
    """Learnt share of the receiver's stated variances that is white, by aid."""
    begun: Real
    """Error states of aids that are carried beyond the first CORE: of those that have begun."""
    has_yaw: Real
    has_aid: Annotated[Vector, AIDS]
    """Whether the slow errors of an aid that declares itself have been found, by number."""
    needs_reset: Real
    """:class:`NeedsReset`."""


class Estimated(Estimates, AidErrors, AidKept, Learnt):  # type: ignore[misc, valid-type]
    """What is estimated, and what it was learnt from: all goes when the filter starts over."""


class Evidence:
    """What decisions depend on: times, counts, and what the sources have said of each other."""

    t: Real
    """Of validity, ns."""
    mode: Real
    """:class:`Mode`."""
    first_delay: Real
    """First guess of it, s: from what the autopilot tells."""
    first_delay_var: Real
    """Variance of that, s^2; 0: as configured."""
    origin: Origin
    field: Field
    resets: Real
    reset_reason: Real
    """:class:`Reset`."""
    reset_t: Real
    """Time of the last reset of position, ns."""
    moved: Moved
    samples: Real
    """Inertial ones so far."""
    past: Past
    gain: Gain
    lag: Lag
    lever: Lever
    armed: Real
    landed: Real
    vehicle: Real
    """:class:`~.measurements.VehicleType`, as the autopilot reports it."""
    ground: Real
    """Down position of the last rest, m."""
    has_ground: Real
    fix_t: Real
    """Time of the last fix, ns."""
    fix_dt: Real
    """Between the last two, s."""
    last_fix: Annotated[Vector, 3]
    """Latitude, longitude, altitude."""
    last_fix_vel: Annotated[Vector, 2]
    """Its velocity north and east, m/s."""
    fix_repeats: Real
    """How often it has repeated itself to the bit."""
    heading_t: Annotated[Vector, 3]
    """When each :class:`~.measurements.HeadingSource` was last received, ns."""
    mag_t: Real
    """When an undisturbed field was seen last, ns."""
    natural_fields: Real
    """Fields in a row that are the Earth's."""
    strength_t: Real
    """When the mean strength was brought up to date, ns."""
    strength_t0: Real
    """Since when there is one, ns."""
    strength: Real
    """Mean strength of the measured field, gauss."""
    field_noise: FieldNoise
    raw_fix_t: Real
    """When a receiver itself was last received, ns."""
    receiver: Real
    """Whose fixes are used: 0 the first receiver's, 1 the second's."""
    alone_t: Real
    """Since when the other receiver speaks without the one in use, ns; never: it does not."""
    compass: Real
    """Whose magnetic field is used; 0: the first compass's."""
    azimuth_z: Real
    """Innovation of the last magnetic azimuth that was fused, rad."""
    azimuth_t: Real
    """When it was fused, or when the last disturbed field came after it, ns."""
    azimuth_t0: Real
    """Since when magnetic azimuths are fused in motion, ns."""
    has_leapt: Real
    """Whether the azimuths that are refused began with a leap that the gyro did not see."""
    fake_t: Real
    """When zero velocity was last assumed without GNSS, ns."""
    at_rest: Real
    rest_gyro: Real
    """Variance of the rate at rest, all axes together, learnt at the start; 0: not seen yet."""
    rest_accel: Real
    """Likewise of the specific force."""
    gaps: Real
    """Inertial gaps so far."""
    gap_t: Real
    """When the last of them ends, ns."""
    restored_t: Real
    """When an unsound state was last replaced by an earlier one, ns."""
    used_t: Annotated[Vector, AIDS]
    """When each aid was last fused, ns."""
    refusal: Annotated[Vector, AIDS]
    """Share of the last measurements of an aid that declares itself that were refused."""
    refused_t: Annotated[Vector, AIDS]
    """Since when each has been refused, ns."""
    reading: Annotated[Vector, AIDS]
    """Last reading of an aid that declares itself, the first number of its row."""
    changed_t: Annotated[Vector, AIDS]
    """When that changed last, ns."""
    doubtful: Annotated[Vector, AIDS]
    """Readings of it in a row that were beyond the soft gate."""
    ratio: Annotated[Vector, AIDS]
    """Last NIS of each aid over its gate; NaN: there was no covariance to judge by."""
    is_denied: Annotated[Vector, AIDS]
    """Other evidence said that it was wrong, whatever its ratio is."""
    nis_sum: Annotated[Vector, AIDS]
    """Of NIS per degree of freedom; what is refused counts as its gate."""
    nis_n: Annotated[Vector, AIDS]
    count: Annotated[Vector, AIDS, VERDICTS]
    """What became of how many."""
    heading_count: Annotated[Vector, HEADINGS, VERDICTS]
    """The same of the headings, by kind of sensor."""
    azimuth: Real
    """:class:`Azimuth` in use; 0: none."""
    heading_std: Real
    """One sigma of its slow error, rad."""
    noise_block: NoiseBlock
    slow_dt: Real
    """Time since the slow errors of heading and GNSS were carried on, s."""
    walk: Walk
    doubt: Real
    """Share of the configured inertial noise that counts beside the learnt one."""
    has_new_bias: Real
    """Whether the accelerometer's bias may have changed, and is to be found anew."""
    shown: Annotated[Vector, 2]
    """Largest square of the rate and of the acceleration flown for some seconds, (rad/s)^2,
    (m/s^2)^2; 0: none beyond the usual."""
    innovation_power: Real
    """Mean NIS a row of the receiver's velocity, up to 1."""
    worst_doubt: Real
    """Its largest value lately."""
    proven_t: Real
    """Time until which the attitude is to be confirmed, ns."""
    correlation: Real
    """Of the last two innovations of the receiver's velocity, one sigma if they are white."""
    is_gradual: Real
    """Whether the velocities that are refused were led up to."""
    innovation_t: Real
    """Time of the last of them, ns."""
    last_innovation: Annotated[Vector, 3]
    """Whitened, sigmas."""
    refused_way: Annotated[Vector, 3]
    """Integral of the velocity's innovations since it is refused, n e d, m."""
    largest_reading: Annotated[Vector, 6]
    """Largest rate and specific force that each axis has shown."""
    unmeasured: Annotated[Vector, 6]
    """Variance by the second of axes that do not measure: rate, rad^2/s, force, m^2/s^3."""
    equal: Annotated[Vector, 6]
    """Pairs of readings of an axis that were equal to the bit, before the last run of such."""
    unequal: Annotated[Vector, 6]
    """Those that were not."""
    equal_run: Annotated[Vector, 6]
    """Equal ones in a row until now."""
    equal_beside: Annotated[Vector, 6]
    """Of the other axes in this run, all together."""
    split: Annotated[Vector, 3]
    """What the receiver's position lately moved beside the integral of its velocity, n e d, m."""
    split_pos: Annotated[Vector, 3]
    """Its last position, n e d, m."""
    split_vel: Annotated[Vector, 3]
    """Its last velocity, m/s."""
    split_t: Real
    """ns."""
    slide: Slide
    force_t: Real
    """Of the last fix that the specific force did not deny, ns."""
    force_vel: Annotated[Vector, 3]
    """Its velocity, m/s."""
    force_sum: Annotated[Vector, 3]
    """Integral of the specific force since, n, m/s."""
    felt_force: Annotated[Vector, 3]
    """The same over the last half second or so until then."""
    fix_force: Annotated[Vector, 3]
    """What it is by the change of the receiver's velocity."""
    force_time: Real
    """Over how long, faded likewise, s."""
    is_force_denied: Real
    """The last fix claims what the inertial samples did not feel."""
    is_fall_denied: Real
    """Likewise of a change of the vertical velocity alone: 1 a fall, -1 a rise, 0 none."""
    fall_gap: Real
    """What its vertical velocity gained lately beyond what the samples felt, m/s."""
    gnss_vel_offset_var: Annotated[Vector, 2]
    """Variance of the slow error of the velocity in the long run: level, vertical, (m/s)^2."""
    gnss_offset_var: Annotated[Vector, 2]
    """Variance of the slow error of its position: horizontal, vertical, m^2."""
    last_z: Annotated[Vector, RUNS, 3]
    """Its last innovations, by aid: m, m, m/s."""
    last_z_t: Annotated[Vector, RUNS]
    """Their times, ns."""
    innovation_mean: Annotated[Vector, 3]
    """Recent mean of the whitened innovations of its position n e d, sigmas."""
    is_one_sided: Annotated[Vector, 2]
    """Whether that mean of position and of height is beyond chance."""
    voices: Voices
    drag: Drag
    run: Annotated[Structs, Run, RUNS]
    alignment: Alignment
    log_likelihood: Real
    """Sum over the receiver's innovations; compares settings, nothing reads it."""
    yaw_bank: YawBank
    copied: Annotated[Vector, N]
    """Of which error state each was last made a copy, with white noise; -1: of none."""
    redrawn: Annotated[Vector, N]
    """How often each error state was given a new variance, uncorrelated with the others."""


@struct
class State(Estimated, Evidence):
    """Everything that the filter estimates and decides by."""


BLOCK = doubles(State)
ESTIMATED = doubles(struct(Estimated))
"""Numbers of a state that are estimated, the first of its block."""
