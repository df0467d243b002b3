"""Sigma points on the manifold: drawn about a state, moved together, and gathered again.

A cloud is a :class:`~ekf_companion.filters.strapdown.Nominal` whose arrays have the points as their
first axis. Two points stand on either side of the middle for each column of a root of the
covariance, ``SPREAD`` sigmas away; the middle itself is the first point.

Source: Julier 2002, "The scaled unscented transformation"; Hauberg, Lauze, Pedersen 2013,
"Unscented Kalman filtering on Riemannian manifolds"; Brossard, Barrau, Bonnabel 2020, "A code for
unscented Kalman filtering on manifolds (UKF-M)", arXiv 2002.00878.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.strapdown import ATT, Earth, Interval, N, Nominal, skew
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

POINTS = 2 * N + 1
SPREAD = float(np.sqrt(3.0))
"""How far out the points are, in sigmas: there the fourth moment along each axis is the Gaussian's.
And of a heading of which nothing is known (uniform: sigma pi / sqrt(3)) they reach half a turn;
further out they would come round the circle, so the alpha of 1, sqrt(15) sigmas, is of no use."""
_SHARE = 0.5 / SPREAD**2
_ALPHA2 = SPREAD**2 / N
MEAN_WEIGHTS = np.full(POINTS, _SHARE)
"""Of the points in their mean, shape (31,)."""
MEAN_WEIGHTS[0] = 1.0 - 2 * N * _SHARE
WEIGHTS = MEAN_WEIGHTS.copy()
"""Of the points in their covariance: scaled, beta 2. About a mean that has been found no covariance
can have a negative eigenvalue, though the middle's weight is negative: the 30 others, whose mean is
4/5 of the middle's error e, bring at least 5 (4/5)^2 e e' = 3.2 e e', the middle takes 1.2."""
WEIGHTS[0] += 1.0 - _ALPHA2 + 2.0
_LEAST = 1e-12
"""Smallest eigenvalue of a correlation matrix that is still taken for one."""
_STILL = 1e-9
"""Step at which the mean has been found, rad: what is left then is 1e-9 of the spread."""
_ROUNDS = 20

_ONE = np.eye(4)
_PRODUCT = so3.multiply(_ONE[:, None, :], _ONE[None, :, :]).reshape(16, 4)
"""Quaternion product as a bilinear form: one matrix product for all points."""
_SQUARES = so3.to_matrix(_ONE)
_MATRIX = 0.5 * (
    so3.to_matrix(_ONE[:, None, :] + _ONE[None, :, :]) - _SQUARES[:, None] - _SQUARES[None, :]
).reshape(16, 9)
"""Direction cosine matrix as a quadratic form."""


