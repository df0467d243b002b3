"""Pose of another estimator: visual odometry, lidar odometry, motion capture.

It knows where it is in a frame of its own, whose place and heading nobody else knows, and it
drifts there. So its frame's place and yaw in n are slow errors: they are found by our own estimate
when it begins, and where GNSS is lost position and yaw are no surer than they are. The place walks
with the way that is travelled: that is to fuse the poses between two times, each with its drift,
and leaves what is white in them white. A source that knows how far it may have drifted from one
pose to the next states that covariance, and the place walks by it. Scale (of a single camera) and
delay are slow errors too.

The place is that of a pivot, the pose of some metres ago: a drift of yaw or scale turns and
stretches what is travelled from now on, not what was travelled before.

What leaps between two poses, as we did not, has begun a new frame, with or without a moved reset
counter; that moves nothing of ours.

Source: relative poses as measurements: Roumeliotis and Burdick 2002 (stochastic cloning); yaw,
place, scale and delay of a visual frame as states: Lynen et al. 2013 (MSF).
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.observation import clear
from cython.cimports.ekf_companion.core.filter.past import gained_until
from cython.cimports.ekf_companion.core.filter.rotation import rotate, to_dcm, wrap
from cython.cimports.ekf_companion.core.filter.slow_error import (
    add_covariance,
    add_error,
    add_variance,
    copy_error,
    reset_variance,
    set_variance,
)
from cython.cimports.ekf_companion.core.filter.update import apply_update, innovate
from cython.cimports.ekf_companion.core.memory.constants import THREE_SIGMA2, WITHOUT_FIX
from cython.cimports.ekf_companion.core.memory.enums import (
    AID_POSITION,
    AID_VISUAL_ODOMETRY,
    E_ATT,
    E_POS,
    E_VEL,
    E_VISUAL_ODOMETRY,
    MODE_NAVIGATE,
)
from cython.cimports.ekf_companion.core.memory.overlay import Vector
from cython.cimports.ekf_companion.core.memory.parameters import Parameters
from cython.cimports.ekf_companion.core.memory.scratch import Observation
from cython.cimports.ekf_companion.core.memory.state import State
from cython.cimports.libc.math import atan2, cos, fabs, isnan, sin, sqrt

from ekf_companion.core.memory.aid import Kept, SlowError, Value, aid
from ekf_companion.nav.measurements import Kind

E_YAW = cython.declare(cython.int, E_VISUAL_ODOMETRY + 3)
E_SCALE = cython.declare(cython.int, E_VISUAL_ODOMETRY + 4)
E_LATE = cython.declare(cython.int, E_VISUAL_ODOMETRY + 5)
YAW_STD = cython.declare(cython.int, 0)
SCALE_STD = cython.declare(cython.int, 1)
DELAY_STD = cython.declare(cython.int, 3)
LEVER_ARM = cython.declare(cython.int, 4)
TIMING_STD = cython.declare(cython.int, 7)
"""Places of its own settings."""
DRIFT = cython.declare(cython.Py_ssize_t, 7)
"""First place of the drift's factor in the row, by its lower triangle."""
PIVOT_AWAY = cython.declare(cython.double, 1.0)
"""Way from the pivot after which there is a new one, m: a yaw that walks by 3e-3 rad/sqrt(s) moves
what is so far away by 3 mm/sqrt(s), hardly more than the place's own walk in a hover."""
HALF = cython.declare(cython.double, 0.02)
"""Half the time over which a slope is a mean, s, at least."""
LONGEST = cython.declare(cython.double, 0.2)
"""At most: half a second of motion is kept."""
YAWS = cython.declare(cython.Py_ssize_t, 24)
"""Yaws of ours that are kept."""
YAW_STEP = cython.declare(cython.double, 2.4e7)
"""Least time between them, ns: they reach back over 0.55 s."""
LAGS = cython.declare(cython.Py_ssize_t, 24)
"""Delays that are compared."""
LAG_STEP = cython.declare(cython.double, 0.02)
"""s; a turn of a vehicle changes in a multiple of it."""
LEAST_TURN = cython.declare(cython.double, 4e-6)
"""Square of what a turn between two poses is off by at least, rad^2: 0.1 deg."""
DECISIVE = cython.declare(cython.double, 40.0)
"""Chi-square by which a delay must be better than all that are not beside it."""
UNKNOWN_YAW = cython.declare(cython.double, 0.09)
"""Variance of the yaw of a frame that states no yaw and is taken to point north, rad^2."""
LEAP = cython.declare(cython.double, 0.5)
"""Way between two poses beyond ours, m, that is a new frame."""
LEAP_SIGMAS2 = cython.declare(cython.double, 150.0)
"""Its least square, in variances of the noise along an axis: five sigmas of the difference of two
poses, in three axes."""
MEMORY = cython.declare(cython.double, 30.0)
"""Poses that the noise is learnt over."""
TURNED = cython.declare(cython.double, 0.02)
"""Sum of the squares of its turns between two poses by which these are judged, rad^2: a turn to
one side and back by 30 deg within two seconds."""
PATIENCE = cython.declare(cython.double, 600.0)
"""Poses after which a delay that no turn has shown may be found by positions: half a minute."""
LEAP_YAW = cython.declare(cython.double, 0.2)
"""The same of yaw, rad."""
LEAP_TIME = cython.declare(cython.double, 1e9)
"""Longest time between them in which ours is known so well, ns."""
LEAST_LEVEL = cython.declare(cython.double, 0.25)
"""Square of the cosine of the pitch below which yaw is not observed: 60 deg."""


