"""What a follower of ODOMETRY sees of the estimate, and what is kept from it.

It sees one message after the other, and nothing of the filter behind them. So a step is measured
from outside: an estimate less the one before, carried on by the inertial samples between them. That
holds for whatever the filter does inside, a reset or one large correction.

A step that no motion explains can be *spread*: what is sent goes on without it, and comes to the
estimate at a speed that a follower takes for noise. Or it moves the *frame* in which positions are
sent, and stays.

All is reckoned from the numbers as a message carries them, in 32 bits, in double precision; what
one stage changes is a number of 32 bits again before the next. All stages work on the same numbers
in place, so they are one class in a long file.
"""

from __future__ import annotations

from struct import Struct

import cython
from cython.cimports.ekf_companion.core.memory.constants import PI
from cython.cimports.ekf_companion.core.output.jump import unexplained_step
from cython.cimports.libc.math import (
    atan2,
    copysign,
    cos,
    fabs,
    fmod,
    hypot,
    isfinite,
    remainder,
    sin,
    sqrt,
)

NUMBERS = Struct("<55f")
"""Of an ODOMETRY: position, quaternion, velocity, rates, and two upper triangles row by row."""
TRIANGLE = Struct("<21f")
_SINGLE = Struct("<f")
TWO_PI = cython.declare(cython.double, 6.283185307179586)
QUATERNION = cython.declare(cython.Py_ssize_t, 3)
VELOCITY = cython.declare(cython.Py_ssize_t, 7)
POSE = cython.declare(cython.Py_ssize_t, 13)
TWIST = cython.declare(cython.Py_ssize_t, 34)
"""Where they begin; the last two are covariances."""
USUAL_TIME = cython.declare(cython.double, 20.0)
"""Time constant of the usual step, s."""
MANY = cython.declare(cython.double, 10.0)
"""Times the usual step. The looks at which a fix is fused are one in six, so this is four times the
usual correction by a fix."""
START_TIME = cython.declare(cython.double, 5.0)
"""After a start the first fixes correct each other by as much as they are uncertain, s."""
SMOOTH_TIME = cython.declare(cython.double, 0.05)
"""Interval up to which the samples between two looks explain any flight, s."""
POSITION_LIMITS = (0.5, 1.0, 2.5)
"""How large a step of the position must be at least, and need be at most, to be a jump, m, and what
motion may add to that over a longer interval, m/s^2. EKF2 refuses beyond 5 sigma (EKF2_EVP_GATE),
sigma no less than 0.1 m (EKF2_EVP_NOISE); EKF3 beyond 5 sigma (EK3_POS_I_GATE) of 0.2 m
(VISO_POS_M_NSE) on two axes, 1.4 m."""
VELOCITY_LIMITS = (0.4, 0.8, 10.0)
"""The same of the velocity, m/s, and per s. EKF2: 3 sigma (EKF2_EVV_GATE) of 0.1 m/s
(EKF2_EVV_NOISE) and its own; EKF3: 5 sigma (EK3_VEL_I_GATE) of 0.1 m/s (VISO_VEL_M_NSE) on three
axes, 0.87 m/s."""
YAW_LIMITS = (0.175, 0.26, 1.0)
"""The same of the yaw, rad: 10 and 15 degrees. EKF2: 2.6 sigma (EKF2_HDG_GATE) of 0.1 rad
(EKF2_EVA_NOISE), 15 degrees; EKF3: 3 sigma (EK3_YAW_I_GATE) of 0.2 rad (VISO_YAW_M_NSE), 34 deg."""
LIMITS = cython.declare(tuple, (POSITION_LIMITS, VELOCITY_LIMITS, YAW_LIMITS))
SPREAD_SPEED = cython.declare(cython.double, 0.5)
SPREAD_ACCEL = cython.declare(cython.double, 1.0)
SPREAD_RATE = cython.declare(cython.double, 0.08726646259971647)
"""At which what is spread comes to the estimate: m/s, m/s^2, rad/s (5 degrees). A filter that
follows within 0.3 s, as EKF2 and EKF3 do at 30 Hz, lags by half a gate at most."""
INFINITE = cython.declare(cython.double, float("inf"))
SMALL = cython.declare(cython.double, 1e-8)
"""Angle, rad, below which a half replaces sin(x / 2) / x: the next term is 1e-17."""


