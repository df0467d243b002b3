"""Working memory of one step: the event, the observation, the interval; and its output.

Nothing in it outlives the step, but the smoother's tape. ``setup.py`` makes ``scratch.pxd`` of it.
"""

import ctypes
from typing import Annotated, Any

from ekf_companion.core.memory.bank import INSTANCES, Bank
from ekf_companion.core.memory.declare import Count, Real, Vector, doubles, struct, union
from ekf_companion.core.memory.enums import RUNS, YAW_FILTERS, YAW_N, N
from ekf_companion.core.memory.state import Reference, State
from ekf_companion.nav.measurements import WIDTH

COMPONENTS = INSTANCES + 1
"""Of the mixture of the fault hypotheses: each, and that nothing is wrong."""


@struct
class ImuRow:
    """Values of an inertial sample."""

    gyro: Annotated[Vector, 3]
    accel: Annotated[Vector, 3]
    gyro_std: Real
    """The first of another unit, or of one that is doubted: one sigma of how its biases differ from
    those that were estimated, rad/s; 0: neither; infinite: nobody knows."""
    accel_std: Real
    """m/s^2."""
    turned: Real
    """By how much the unit before was wrong in all, rad."""
    gained: Real
    """m/s."""
    is_late: Real
    """Its stamp is behind, and the clock goes on."""


@struct
class GnssRow:
    """Values of a fix; NaN where the receiver gives none."""

    lat: Real
    lon: Real
    alt: Real
    vel_n: Annotated[Vector, 3]
    std: Annotated[Vector, RUNS]
    """Position, height, velocity."""
    declination: Real
    flags: Real
    inclination: Real
    strength: Real


@struct
class MagRow:
    """Values of a magnetic field."""

    mag_b: Annotated[Vector, 3]
    compass: Real


@struct
class HeadingRow:
    """Values of a heading."""

    heading: Real
    std: Real
    source: Real


@struct
class VehicleRow:
    """The autopilot's own state."""

    armed: Real
    landed: Real
    tells_delay: Real
    gnss_delay: Real
    type: Real
    """:class:`~.measurements.VehicleType`."""


@union
class Values:
    """The numbers of one event, by its kind; an aid that declares itself reads ``all``."""

    all: Annotated[Vector, WIDTH]
    imu: ImuRow
    gnss: GnssRow
    heading: HeadingRow
    mag: MagRow
    vehicle: VehicleRow


@struct
class Event:
    """One row of the timeline."""

    t: Real
    """When it was true, ns."""
    kind: Real
    """:class:`~.measurements.Kind`."""
    values: Values


@struct
class Fix:
    """A fix as it is used."""

    lat: Real
    lon: Real
    alt: Real
    vel_n: Annotated[Vector, 3]
    """Down is NaN where the receiver has none."""
    std: Annotated[Vector, RUNS]
    """One sigma of the white part: position, height, velocity."""
    stated_var: Annotated[Vector, RUNS]
    """Variance that the receiver states."""
    lag: Real
    """How much later its velocity is true than its position, s."""
    lag_var: Real
    """Variance of that, s^2."""


@struct
class Then:
    """The motion when a late fix was true."""

    late: Real
    """How long ago that was, s."""
    until: Annotated[Vector, 3]
    """Velocity gained until then, in n, m/s."""
    since: Annotated[Vector, 3]
    """Velocity gained since, m/s."""
    accel_n: Annotated[Vector, 3]
    """Acceleration, m/s^2."""


@struct
class Observation:
    """What a sensor should have read, and how that depends on the error.

    ``observe`` fills it; ``correct`` reads it and adds what follows.
    """

    rows: Count
    shows_delay: Count
    """0: it does not move the delay of the fixes, which is uncertain in it all the same."""
    part: Count
    """Which of the observations that an aid's measurement makes."""
    z: Annotated[Vector, 3]
    """Innovation: measured minus predicted."""
    H: Annotated[Vector, 3, N]
    R: Annotated[Vector, 3, 3]
    C_nb: Annotated[Vector, 3, 3]
    """At the time of the observation."""
    arm_n: Annotated[Vector, 3]
    """Lever arm of the antenna, m."""
    arm_vel_n: Annotated[Vector, 3]
    """Velocity that the antenna has from the turn, m/s."""
    turn_nb: Annotated[Vector, 3, 3]
    """C_nb [rate x]: what velocity a lever arm in b has in n, 1/s."""
    then: Then
    uneven: Annotated[Vector, 3]
    """What the velocity's unevenness adds to R, (m/s)^2."""

    PHt: Annotated[Vector, 3, N]
    """P H', then the gains of the whitened rows."""
    L: Annotated[Vector, 3, 3]
    """Cholesky factor of S = H P H' + R."""
    y: Annotated[Vector, 3]
    """Whitened innovation."""
    dx: Annotated[Vector, N]
    """Error state that was moved into the nominal one."""
    gain: Annotated[Vector, N]
    """Gain of a row that corrects yaw only."""

    has_bank: Count
    """False where no fault hypotheses follow the filter."""
    bank: Annotated[Any, ctypes.POINTER(Bank)]