@aid(
    Kind.POSE,
    words="pose of visual odometry",
    sensor="visual odometry",
    advice="Look at its quality, raise visual_odometry.std, or visual_odometry.use = false.",
    parts=2,
    shows_position=True,
)
class VisualOdometry:
    """Position and yaw in a frame whose down is down, and whose place and yaw are its own."""

    x = Value("m", -1e6, 1e6)
    y = Value("m", -1e6, 1e6)
    z = Value("m", -1e6, 1e6)
    yaw = Value("rad", -7.0, 7.0, is_optional=True)
    std = Value("m", 0.0, 1e4, is_optional=True)
    yaw_drift = Value("rad", -1e-9, 10.0, is_optional=True)
    counter = Value("1", -1.0, 256.0, is_optional=True)
    drift_xx = Value("m", -1e5, 1e5, is_optional=True)
    drift_yx = Value("m", -1e5, 1e5, is_optional=True)
    drift_yy = Value("m", -1e5, 1e5, is_optional=True)
    drift_zx = Value("m", -1e5, 1e5, is_optional=True)
    drift_zy = Value("m", -1e5, 1e5, is_optional=True)
    drift_zz = Value("m", -1e5, 1e5, is_optional=True)
    north = SlowError("m")
    east = SlowError("m")
    down = SlowError("m")
    frame_yaw = SlowError("rad", walk="yaw_walk", speed_walk=None)
    scale = SlowError("1", walk="scale_walk", speed_walk=None)
    delay = SlowError("s", walk="delay_walk", speed_walk=None)
    has_begun = Kept("1")
    scale_var = Kept("1")
    delay_var = Kept("s^2")
    yaw_t = Kept("ns", 24)
    yaws = Kept("rad", 24)
    misfit = Kept("rad^2", 24)
    compared = Kept("1")
    turned = Kept("rad^2")
    has_delay = Kept("1")
    contradicts = Kept("1")
    noise = Kept("m^2")
    pivot = Kept("m", 3)
    pose = Kept("m", 4)
    ours = Kept("m", 4)
    then = Kept("m", 3)
    speed = Kept("m/s", 3)
    bend = Kept("m", 3)
    arm = Kept("m", 3)
    last_t = Kept("ns")
    reset_counter = Kept("1")
    least_std = Kept("m")


def yaw_of(x: State) -> float:
    """Return our yaw, rad."""
    q = x.q_nb
    return atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]))


def yaw_rate(x: State) -> float:
    """Return the rate of yaw, rad/s; 0 near the vertical."""
    q = x.q_nb
    right = 2.0 * (q[2] * q[3] + q[0] * q[1])
    down = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    level = right * right + down * down
    turn = right * (x.gyro[1] - x.gyro_bias[1]) + down * (x.gyro[2] - x.gyro_bias[2])
    return turn / level if level > LEAST_LEVEL else 0.0


def variance(x: State, k: Parameters) -> float:
    """Return the variance of a position's white noise, m^2.

    A source states how far it may have drifted since it began: only the least that it has stated
    is noise. What its steps show beside ours counts if it is more.
    """
    std = k.aid[AID_VISUAL_ODOMETRY].std
    if x.visual_odometry_least_std > std:
        std = x.visual_odometry_least_std
    return std * std if std * std > x.visual_odometry_noise else x.visual_odometry_noise


