"""One filter of the yaw bank: a hypothesis of the yaw of the bank's frame s.

Its state is the velocity (north, east), the yaw psi of s against north, the tilt phi of s about
its axes x and y, the error b of the bank's gyro bias, and how much later than its stamp a fix is,
d. With the sums between two fixes, of force u and of turn G = int C_sb dt, both in s:

``v += R(psi) (u_x + phi_y u_z, u_y - phi_x u_z)``; ``(phi_x, phi_y, psi) -= G b``.

With the acceleration a and the antenna's extra velocity l, both in s, a fix reads
``v + R(psi) (l - d a)``.

Source: Groves 2013, chapter 14 (transfer alignment by velocity); second-order term: Maybeck 1982,
vol. 2, section 12.3.
"""

from __future__ import annotations

import cython
from cython.cimports.ekf_companion.core.filter.rotation import wrap
from cython.cimports.ekf_companion.core.memory.enums import YAW_N
from cython.cimports.ekf_companion.core.memory.scratch import YawUpdate
from cython.cimports.ekf_companion.core.memory.state import YawBank, YawFilter
from cython.cimports.libc.math import cos, log, sin

TILT_STD = cython.declare(cython.double, 0.3)
"""One sigma of a tilt taken from the mean force, rad: it may have been in a turn, or taking off."""
FORCE_NOISE = cython.declare(cython.double, 0.35)
"""White noise of the horizontal force, m/s^2 per square root of Hz: biases, vibration and slow
errors of GNSS velocity. What is felt must be more than that to say where north is."""
TILT_WALK = cython.declare(cython.double, 5e-3)
"""rad per square root of s: an accelerometer's bias that turns with the body."""
YAW_WALK = cython.declare(cython.double, 1e-2)
"""rad per square root of s: the gyro's scale, which its bias does not explain."""


def start(
    f: YawFilter, vn: float, ve: float, variance: float, bias_std: float, delay_std: float
) -> None:
    """Begin at a velocity of this variance, level within TILT_STD."""
    f.weight = 0.0
    for i in range(YAW_N):
        f.x[i] = 0.0
        for j in range(YAW_N):
            f.P[i][j] = 0.0
    f.x[0] = vn
    f.x[1] = ve
    for i in range(2):
        f.P[i][i] = variance
        f.P[i + 3][i + 3] = TILT_STD * TILT_STD
    for i in range(5, 8):
        f.P[i][i] = bias_std * bias_std
    f.P[8][8] = delay_std * delay_std


def set_state(f: YawFilter, i: int, value: float, variance: float) -> None:
    """Set state i, uncorrelated with all others."""
    for j in range(YAW_N):
        f.P[i][j] = 0.0
        f.P[j][i] = 0.0
    f.x[i] = value
    f.P[i][i] = variance


def predict(f: YawFilter, b: YawBank, gyro_bias_walk: float, u: YawUpdate) -> None:
    """Predict over the interval that the bank's sums stand for."""
    uz = b.sums.dv[2]
    for i in range(3):  # the turn of s by the bias, about x, y and z
        u.turned[i] = (
            b.sums.turn[i][0] * f.x[5] + b.sums.turn[i][1] * f.x[6] + b.sums.turn[i][2] * f.x[7]
        )
    # The force in n, by the mean yaw and tilt of the interval
    yaw = f.x[2] - 0.5 * u.turned[2]
    s = sin(yaw)
    c = cos(yaw)
    ux = b.sums.dv[0] + (f.x[4] - 0.5 * u.turned[1]) * uz
    uy = b.sums.dv[1] - (f.x[3] - 0.5 * u.turned[0]) * uz
    dn = c * ux - s * uy
    de = s * ux + c * uy
    f.x[0] += dn
    f.x[1] += de
    f.x[2] = wrap(f.x[2] - u.turned[2])
    f.x[3] -= u.turned[0]
    f.x[4] -= u.turned[1]

    # F - I: velocity by yaw, tilt and (half the interval late) bias; yaw and tilt by bias
    for i in range(5):
        for j in range(YAW_N):
            u.F[i][j] = 0.0
    u.F[0][2] = -de
    u.F[0][3] = s * uz
    u.F[0][4] = c * uz
    u.F[1][2] = dn
    u.F[1][3] = -c * uz
    u.F[1][4] = s * uz
    for j in range(3):
        for i in range(2):
            u.F[i][5 + j] = -0.5 * (
                u.F[i][2] * b.sums.turn[2][j]
                + u.F[i][3] * b.sums.turn[0][j]
                + u.F[i][4] * b.sums.turn[1][j]
            )
        u.F[2][5 + j] = -b.sums.turn[2][j]
        u.F[3][5 + j] = -b.sums.turn[0][j]
        u.F[4][5 + j] = -b.sums.turn[1][j]
    propagate_covariance(f, u, b.sums.dt, gyro_bias_walk, dn * dn + de * de)