@struct
class Motion:
    """One inertial interval: its rate and force, and what the covariance needs of it."""

    mean: Annotated[Vector, 6]
    """Rate and force, mean over the whole interval."""
    rate: Annotated[Vector, 3]
    """Over a part of it, rad/s."""
    force: Annotated[Vector, 3]
    """m/s^2."""
    rate_slope: Annotated[Vector, 3]
    """rad/s^2."""
    force_slope: Annotated[Vector, 3]
    """m/s^3."""
    C_nb: Annotated[Vector, 3, 3]
    """At its start."""
    C_fb: Annotated[Vector, 3, 3]
    """From b to another frame that is carried along."""
    turn_b: Annotated[Vector, 3]
    """Rotation vector, rad."""
    dv_b: Annotated[Vector, 3]
    """Velocity increment of the force, in b at its start, m/s."""
    dp_b: Annotated[Vector, 3]
    """Position increment of the force, in b at its start, m."""
    dv_n: Annotated[Vector, 3]
    """Velocity increment of the force, m/s."""
    gravity_n: Annotated[Vector, 3]
    """Acceleration in n that is not specific force, m/s^2."""
    frame_rate: Annotated[Vector, 3]
    """Turn rate of n in inertial space, rad/s."""
    scale: Annotated[Vector, 2]
    """Metres of the local frame per metre north, and east, where we are."""
    S: Annotated[Vector, 3, 3]
    """-[dv x]: from attitude to velocity."""
    SG: Annotated[Vector, 3, 3]
    """S G / 2: from gyro bias to velocity."""
    G: Annotated[Vector, 3, 3]
    """-C_nb dt: from gyro bias to attitude, from accelerometer bias to velocity."""
    q: Annotated[Vector, 6]
    """Variance that white noise adds to angle and velocity, per axis of b."""
    gyro_walk: Real
    """Variance that the walk of a gyro bias adds, (rad/s)^2."""
    accel_walk: Real
    """Likewise of an accelerometer bias, (m/s^2)^2."""
    new_bias: Real
    """What that may have jumped by besides, (m/s^2)^2."""
    slow_walk: Annotated[Vector, N]
    """Likewise of each of an aid's slow errors, of the square of its unit."""
    slow_dt: Real
    """Time over which the slow errors were carried on with this interval, s; 0: they were not."""
    heading_faded: Real
    """Share of the heading's that it fades by."""
    heading_level: Real
    """Variance of that in the long run, rad^2."""
    row: Annotated[Vector, N]
    row2: Annotated[Vector, N]


@struct
class Pair:
    """A direction of the body, and where it points in n; of any length."""

    b: Annotated[Vector, 3]
    n: Annotated[Vector, 3]


@struct
class YawUpdate:
    """One fix in the yaw bank, and its innovation in each filter."""

    vel_n: Annotated[Vector, 2]
    """Velocity of the fix, n e, m/s."""
    F: Annotated[Vector, 5, YAW_N]
    """Transition less one, of velocity, yaw and tilt."""
    C_sb: Annotated[Vector, 3, 3]
    turned: Annotated[Vector, 3]
    """Turn of s by the gyro bias, rad."""
    arm_vel: Annotated[Vector, 2]
    """Velocity that the antenna has from the turn, in s, m/s."""
    added: Annotated[Vector, 2]
    """What a fix adds to the velocity, n e, m/s."""
    accel_n: Annotated[Vector, 2]
    """Acceleration, n e, m/s^2."""
    PHt: Annotated[Vector, YAW_N, 2]
    z: Annotated[Vector, YAW_FILTERS, 2]
    """Innovation of each filter."""
    S_inv: Annotated[Vector, YAW_FILTERS, 3]
    """Inverse of its covariance: nn, ne, ee."""
    log_likelihood: Annotated[Vector, YAW_FILTERS]