def yaw_variance(k: Parameters) -> float:
    """Return the variance of a yaw's white noise, rad^2."""
    std = k.aid[AID_VISUAL_ODOMETRY].own[YAW_STD]
    return std * std


def way_from(x: State, a: Vector, b: Vector, way: Vector) -> None:
    """Write the way from a to b, both in its frame, in n, m."""
    s = 1.0 + x.visual_odometry_scale
    c = s * cos(x.visual_odometry_frame_yaw)
    n = s * sin(x.visual_odometry_frame_yaw)
    north = c * (b[0] - a[0]) - n * (b[1] - a[1])
    east = n * (b[0] - a[0]) + c * (b[1] - a[1])
    way[2] = s * (b[2] - a[2])
    way[0] = north
    way[1] = east


def keep(x: State, row: Vector) -> None:
    """Keep a pose, and ours beside it."""
    for i in range(4):
        x.visual_odometry_pose[i] = row[i]
    for i in range(3):
        x.visual_odometry_ours[i] = x.pos_n[i]
    x.visual_odometry_ours[3] = yaw_of(x)
    keep_yaw(x)
    x.visual_odometry_last_t = x.t
    x.visual_odometry_scale_var = x.P[E_SCALE][E_SCALE]
    x.visual_odometry_delay_var = x.P[E_LATE][E_LATE]
    x.visual_odometry_reset_counter = row[6]
    if not isnan(row[4]) and (
        row[4] < x.visual_odometry_least_std or x.visual_odometry_least_std == 0.0
    ):
        x.visual_odometry_least_std = row[4]


def place(x: State, k: Parameters, row: Vector) -> float:
    """Write the position at a start by it alone, and yaw where nothing else has shown it.

    Then its frame is n. Return one sigma of the position, m; 0: it cannot, for nobody states yaw.
    """
    yaw = 0.0
    if x.visual_odometry_contradicts != 0.0:
        return 0.0
    if x.has_yaw == 0.0:
        if isnan(row[3]):
            return 0.0
        rotate(x.q_nb, 0.0, 0.0, wrap(row[3] - yaw_of(x)))
        reset_variance(x, E_ATT + 2, 1, yaw_variance(k))
        x.has_yaw = 1.0
    elif not isnan(row[3]):
        yaw = wrap(yaw_of(x) - row[3])
    x.pos_n[0] = cos(yaw) * row[0] - sin(yaw) * row[1]
    x.pos_n[1] = sin(yaw) * row[0] + cos(yaw) * row[1]
    x.pos_n[2] = row[2]
    return k.aid[AID_VISUAL_ODOMETRY].std


def begin(x: State, k: Parameters, row: Vector) -> bool:
    """Find place and yaw of its frame by our pose, whose errors they have from then on.

    Scale and delay are the sensor's, not the frame's: what was learnt of them stays.
    """
    own = k.aid[AID_VISUAL_ODOMETRY].own
    if x.mode != MODE_NAVIGATE or x.visual_odometry_contradicts != 0.0:
        return False
    if x.visual_odometry_has_begun == 0.0:
        x.visual_odometry_has_begun = 1.0
        x.visual_odometry_scale = 0.0
        x.visual_odometry_delay = 0.0
        x.visual_odometry_least_std = 0.0
        reset_variance(x, E_SCALE, 1, own[SCALE_STD] * own[SCALE_STD])
        reset_variance(x, E_LATE, 1, own[DELAY_STD] * own[DELAY_STD])
    elif x.P[E_SCALE][E_SCALE] < 0.5 * x.visual_odometry_scale_var:
        # the filter has started over
        reset_variance(x, E_SCALE, 1, x.visual_odometry_scale_var)
        reset_variance(x, E_LATE, 1, x.visual_odometry_delay_var)
    for i in range(YAWS):  # it may have been turned since
        x.visual_odometry_yaw_t[i] = 0.0
    keep(x, row)
    for i in range(3):
        x.visual_odometry_pivot[i] = row[i]
    if isnan(row[3]):
        x.visual_odometry_frame_yaw = 0.0
        reset_variance(x, E_YAW, 1, UNKNOWN_YAW)
    else:
        rate = yaw_rate(x)
        then = yaw_of(x) - x.visual_odometry_delay * rate
        x.visual_odometry_frame_yaw = wrap(then - row[3])
        copy_error(x, E_YAW, E_ATT + 2, yaw_variance(k))
        add_error(x, E_YAW, E_LATE, -rate)
    return set_place(x, k)