def root(P: Array) -> tuple[Array, bool]:
    """Give a square root of a covariance, and whether it had to be mended to have one.

    The attitude comes first and the root is lower triangular, so only three of its columns turn the
    body; the other points differ by what is linear. A matrix that is not positive definite gets the
    root of the nearest one (eigenvalues of its correlation matrix no smaller than 1e-12).

    Args:
        P: Symmetric, shape (15, 15).
    """
    try:
        return np.asarray(np.linalg.cholesky(P)), False
    except np.linalg.LinAlgError:
        sigma = np.sqrt(np.maximum(np.diagonal(P), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(P / np.outer(sigma, sigma))
        S = sigma[:, None] * vectors * np.sqrt(np.maximum(values, _LEAST))
        return np.asarray(S), True


def offsets(S: Array) -> Array:
    """Give the error states of the points for a root of the covariance, shape (31, 15)."""
    out = SPREAD * S.T
    return np.concatenate([np.zeros((1, N)), out, -out])


def scatter(state: Nominal, dx: Array) -> Nominal:
    """Add an error state per point to one state, as :meth:`Nominal.plus`."""
    return Nominal(
        q_nb=exp(dx[:, :3]) @ _left(state.q_nb),
        vel_n=state.vel_n + dx[:, 3:6],
        pos_n=state.pos_n + dx[:, 6:9],
        gyro_bias=state.gyro_bias + dx[:, 9:12],
        accel_bias=state.accel_bias + dx[:, 12:],
    )


def gather(cloud: Nominal) -> tuple[Nominal, Array]:
    """Give the mean of the points, and the error state from there to each, shape (31, 15).

    The mean attitude is the one from which the weighted rotation vectors cancel (Hauberg).
    """
    rest = np.concatenate([cloud.vel_n, cloud.pos_n, cloud.gyro_bias, cloud.accel_bias], axis=1)
    # About the middle point: numbers of a kilometre would cost digits under weights of -4
    away = rest - rest[0]
    mean = MEAN_WEIGHTS @ away
    dx = np.empty((len(rest), N))
    dx[:, 3:] = away - mean
    middle = rest[0] + mean
    q_nb = cloud.q_nb[0]
    for _ in range(_ROUNDS):
        turns = log(cloud.q_nb @ _left(so3.conjugate(q_nb)))
        step = MEAN_WEIGHTS @ turns
        if float(step @ step) < _STILL * _STILL:
            break
        q_nb = so3.multiply(q_nb, so3.exp(step))
    dx[:, ATT] = turns
    state = Nominal(
        q_nb=so3.normalise(q_nb),
        vel_n=middle[:3],
        pos_n=middle[3:6],
        gyro_bias=middle[6:9],
        accel_bias=middle[9:],
    )
    return state, dx


def move(cloud: Nominal, over: Interval, earth: Earth) -> Nominal:
    """Carry every point over an interval: :func:`ekf_companion.filters.strapdown.move`."""
    dt = over.dt
    # (v C)_j = sum_i v_i C_ij: the Earth's rate as the body sees it
    rate_n_b = (matrix(cloud.q_nb) * earth.rate_n[:, None]).sum(axis=1)
    half = exp((over.gyro - cloud.gyro_bias - rate_n_b) * (0.5 * dt))
    q_mid = multiply(cloud.q_nb, half)
    force_b = over.accel - cloud.accel_bias
    accel_n = (matrix(q_mid) @ force_b[:, :, None])[:, :, 0]
    accel_n += cloud.vel_n @ (-2.0 * skew(earth.rate_n).T)
    accel_n[:, 2] += earth.gravity + earth.gradient * cloud.pos_n[:, 2]
    return Nominal(
        q_nb=multiply(q_mid, half),
        vel_n=cloud.vel_n + accel_n * dt,
        pos_n=cloud.pos_n + cloud.vel_n * dt + accel_n * (0.5 * dt * dt),
        gyro_bias=cloud.gyro_bias,
        accel_bias=cloud.accel_bias,
    )


def multiply(p: Array, q: Array) -> Array:
    """Give the products of quaternions row by row, shape (k, 4)."""
    return np.asarray((p[:, :, None] * q[:, None, :]).reshape(-1, 16) @ _PRODUCT)


def matrix(q: Array) -> Array:
    """Give the direction cosine matrices, shape (k, 3, 3)."""
    return np.asarray(((q[:, :, None] * q[:, None, :]).reshape(-1, 16) @ _MATRIX).reshape(-1, 3, 3))


def exp(phi: Array) -> Array:
    """Give the quaternions of rotation vectors, shape (k, 4)."""
    half = 0.5 * np.sqrt((phi * phi).sum(axis=1))
    q = np.empty((len(phi), 4))
    np.cos(half, out=q[:, 0])
    # sinc is sin(pi x) / (pi x) and knows zero
    q[:, 1:] = phi * (0.5 * np.sinc(half / np.pi))[:, None]
    return q


def log(q: Array) -> Array:
    """Give the rotation vectors of the shorter way, rad, shape (k, 3)."""
    size = np.sqrt((q[:, 1:] * q[:, 1:]).sum(axis=1))
    angle = 2.0 * np.arctan2(size, np.abs(q[:, 0]))
    scale = np.where(size < 1e-8, 2.0, angle / np.maximum(size, 1e-8))
    return np.asarray(q[:, 1:] * np.copysign(scale, q[:, 0])[:, None])


def _left(q: Array) -> Array:
    """Give the matrix M with which rows p become q p = p M, shape (4, 4)."""
    w, x, y, z = q.tolist()
    return np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