class Follower:
    """The messages of one stream: what they seem to do, and how they are sent.

    To read: of the last look at the estimate ``pos_n``, ``vel_n`` and sigmas, the ``step`` to it
    (dt, position, velocity and yaw; empty: none), and in which of these that is a jump (``jumps``);
    whether something is still to come to the estimate (``is_spreading``). To be written:
    ``samples``, by each inertial sample since the last look: angular rate (rad/s), specific force
    (m/s^2), in b; and ``place``, the follower's own map, or None (:meth:`express`).
    """

    def __init__(self, lag: float = 0.0, is_mean: bool = True) -> None:
        """Begin without a look.

        Args:
            lag: An inertial sample was true this long before its stamp, s: an estimate is carried
                on to the stamp by its last sample, which the next samples replace.
            is_mean: Whether a sample is the mean since the one before, not a reading at its time.
        """
        if not cython.compiled:
            self.numbers, self.sent = [0.0] * 55, [0.0] * 55
            self.pos_n, self.vel_n, self.squares = [0.0] * 3, [0.0] * 3, [0.0] * 3
            self.left_pos, self.left_vel, self.shift = [0.0] * 3, [0.0] * 3, [0.0] * 3
            self.C = [[0.0] * 3 for _ in range(3)]
            self.square = [[0.0] * 3 for _ in range(3)]
            self.cross = [[0.0] * 3 for _ in range(3)]
            self.half = [[0.0] * 3 for _ in range(3)]
        self.lag, self.is_mean = lag, is_mean
        self.samples: list[tuple[float, ...]] = []
        self.place: tuple[float, ...] | None = None
        self.step: tuple[float, ...] = ()
        self.jumps: tuple[bool, ...] = ()
        # Until the usual step is known, only what no follower takes is a jump
        for i in range(3):
            most = cython.cast(cython.double, LIMITS[i][1])
            self.squares[i] = (most / MANY) * (most / MANY)
        self.age = 0.0
        self.forget()
        self.clear(True)

    def forget(self) -> None:
        """Forget the last look: there is no estimate now."""
        self.last: tuple[float, ...] | None = None
        self.before: tuple[float, ...] | None = None
        self.t_ns = 0
        self.samples.clear()
        self.step = ()
        self.jumps = (False, False, False)

    def clear(self, frame_too: bool) -> None:
        """Send the estimate as it is, and in its own frame if that is meant too."""
        for i in range(3):
            self.left_pos[i] = self.left_vel[i] = 0.0
            if frame_too:
                self.shift[i] = 0.0
        self.left_yaw = 0.0
        self.is_spreading = False
        if frame_too:
            self.yaw = 0.0
            self.is_moved = False

    @property
    def offset(self) -> tuple[float, float, float, float]:
        """Where the frame c of what is sent lies in n: ``pos_n = R(yaw) pos_c + shift``."""
        return (self.shift[0], self.shift[1], self.shift[2], self.yaw)

    def look(
        self,
        t_ns: int,
        numbers: bytes,
        stated: tuple[float, float, float],
        relative: bytes | None = None,
    ) -> bool:
        """Look at an estimate; return whether a step to it was measured.

        Args:
            t_ns: Its stamp, ns.
            numbers: Those of its ODOMETRY.
            stated: One sigma of position (m), velocity (m/s) and yaw (rad) as sent with the look
                before; 0: of what was not aided. A step within it is no jump, nor is one of the
                position within three just after a start, when one fix is all there is: every gate
                has three sigma and more.
            relative: 21 numbers of 32 bits that take the place of the pose's covariance.
        """
        given = NUMBERS.unpack(numbers)
        for i in range(55):
            self.numbers[i] = given[i]
        if relative is not None:
            given = TRIANGLE.unpack(relative)
            for i in range(21):
                self.numbers[POSE + i] = given[i]
        n: cython.p_double = self.numbers
        self._rotate_from(n)
        for i in range(3):
            self.pos_n[i] = n[i]
            self.vel_n[i] = (
                self.C[i][0] * n[VELOCITY]
                + self.C[i][1] * n[VELOCITY + 1]
                + self.C[i][2] * n[VELOCITY + 2]
            )
        self._find_stds()
        last, before = self.last, self.before
        v: cython.p_double = self.vel_n
        now = (n[0], n[1], n[2], n[3], n[4], n[5], n[6], v[0], v[1], v[2])
        dt = (t_ns - self.t_ns) * 1e-9
        self.step = ()
        self.jumps = (False, False, False)
        count = len(self.samples)
        if count > 0:
            self.before = self.samples[count - 1]
            if last is not None and before is not None and t_ns > self.t_ns:
                # A reading at its time is the mean of the interval around it: it ends half of that
                ahead = self.lag if self.is_mean else self.lag - 0.5 * dt / count
                found = unexplained_step(last, now, self.samples, dt, before, ahead)
                self.step = (dt, *found)
            self.samples.clear()
        self.last = now
        self.t_ns = t_ns
        if len(self.step) == 0:
            return False
        self._decay(dt)
        self._judge(dt, stated)
        return True

    def _find_stds(self) -> None:
        """Find one sigma of what was looked at; infinite where none is known, 0 of no attitude."""
        n = self.numbers
        self.std_position = self.std_velocity = self.std_yaw = INFINITE
        if isfinite(n[POSE]) and isfinite(n[TWIST]):
            self.std_position = sqrt(n[POSE] + n[POSE + 6])
            self.std_velocity = sqrt(n[TWIST] + n[TWIST + 6] + n[TWIST + 11])
            self.std_yaw = sqrt(n[POSE + 20])
        largest = 0.0
        for i in range(3, 6):
            variance = n[POSE + triangle(i, i)]
            if isfinite(variance) and variance > largest:
                largest = variance
        self.std_attitude: float = sqrt(largest)

    def std_ground_speed(self) -> float:
        """Return one sigma of the velocity over ground, both axes, m/s; infinite if not known."""
        for i in range(55):
            self.sent[i] = self.numbers[i]
        self._turn_velocity()
        variance = self.sent[TWIST] + self.sent[TWIST + 6]
        return sqrt(variance) if isfinite(self.sent[TWIST]) else INFINITE

    def _judge(self, dt: float, stated: tuple[float, float, float]) -> None:
        """Find what of the step is a jump: many times the usual, which is learnt, between bounds.

        At the lower no follower refuses it; at the upper one of them does, however noisy the
        receiver.
        """
        step = self.step
        weight = min(dt / USUAL_TIME, 1.0)
        beyond = max(dt - SMOOTH_TIME, 0.0)
        self.age += dt
        jumps = []
        for i in range(3):
            least, most, slow = LIMITS[i]
            if i < 2:
                x = cython.cast(cython.double, step[3 * i + 1])
                y = cython.cast(cython.double, step[3 * i + 2])
                z = cython.cast(cython.double, step[3 * i + 3])
                size = sqrt(x * x + y * y + z * z)
            else:
                size = fabs(step[7])
            within = cython.cast(cython.double, stated[i])
            if i == 0 and self.age < START_TIME:
                within = 3.0 * within
            usual = MANY * sqrt(self.squares[i])
            largest = max(min(max(float(least), usual), float(most)), within)
            largest += float(slow) * (beyond * beyond if i == 0 else beyond)
            jumps.append(size > largest)
            size = min(size, largest)
            self.squares[i] += weight * (size * size - self.squares[i])
        self.jumps = tuple(jumps)

    def _decay(self, dt: float) -> None:
        """Let what is spread come nearer to the estimate over a time, s."""
        if not self.is_spreading:
            return
        self.is_spreading = shorten(self.left_pos, SPREAD_SPEED * dt)
        if shorten(self.left_vel, SPREAD_ACCEL * dt):
            self.is_spreading = True
        self.left_yaw = copysign(max(fabs(self.left_yaw) - SPREAD_RATE * dt, 0.0), self.left_yaw)
        if self.left_yaw != 0.0:
            self.is_spreading = True

    def spread(self, position: bool, velocity: bool, yaw: bool) -> None:
        """Keep the step from what is sent, in those of its parts that are named."""
        for i in range(3):
            if position:
                self.left_pos[i] -= cython.cast(cython.double, self.step[1 + i])
            if velocity:
                self.left_vel[i] -= cython.cast(cython.double, self.step[4 + i])
        if yaw:
            self.left_yaw = remainder(self.left_yaw - self.step[7], TWO_PI)
        if position or velocity or yaw:
            self.is_spreading = True

    def move_frame(self) -> None:
        """Put the step of position and yaw into the frame."""
        c = cos(-self.yaw)
        s = sin(-self.yaw)
        x = self.pos_n[0] - cython.cast(cython.double, self.step[1]) - self.shift[0]
        y = self.pos_n[1] - cython.cast(cython.double, self.step[2]) - self.shift[1]
        z = self.pos_n[2] - cython.cast(cython.double, self.step[3]) - self.shift[2]
        north = c * x - s * y
        east = s * x + c * y
        self.yaw = remainder(self.yaw + self.step[7], TWO_PI)
        c = cos(self.yaw)
        s = sin(self.yaw)
        self.shift[0] = self.pos_n[0] - (c * north - s * east)
        self.shift[1] = self.pos_n[1] - (s * north + c * east)
        self.shift[2] = self.pos_n[2] - z
        self.is_moved = self.yaw != 0.0 or self.shift[0] != 0.0
        if self.shift[1] != 0.0 or self.shift[2] != 0.0:
            self.is_moved = True

    def express(self, climb: float, errors: float, is_local: bool) -> bytes:
        """Return the numbers to send of the estimate that was looked at last.

        Args:
            climb: Factor on the variance of the velocity down.
            errors: Factor on the covariances of position and velocity.
            is_local: Whether velocity and its covariance are to be along the axes of the frame, not
                of b.

        Its ``place``, if there is one, is a map that the follower finds positions on by its own
        sphere: whether that is an azimuthal projection; radius (m); latitude, longitude (rad) and
        altitude of the estimate's origin, and metres per radian of both there; and those of the
        place that the follower counts from.
        """
        for i in range(55):
            self.sent[i] = self.numbers[i]
        if climb != 1.0:
            self._scale_climb(climb)
        if errors != 1.0:
            self._scale_errors(POSE, sqrt(errors))
            self._scale_errors(TWIST, sqrt(errors))
        if self.is_spreading or self.is_moved:
            self._add_left()
        if self.place is not None:
            self._put_in_place(self.place)
        if is_local:
            self._turn_velocity()
        return NUMBERS.pack(*[self.sent[i] for i in range(55)])

    def _rotate_from(self, n: cython.p_double) -> None:
        """Write the matrix of the quaternion among some numbers."""
        w = n[QUATERNION]
        x = n[QUATERNION + 1]
        y = n[QUATERNION + 2]
        z = n[QUATERNION + 3]
        C = self.C
        C[0][0] = w * w + x * x - y * y - z * z
        C[0][1] = 2.0 * (x * y - w * z)
        C[0][2] = 2.0 * (x * z + w * y)
        C[1][0] = 2.0 * (x * y + w * z)
        C[1][1] = w * w - x * x + y * y - z * z
        C[1][2] = 2.0 * (y * z - w * x)
        C[2][0] = 2.0 * (x * z - w * y)
        C[2][1] = 2.0 * (y * z + w * x)
        C[2][2] = w * w - x * x - y * y + z * z

    def _scale_climb(self, factor: float) -> None:
        """Multiply the variance of the velocity down.

        The covariance is along the axes of b, of which none points down while the vehicle is
        tilted: what is added to it is along down, so that the velocity over ground stays as exact
        as it was.
        """
        n = self.sent
        if not isfinite(n[TWIST]):
            return
        self._rotate_from(n)
        down_b = self.C[2]
        variance = 0.0
        for i in range(3):
            along = 0.0
            for j in range(3):
                along += n[TWIST + triangle(min(i, j), max(i, j))] * down_b[j]
            variance += down_b[i] * along
        for i in range(3):
            for j in range(i, 3):
                k = TWIST + triangle(i, j)
                n[k] = single(n[k] + (factor - 1.0) * variance * down_b[i] * down_b[j])

    def _scale_errors(self, start: int, root: float) -> None:
        """Multiply the first three errors of a covariance."""
        n = self.sent
        if not isfinite(n[start]):
            return
        for i in range(3):
            for j in range(i, 6):
                k = start + triangle(i, j)
                n[k] = single(n[k] * (root * root if j < 3 else root))

    def _add_left(self) -> None:
        """Add what is to come to the estimate yet, in the frame that is sent.

        The variances grow by the square of what is added.
        """
        n = self.sent
        c = cos(-self.yaw)
        s = sin(-self.yaw)
        for i in range(3):
            n[i] = self.left_pos[i] + self.pos_n[i] - self.shift[i]
        x = c * n[0] - s * n[1]
        n[1] = s * n[0] + c * n[1]
        n[0] = x

        # Turn about down
        angle = self.left_yaw - self.yaw
        turned = sqrt(angle * angle)
        cosine = cos(0.5 * turned)
        sine = angle * (0.5 if turned < SMALL else sin(0.5 * turned) / turned)
        qw = cosine * n[3] - sine * n[6]
        qx = cosine * n[4] - sine * n[5]
        qy = cosine * n[5] + sine * n[4]
        qz = cosine * n[6] + sine * n[3]
        norm = sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        norm = -norm if qw < 0.0 else norm
        n[3] = qw / norm
        n[4] = qx / norm
        n[5] = qy / norm
        n[6] = qz / norm
        self._rotate_from(n)

        # The velocity along the axes of b, and what was added to it
        x = self.left_vel[0] + self.vel_n[0]
        y = self.left_vel[1] + self.vel_n[1]
        z = self.left_vel[2] + self.vel_n[2]
        for i in range(3):
            first = self.C[0][i] * c + self.C[1][i] * s
            second = self.C[1][i] * c - self.C[0][i] * s
            third = self.C[2][i]
            n[VELOCITY + i] = first * x + second * y + third * z
            added = first * self.left_vel[0] + second * self.left_vel[1] + third * self.left_vel[2]
            if isfinite(n[TWIST]):
                n[TWIST + triangle(i, i)] += added * added
        if self.yaw != 0.0:
            C = self.C
            C[0][0] = C[1][1] = c
            C[1][0] = s
            C[0][1] = -s
            C[0][2] = C[1][2] = C[2][0] = C[2][1] = 0.0
            C[2][2] = 1.0
            self._turn_rows(POSE)
        if isfinite(n[POSE]):
            x = c * self.left_pos[0] - s * self.left_pos[1]
            y = s * self.left_pos[0] + c * self.left_pos[1]
            n[POSE] += x * x
            n[POSE + 6] += y * y
            n[POSE + 11] += self.left_pos[2] * self.left_pos[2]
            n[POSE + 20] += self.left_yaw * self.left_yaw
        for i in range(55):
            n[i] = single(n[i])

    def _put_in_place(self, place: tuple[float, ...]) -> None:
        """Write the position as metres of the follower's own map."""
        n = self.sent
        azimuthal, radius, lat, lon, alt, to_north, to_east, lat_0, lon_0, alt_0 = place
        lat = float(lat) + n[0] / float(to_north)
        lon = float(lon) + n[1] / float(to_east)
        n[2] = single(float(alt_0) - (float(alt) - n[2]))
        project(n, azimuthal != 0.0, radius, lat, lon, lat_0, lon_0)

    def _turn_velocity(self) -> None:
        """Write velocity, and the covariance of that, along the local axes."""
        n = self.sent
        self._rotate_from(n)
        x = n[VELOCITY]
        y = n[VELOCITY + 1]
        z = n[VELOCITY + 2]
        for i in range(3):
            n[VELOCITY + i] = single(self.C[i][0] * x + self.C[i][1] * y + self.C[i][2] * z)
        self._turn_rows(TWIST)
        for i in range(15):
            n[TWIST + i] = single(n[TWIST + i])

    def _turn_rows(self, start: int) -> None:
        """Turn the first three errors of a covariance by the matrix C."""
        n = self.sent
        C = self.C
        is_crossed = cython.declare(cython.bint, False)
        if not isfinite(n[start]):
            return
        for i in range(3):
            for j in range(3):
                self.square[i][j] = n[start + triangle(min(i, j), max(i, j))]
                self.cross[i][j] = n[start + triangle(i, 3 + j)]
                if self.cross[i][j] != 0.0:
                    is_crossed = True
        for i in range(3):
            for j in range(3):
                a = self.square[j]
                self.half[i][j] = a[0] * C[i][0] + a[1] * C[i][1] + a[2] * C[i][2]
        for i in range(3):
            for j in range(i, 3):
                a = self.half[i]
                n[start + triangle(i, j)] = C[j][0] * a[0] + C[j][1] * a[1] + C[j][2] * a[2]
            for j in range(3 if is_crossed else 0):
                x = self.cross[0][j] * C[i][0]
                y = self.cross[1][j] * C[i][1]
                z = self.cross[2][j] * C[i][2]
                n[start + triangle(i, 3 + j)] = x + y + z