def set_place(x: State, k: Parameters) -> bool:
    """Set the place of the pivot, which is the pose of now, to ours when that was true."""
    write_ours(x, k)
    x.visual_odometry_north = x.visual_odometry_then[0]
    x.visual_odometry_east = x.visual_odometry_then[1]
    x.visual_odometry_down = x.visual_odometry_then[2]
    for i in range(3):
        e = E_VISUAL_ODOMETRY + i
        bend = x.visual_odometry_bend[i]
        copy_error(x, e, E_POS + i, variance(x, k) + 2.0 * bend * bend + product(x, i))
        add_error(x, e, E_VEL + i, -x.visual_odometry_delay)
        add_error(x, e, E_LATE, -x.visual_odometry_speed[i])
        for j in range(3):
            add_error(x, e, E_ATT + j, turned(x.visual_odometry_arm, i, j))
    return True


def write_ours(x: State, k: Parameters) -> None:
    """Write where the sensor was when the pose was true, and how that depends on the delay.

    Over what is not known of the delay the motion bends: by a slope at one point of it the delay
    would be found soon, and wrong. So the slope is that over one sigma to both sides, and of what
    is beside it the mean counts as motion, the rest as noise (a filter of second order).
    """
    h = unsure(x)
    write_arm(x, k, x.visual_odometry_arm)
    place_then(x, x.visual_odometry_delay, x.visual_odometry_then)
    place_then(x, x.visual_odometry_delay + h, x.visual_odometry_bend)
    place_then(x, x.visual_odometry_delay - h, x.visual_odometry_speed)
    for i in range(3):
        before = x.visual_odometry_bend[i]
        after = x.visual_odometry_speed[i]
        bend = 0.5 * (before + after) - x.visual_odometry_then[i]
        x.visual_odometry_speed[i] = (after - before) / (2.0 * h)
        x.visual_odometry_bend[i] = bend
        x.visual_odometry_then[i] += bend + x.visual_odometry_arm[i]


def unsure(x: State) -> float:
    """Return one sigma of the delay, s, at least what a slope needs, at most what is kept."""
    h = sqrt(x.P[E_LATE][E_LATE])
    h = h if h > HALF else HALF
    return h if h < LONGEST else LONGEST


def product(x: State, axis: int) -> float:
    """Return the variance of the product of two errors, of the delay and of the velocity, m^2."""
    v = E_VEL + axis
    both = x.P[v][E_LATE]
    return x.P[v][v] * x.P[E_LATE][E_LATE] + both * both


def place_then(x: State, late: float, place: Vector) -> None:
    """Write our position some time ago, s."""
    gained_until(x, x.t - late * 1e9, place)
    for i in range(3):
        since = x.past.gained[i] - place[i]
        place[i] = x.pos_n[i] - late * (x.vel_n[i] - 0.5 * since)


def write_arm(x: State, k: Parameters, arm: Vector) -> None:
    """Write the lever arm in n, m."""
    own = k.aid[AID_VISUAL_ODOMETRY].own
    q = x.q_nb
    lx = own[LEVER_ARM]
    ly = own[LEVER_ARM + 1]
    lz = own[LEVER_ARM + 2]
    # v + 2 q x (q x v + w v)
    cx = q[2] * lz - q[3] * ly + q[0] * lx
    cy = q[3] * lx - q[1] * lz + q[0] * ly
    cz = q[1] * ly - q[2] * lx + q[0] * lz
    arm[0] = lx + 2.0 * (q[2] * cz - q[3] * cy)
    arm[1] = ly + 2.0 * (q[3] * cx - q[1] * cz)
    arm[2] = lz + 2.0 * (q[1] * cy - q[2] * cx)


def turned(v: Vector, i: int, j: int) -> float:
    """Return how component i of v, in n, depends on the attitude's error about j: theta x v."""
    if i == j:
        return 0.0
    other = v[3 - i - j]
    return other if (i - j + 3) % 3 == 2 else -other