def propagate_covariance(
    f: YawFilter, u: YawUpdate, dt: float, gyro_bias_walk: float, gained: float
) -> None:
    """Propagate P likewise: F P F' + Q; gained is the square of the velocity gained."""
    yaw = f.P[2][2]
    # rows, then columns, each from what is still old
    for i in range(5):
        for j in range(YAW_N):
            s = 0.0
            for r in range(2 if i < 2 else 5, 8):
                s += u.F[i][r] * f.P[r][j]
            f.P[i][j] += s
    for i in range(YAW_N):
        for j in range(5):
            s = 0.0
            for r in range(2 if j < 2 else 5, 8):
                s += u.F[j][r] * f.P[i][r]
            f.P[i][j] += s
    # what the turn of the force by yaw has of second order is noise to a filter of first order
    s = FORCE_NOISE * FORCE_NOISE * dt + 0.5 * yaw * yaw * gained
    f.P[0][0] += s
    f.P[1][1] += s
    f.P[2][2] += YAW_WALK * YAW_WALK * dt
    for i in range(3, 5):
        f.P[i][i] += TILT_WALK * TILT_WALK * dt
    for i in range(5, 8):
        f.P[i][i] += gyro_bias_walk * gyro_bias_walk * dt


def project(f: YawFilter, b: YawBank, u: YawUpdate) -> None:
    """Write what a fix adds to the velocity, R(psi) (l - d a), and P H'.

    ``H = (1, 0, -e, 0 ... -a_n; 0, 1, n, 0 ... -a_e)`` with (n, e) that addition.
    """
    s = sin(f.x[2])
    c = cos(f.x[2])
    ax = b.accel[0]
    ay = b.accel[1]
    lx = u.arm_vel[0] - f.x[8] * ax
    ly = u.arm_vel[1] - f.x[8] * ay
    n = c * lx - s * ly
    e = s * lx + c * ly
    an = c * ax - s * ay
    ae = s * ax + c * ay
    u.added[0] = n
    u.added[1] = e
    u.accel_n[0] = an
    u.accel_n[1] = ae
    for i in range(YAW_N):
        u.PHt[i][0] = f.P[i][0] - e * f.P[i][2] - an * f.P[i][8]
        u.PHt[i][1] = f.P[i][1] + n * f.P[i][2] - ae * f.P[i][8]


def innovate(f: YawFilter, b: YawBank, u: YawUpdate, n: int, variance: float) -> float:
    """Return the normalised innovation squared of the velocity ``u.vel_n`` (2 degrees of freedom).

    Leaves the innovation of filter n, the inverse of its covariance and its log-likelihood.
    """
    project(f, b, u)
    nn = u.PHt[0][0] - u.added[1] * u.PHt[2][0] - u.accel_n[0] * u.PHt[8][0] + variance
    ne = u.PHt[0][1] - u.added[1] * u.PHt[2][1] - u.accel_n[0] * u.PHt[8][1]
    ee = u.PHt[1][1] + u.added[0] * u.PHt[2][1] - u.accel_n[1] * u.PHt[8][1] + variance
    det = nn * ee - ne * ne
    u.z[n][0] = u.vel_n[0] - f.x[0] - u.added[0]
    u.z[n][1] = u.vel_n[1] - f.x[1] - u.added[1]
    u.S_inv[n][0] = ee / det
    u.S_inv[n][1] = -ne / det
    u.S_inv[n][2] = nn / det
    nis = u.z[n][0] * u.z[n][0] * u.S_inv[n][0] + u.z[n][1] * u.z[n][1] * u.S_inv[n][2]
    nis += 2.0 * u.z[n][0] * u.z[n][1] * u.S_inv[n][1]
    u.log_likelihood[n] = -0.5 * (nis + log(det))
    return nis


def apply_update(f: YawFilter, b: YawBank, u: YawUpdate, n: int) -> None:
    """Correct filter n by its innovation: P -= (P H') S^-1 (P H')'."""
    project(f, b, u)
    for i in range(YAW_N):
        gain_n = u.PHt[i][0] * u.S_inv[n][0] + u.PHt[i][1] * u.S_inv[n][1]
        gain_e = u.PHt[i][0] * u.S_inv[n][1] + u.PHt[i][1] * u.S_inv[n][2]
        f.x[i] += gain_n * u.z[n][0] + gain_e * u.z[n][1]
        for j in range(i, YAW_N):
            f.P[i][j] -= gain_n * u.PHt[j][0] + gain_e * u.PHt[j][1]
            f.P[j][i] = f.P[i][j]
    f.x[2] = wrap(f.x[2])