@struct
class Pose:
    """What ODOMETRY's covariances are turned by."""

    C_nb: Annotated[Vector, 3, 3]
    turn: Annotated[Vector, 3, 3]
    """From one kind of error to another."""
    cov: Annotated[Vector, 6, 6]


@struct
class Protection:
    """What the error may be, by each fault hypothesis: the first, that nothing is wrong."""

    horizontal: Real
    """The level that was found, m."""
    vertical: Real
    n: Count
    rest: Real
    """Probability of all that are too improbable to be looked at."""
    nothing: Real
    """That nothing is wrong in the level."""
    nothing_vertical: Real
    p: Annotated[Vector, COMPONENTS]
    """Of each; not of the first."""
    far: Annotated[Vector, COMPONENTS]
    """Horizontal distance of its mean from what is shown, m."""
    down: Annotated[Vector, COMPONENTS]
    """Vertical distance, m."""
    nn: Annotated[Vector, COMPONENTS]
    """Its covariance, m^2."""
    ne: Annotated[Vector, COMPONENTS]
    ee: Annotated[Vector, COMPONENTS]
    dd: Annotated[Vector, COMPONENTS]


@struct
class TapeRecord:
    """The state after something happened, and how its error follows from the record before."""

    link: Real
    """:class:`Link`."""
    is_sample: Real
    """It ends an inertial sample."""
    state: State
    Phi: Annotated[Vector, N, N]


@struct
class Tape:
    """A record of each step of the filter, for the smoother."""

    is_on: Count
    """False in the live filter, which has no tape."""
    length: Count
    record: Annotated[Any, ctypes.POINTER(TapeRecord)]


@struct
class Hindsight:
    """Working memory of the smoother over one interval."""

    prior: Annotated[Vector, N, N]
    """Covariance that the filter had after the interval, then its factor."""
    gain: Annotated[Vector, N, N]
    """Phi P, then the transposed gain."""
    change: Annotated[Vector, N, N]
    """Covariance known later less the prior."""
    half: Annotated[Vector, N, N]


@struct
class Scratch:
    """What one step works with; nothing in it outlives the step but the tape."""

    motion: Motion
    fix: Fix
    pair: Pair
    reference: Reference
    mean_rate: Annotated[Vector, 3]
    """Of the gyro over a window of rest, rad/s."""
    observation: Observation
    yaw: YawUpdate
    pose: Pose
    protection: Protection
    tape: Tape


@struct
class Estimate:
    """An estimate: ``nav.state.COLUMNS`` without the time."""

    lla: Annotated[Vector, 3]
    """Latitude, longitude (deg), altitude (m)."""
    pos_n: Annotated[Vector, 3]
    vel_n: Annotated[Vector, 3]
    q_nb: Annotated[Vector, 4]
    euler: Annotated[Vector, 3]
    gyro_bias: Annotated[Vector, 3]
    accel_bias: Annotated[Vector, 3]
    std_pos: Annotated[Vector, 3]
    std_vel: Annotated[Vector, 3]
    std_euler: Annotated[Vector, 3]
    wind: Annotated[Vector, 2]
    """Where the air moves to, north and east, m/s."""
    std_wind: Annotated[Vector, 2]
    status: Real
    resets: Real
    reasons: Real
    """:class:`~.nav.state.Reason`, the sum of its bits."""


@struct
class OdometryNumbers:
    """The numbers of ODOMETRY, in its order, and another covariance that may take its place."""

    pos_n: Annotated[Vector, 3]
    q_nb: Annotated[Vector, 4]
    vel_b: Annotated[Vector, 3]
    rate_b: Annotated[Vector, 3]
    pose_cov: Annotated[Vector, 21]
    twist_cov: Annotated[Vector, 21]
    relative_cov: Annotated[Vector, 21]
    """``pose_cov`` apart from the slow error of the receiver's position; not in the message."""


VALUES = WIDTH
ROW = doubles(Event)
OUT = doubles(Estimate)
ODOMETRY = doubles(OdometryNumbers)
RECORD = doubles(TapeRecord)