def move_pivot(x: State, o: Observation) -> None:
    """Take the pose before for the pivot, which was another's place so far."""
    way_from(x, x.visual_odometry_pivot, x.visual_odometry_pose, o.y)
    x.visual_odometry_north += o.y[0]
    x.visual_odometry_east += o.y[1]
    x.visual_odometry_down += o.y[2]
    s = 1.0 + x.visual_odometry_scale
    add_error(x, E_VISUAL_ODOMETRY, E_YAW, -o.y[1])
    add_error(x, E_VISUAL_ODOMETRY + 1, E_YAW, o.y[0])
    for i in range(3):
        add_error(x, E_VISUAL_ODOMETRY + i, E_SCALE, o.y[i] / s)
        x.redrawn[E_VISUAL_ODOMETRY + i] += 1.0
        x.visual_odometry_pivot[i] = x.visual_odometry_pose[i]


def widen(x: State, row: Vector) -> None:
    """Let its frame drift by what the pose states of that since the one before.

    The covariance of the way is stated by its Cholesky factor in its frame: whatever the numbers,
    their product with themselves is one. What is 0 is not stated.
    """
    if row[5] > 0.0:
        add_variance(x, E_YAW, row[5] * row[5])
        x.redrawn[E_YAW] += 1.0
    c = cos(x.visual_odometry_frame_yaw)
    s = sin(x.visual_odometry_frame_yaw)
    for j in range(3):  # each column, turned to n
        along_x = row[DRIFT] if j == 0 else 0.0
        along_y = row[DRIFT + 1 + j] if j < 2 else 0.0
        down = row[DRIFT + 3 + j]
        if isnan(along_x + along_y + down):
            return
        if along_x == 0.0 and along_y == 0.0 and down == 0.0:
            continue
        north = c * along_x - s * along_y
        east = s * along_x + c * along_y
        add_variance(x, E_VISUAL_ODOMETRY, north * north)
        add_variance(x, E_VISUAL_ODOMETRY + 1, east * east)
        add_variance(x, E_VISUAL_ODOMETRY + 2, down * down)
        add_covariance(x, E_VISUAL_ODOMETRY, E_VISUAL_ODOMETRY + 1, north * east)
        add_covariance(x, E_VISUAL_ODOMETRY, E_VISUAL_ODOMETRY + 2, north * down)
        add_covariance(x, E_VISUAL_ODOMETRY + 1, E_VISUAL_ODOMETRY + 2, east * down)
        for i in range(3):
            x.redrawn[E_VISUAL_ODOMETRY + i] += 1.0


def is_new_frame(x: State, k: Parameters, row: Vector, o: Observation) -> bool:
    """Return whether it has begun a new frame: by its counter, or by a leap that is not ours.

    Its noise is learnt by the steps that are compared.
    """
    if not isnan(row[6]) and row[6] != x.visual_odometry_reset_counter:
        return True
    if x.t - x.visual_odometry_last_t > LEAP_TIME:
        return False
    way_from(x, x.visual_odometry_pose, row, o.y)
    off = 0.0
    for i in range(3):
        apart = o.y[i] - (x.pos_n[i] - x.visual_odometry_ours[i])
        off += apart * apart
    noise = variance(x, k)
    seen = off / 6.0 if off / 6.0 < THREE_SIGMA2 * noise else THREE_SIGMA2 * noise
    if x.visual_odometry_noise == 0.0:
        x.visual_odometry_noise = noise
    x.visual_odometry_noise += (seen - x.visual_odometry_noise) / MEMORY
    if off > LEAP * LEAP and off > LEAP_SIGMAS2 * noise:
        return True
    if isnan(row[3]) or isnan(x.visual_odometry_pose[3]):
        return False
    turn = wrap(row[3] - x.visual_odometry_pose[3]) - wrap(yaw_of(x) - x.visual_odometry_ours[3])
    return fabs(wrap(turn)) > LEAP_YAW


def is_frozen(x: State, row: Vector) -> bool:
    """Return whether a pose repeats the one before to the bit, which only a rest explains."""
    if x.at_rest != 0.0:
        return False
    for i in range(3):
        if row[i] != x.visual_odometry_pose[i]:
            return False
    return True