def triangle(row: int, column: int) -> int:
    """Return the place of an element in the upper triangle of a 6 x 6 matrix, row by row."""
    return row * (11 - row) // 2 + column


def single(value: float) -> float:
    """Return a number as 32 bits hold it."""
    if not cython.compiled:
        return float(_SINGLE.unpack(_SINGLE.pack(value))[0])
    return cython.cast(cython.float, value)


def shorten(vector: cython.p_double, by: float) -> bool:
    """Make a vector shorter; return whether anything is left of it."""
    x = vector[0]
    y = vector[1]
    z = vector[2]
    length = sqrt(x * x + y * y + z * z)
    scale = 1.0 - by / length if length > by else 0.0
    for i in range(3):
        vector[i] = vector[i] * scale
    return vector[0] != 0.0 or vector[1] != 0.0 or vector[2] != 0.0


def project(
    n: cython.p_double,
    is_azimuthal: bool,
    radius: float,
    lat: float,
    lon: float,
    lat_0: float,
    lon_0: float,
) -> None:
    """Write metres north and east of an origin, as :mod:`ekf_companion.nav.projection` does.

    ``is_azimuthal`` tells which of the two.
    """
    dlon = lon - lon_0
    if is_azimuthal:
        north = cos(lat_0) * sin(lat) - sin(lat_0) * cos(lat) * cos(dlon)
        east = cos(lat) * sin(dlon)
        along = sin(lat_0) * sin(lat) + cos(lat_0) * cos(lat) * cos(dlon)
        across = hypot(north, east)
        scale = atan2(across, along) / across if across > 0.0 else 1.0
        n[0] = single(radius * scale * north)
        n[1] = single(radius * scale * east)
        return
    dlon = fmod(dlon + PI, TWO_PI)
    dlon = (dlon + TWO_PI if dlon < 0.0 else dlon) - PI
    scale = cos(0.5 * (lat + lat_0))
    n[0] = single(radius * (lat - lat_0))
    n[1] = single(radius * scale * dlon)