def observe(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe the position: three rows; then, as the second part, yaw: one row."""
    if o.part == 1:
        return observe_yaw(x, k, o, row)
    if x.mode != MODE_NAVIGATE or x.visual_odometry_contradicts != 0.0:
        return False
    widen(x, row)
    if is_frozen(x, row):
        return False
    if is_new_frame(x, k, row, o):
        x.has_aid[AID_VISUAL_ODOMETRY] = 0.0
        return False
    way_from(x, x.visual_odometry_pivot, x.visual_odometry_pose, o.y)
    if o.y[0] * o.y[0] + o.y[1] * o.y[1] + o.y[2] * o.y[2] > PIVOT_AWAY * PIVOT_AWAY:
        move_pivot(x, o)
    if finds_delay(x, k, row):
        hold_delay(x, k)
        compare_turns(x, o, row)
    if x.visual_odometry_contradicts != 0.0:
        return False
    keep(x, row)
    if finds_delay(x, k, row) and x.t - x.used_t[AID_POSITION] < WITHOUT_FIX * 1e9:
        return False  # nobody knows yet whether it turns as we do, and nobody needs it
    write_ours(x, k)
    way_from(x, x.visual_odometry_pivot, row, o.y)
    s = 1.0 + x.visual_odometry_scale
    timing = k.aid[AID_VISUAL_ODOMETRY].own[TIMING_STD]
    timing = timing * timing
    clear(o, 3, variance(x, k))
    o.z[0] = x.visual_odometry_north + o.y[0] - x.visual_odometry_then[0]
    o.z[1] = x.visual_odometry_east + o.y[1] - x.visual_odometry_then[1]
    o.z[2] = x.visual_odometry_down + o.y[2] - x.visual_odometry_then[2]
    for i in range(3):
        # the way as we see it: the noise in its own would pass for scale and yaw
        o.y[i] -= o.z[i]
    for i in range(3):
        e = E_VISUAL_ODOMETRY + i
        o.H[i][E_POS + i] = 1.0
        o.H[i][E_VEL + i] = -x.visual_odometry_delay
        o.H[i][E_LATE] = -x.visual_odometry_speed[i]
        o.H[i][E_SCALE] = -o.y[i] / s
        o.H[i][e] = -1.0
        for j in range(3):
            o.H[i][E_ATT + j] = turned(x.visual_odometry_arm, i, j)
            o.R[i][j] += timing * x.visual_odometry_speed[i] * x.visual_odometry_speed[j]
            o.R[i][j] += 2.0 * x.visual_odometry_bend[i] * x.visual_odometry_bend[j]
        o.R[i][i] += product(x, i)
    o.H[0][E_YAW] = o.y[1]
    o.H[1][E_YAW] = -o.y[0]
    return True


def keep_yaw(x: State) -> None:
    """Keep our yaw of now, for poses that are late."""
    j = cython.declare(cython.Py_ssize_t, 0)
    for i in range(YAWS):
        if x.t - x.visual_odometry_yaw_t[i] < YAW_STEP and x.visual_odometry_yaw_t[i] > 0.0:
            return
        if x.visual_odometry_yaw_t[i] < x.visual_odometry_yaw_t[j]:
            j = i
    x.visual_odometry_yaw_t[j] = x.t
    x.visual_odometry_yaws[j] = yaw_of(x)


def finds_delay(x: State, k: Parameters, row: Vector) -> bool:
    """Return whether the delay is still to be found by turns: it is unknown, and yaw is stated."""
    std = k.aid[AID_VISUAL_ODOMETRY].own[DELAY_STD]
    return x.visual_odometry_has_delay == 0.0 and std > 2.0 * LAG_STEP and not isnan(row[3])


def hold_delay(x: State, k: Parameters) -> None:
    """Take back what the last observation made of the delay: it is a consider state until found.

    Its uncertainty counts, and all that depends on it stays correlated with it; but a motion that
    swings within the delay fits several, so that no linear step may move it (Schmidt 1966).
    """
    std = k.aid[AID_VISUAL_ODOMETRY].own[DELAY_STD]
    x.visual_odometry_delay = 0.0
    set_variance(x, E_LATE, std * std)


def compare_turns(x: State, o: Observation, row: Vector) -> None:
    """Compare the turn since the pose before with ours, for each delay; take one that is decisive.

    Source: calibration of a camera against a gyro by their rates, e.g. Kelly and Sukhatme 2014.
    """
    back = LAG_STEP * LAGS
    if x.t - x.visual_odometry_last_t > LEAP_TIME or isnan(x.visual_odometry_pose[3]):
        return
    if not is_kept(x, x.visual_odometry_last_t - back * 1e9):
        return
    turn = wrap(row[3] - x.visual_odometry_pose[3])
    rate = yaw_rate(x)
    sums = x.visual_odometry_misfit
    best = cython.declare(cython.Py_ssize_t, 0)
    x.visual_odometry_compared += 1.0
    x.visual_odometry_turned += turn * turn
    for j in range(LAGS):
        late = LAG_STEP * j * 1e9
        ours = yaw_then(x, x.t - late, rate)
        ours = wrap(ours - yaw_then(x, x.visual_odometry_last_t - late, rate))
        sums[j] += wrap(turn - ours) * wrap(turn - ours)
        if sums[j] < sums[best]:
            best = j
    if x.visual_odometry_turned > TURNED and sums[best] > x.visual_odometry_turned:
        # by no delay does it turn as we do: it is mirrored, or not of this vehicle
        x.visual_odometry_contradicts = 1.0
    if x.visual_odometry_turned < TURNED and x.visual_odometry_compared > PATIENCE:
        # it does not turn: then by the positions
        x.visual_odometry_has_delay = 1.0
        return
    if best == LAGS - 1:
        return
    noise = sums[best] / x.visual_odometry_compared
    noise = noise if noise > LEAST_TURN else LEAST_TURN
    for j in range(LAGS):
        if (j < best - 1 or j > best + 1) and sums[j] - sums[best] < DECISIVE * noise:
            return
    x.visual_odometry_has_delay = 1.0
    found = LAG_STEP * best
    if best == 0:  # or its stamps are early
        clear(o, 1, 6.0 * LAG_STEP * LAG_STEP)
    else:
        bend = sums[best - 1] - 2.0 * sums[best] + sums[best + 1]
        found += 0.5 * LAG_STEP * (sums[best - 1] - sums[best + 1]) / bend
        clear(o, 1, LAG_STEP * LAG_STEP)
    o.H[0][E_LATE] = 1.0
    o.z[0] = found - x.visual_odometry_delay
    innovate(x, o)
    apply_update(x, o)


def is_kept(x: State, t: float) -> bool:
    """Return whether our yaw is known back to a time, ns."""
    for i in range(YAWS):
        if 0.0 < x.visual_odometry_yaw_t[i] <= t:
            return True
    return False


def yaw_then(x: State, t: float, rate: float) -> float:
    """Return our yaw at a time, ns: between what is kept, or on by the rate of now, rad/s."""
    before = -1.0
    after = x.t
    first = 0.0
    last = yaw_of(x)
    for i in range(YAWS):
        kept = x.visual_odometry_yaw_t[i]
        if before < kept <= t and kept > 0.0:
            before = kept
            first = x.visual_odometry_yaws[i]
        if t < kept < after:
            after = kept
            last = x.visual_odometry_yaws[i]
    if before < 0.0 or t - before > LEAP_TIME or after <= before:
        return last - rate * (after - t) * 1e-9
    share = (t - before) / (after - before)
    return first + share * wrap(last - first)


def observe_yaw(x: State, k: Parameters, o: Observation, row: Vector) -> bool:
    """Observe yaw as it was when the pose was true: one row; not near the vertical."""
    to_dcm(x.q_nb, o.C_nb)
    level = o.C_nb[0][0] * o.C_nb[0][0] + o.C_nb[1][0] * o.C_nb[1][0]
    if isnan(row[3]) or level < LEAST_LEVEL:
        return False
    if finds_delay(x, k, row):
        hold_delay(x, k)
    late = x.visual_odometry_delay
    rate = yaw_rate(x)
    h = unsure(x)
    if not is_kept(x, x.t - (late + h) * 1e9):
        return False
    then = yaw_then(x, x.t - late * 1e9, rate)
    before = wrap(yaw_then(x, x.t - (late + h) * 1e9, rate) - then)
    after = wrap(yaw_then(x, x.t - (late - h) * 1e9, rate) - then)
    bend = 0.5 * (before + after)
    rate = (after - before) / (2.0 * h)
    timing = k.aid[AID_VISUAL_ODOMETRY].own[TIMING_STD]
    clear(o, 1, yaw_variance(k) + rate * rate * timing * timing + 2.0 * bend * bend)
    o.H[0][E_LATE] = -rate
    o.z[0] = wrap(row[3] + x.visual_odometry_frame_yaw - (then + bend))
    o.H[0][E_ATT] = -o.C_nb[2][0] * o.C_nb[0][0] / level
    o.H[0][E_ATT + 1] = -o.C_nb[2][0] * o.C_nb[1][0] / level
    o.H[0][E_ATT + 2] = 1.0
    o.H[0][E_YAW] = -1.0
    return True
