"""Sigma points on the manifold: drawn about a state, integrated together, and averaged again.

The points are a :class:`~ekf_companion.filters.strapdown.Nominal` whose arrays have them as their
first axis. For each column of a root of the covariance there is a point on either side of the
middle; the middle itself is the first point.

Source: Julier 2002, "The scaled unscented transformation"; Hauberg, Lauze, Pedersen 2013,
"Unscented Kalman filtering on Riemannian manifolds"; Brossard, Barrau, Bonnabel 2020, "A code for
unscented Kalman filtering on manifolds (UKF-M)", arXiv 2002.00878.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.filters.gauss_newton import nearest_factor
from ekf_companion.filters.strapdown import ATT, Earth, Interval, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

SPREAD = float(np.sqrt(3.0))
"""Distance of the points in sigmas: there the fourth moment along each axis is the Gaussian's. The
15 axes together do not change that, as all but three of them are linear."""
REACH = 0.5 * float(np.pi)
"""Largest turn of a point, rad; where SPREAD sigmas are more, it is drawn nearer. At a quarter turn
the sine is largest: further out, points of an angle with a sigma of 60 to 104 degrees (nothing
known) would show less of its effect, and at half a turn nothing at all."""
_BETA = 2.0
_LEAST = 1e-12
"""Least eigenvalue of a correlation matrix that counts as positive definite."""
_SETTLED = 1e-9
"""Step at which the mean has converged, rad: what is left then is 1e-9 of the spread."""
_ROUNDS = 20

_ONE = np.eye(4)
_PRODUCT = so3.multiply(_ONE[:, None, :], _ONE[None, :, :]).reshape(16, 4)
"""Quaternion product as a bilinear form: one matrix product for all points, in a twentieth of the
time of ``so3.multiply``."""
_SQUARES = so3.to_matrix(_ONE)
_MATRIX = 0.5 * (
    so3.to_matrix(_ONE[:, None, :] + _ONE[None, :, :]) - _SQUARES[:, None] - _SQUARES[None, :]
).reshape(16, 9)
"""Direction cosine matrix as a quadratic form, likewise."""


def root(P: Array) -> tuple[Array, bool]:
    """Return a square root of a symmetric (15, 15) matrix, and whether it had to be repaired.

    The attitude comes first and the root is lower triangular, so only three of its columns turn the
    body; the other points differ by what is linear. A matrix that is not positive definite gets the
    root of the nearest one (eigenvalues of its correlation matrix no smaller than 1e-12).
    """
    try:
        return np.asarray(np.linalg.cholesky(P)), False
    except np.linalg.LinAlgError:
        return nearest_factor(P, _LEAST), True


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SigmaPoints:
    """Sigma points as error states, the middle first, and their weights."""

    dx: Array
    """Shape (31, 15)."""
    mean: Array
    """Weights of the mean, shape (31,)."""
    covariance: Array
    """Weights of the covariance: scaled, with beta 2. About a mean that has converged no
    covariance has a negative eigenvalue, though the middle weighs 1 - a < 0: let e be its error.
    The others, of weight a together, have the mean e (a - 1) / a, so they contribute at least
    e e' (a - 1)^2 / a; the middle subtracts e e' (a + 1/a - 2 - beta), less by beta e e'."""
    is_repaired: bool
    """The covariance was not positive definite."""


def draw(P: Array) -> SigmaPoints:
    """Draw points of a covariance, shape (15, 15), about the error state 0."""
    S, is_repaired = root(P)
    turns = np.sqrt((S[ATT] * S[ATT]).sum(axis=0))
    spread = np.minimum(SPREAD, REACH / np.maximum(turns, REACH / SPREAD))
    out = (S * spread).T
    weights = np.empty(2 * N + 1)
    weights[1 : N + 1] = weights[N + 1 :] = 0.5 / (spread * spread)
    a = 2.0 * float(weights[1 : N + 1].sum())
    weights[0] = 1.0 - a
    scaled = weights.copy()
    scaled[0] += 1.0 - 1.0 / a + _BETA
    dx = np.concatenate([np.zeros((1, N)), out, -out])
    return SigmaPoints(dx=dx, mean=weights, covariance=scaled, is_repaired=is_repaired)


def add(state: Nominal, dx: Array) -> Nominal:
    """Add an error state per point to one state, as :meth:`Nominal.plus`."""
    return Nominal(
        q_nb=_exp(dx[:, :3]) @ _left(state.q_nb),
        vel_n=state.vel_n + dx[:, 3:6],
        pos_n=state.pos_n + dx[:, 6:9],
        gyro_bias=state.gyro_bias + dx[:, 9:12],
        accel_bias=state.accel_bias + dx[:, 12:],
    )


def average(points: Nominal, weights: Array) -> tuple[Nominal, Array]:
    """Return the weighted mean of the points, and the error state from there to each, (31, 15).

    The mean attitude is the one from which the weighted rotation vectors cancel (Hauberg).
    """
    rest = np.concatenate([points.vel_n, points.pos_n, points.gyro_bias, points.accel_bias], axis=1)
    # About the middle point: numbers of a kilometre would cost digits under weights of -4
    away = rest - rest[0]
    mean = weights @ away
    dx = np.empty((len(rest), N))
    dx[:, 3:] = away - mean
    middle = rest[0] + mean
    q_nb = points.q_nb[0]
    for _ in range(_ROUNDS):
        turns = so3.log(points.q_nb @ _left(so3.conjugate(q_nb)))
        step = weights @ turns
        if float(step @ step) < _SETTLED * _SETTLED:
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


def integrate(points: Nominal, over: Interval, earth: Earth) -> Nominal:
    """Integrate every point: :func:`ekf_companion.filters.strapdown.integrate_strapdown`."""
    dt = over.dt
    # (v C)_j = sum_i v_i C_ij: the Earth's rate in b
    rate_n_b = (_matrices(points.q_nb) * earth.rate_n[:, None]).sum(axis=1)
    half = _exp((over.gyro - points.gyro_bias - rate_n_b) * (0.5 * dt))
    q_mid = _products(points.q_nb, half)
    force_b = over.accel - points.accel_bias
    accel_n = (_matrices(q_mid) @ force_b[:, :, None])[:, :, 0]
    accel_n += points.vel_n @ (-2.0 * so3.skew(earth.rate_n).T)
    accel_n[:, 2] += earth.gravity + earth.gradient * points.pos_n[:, 2]
    return Nominal(
        q_nb=_products(q_mid, half),
        vel_n=points.vel_n + accel_n * dt,
        pos_n=points.pos_n + points.vel_n * dt + accel_n * (0.5 * dt * dt),
        gyro_bias=points.gyro_bias,
        accel_bias=points.accel_bias,
    )


def _exp(phi: Array) -> Array:
    """Return the quaternions of rotation vectors, shape (k, 4); ``so3.exp`` but for rounding."""
    half = 0.5 * np.sqrt((phi * phi).sum(axis=1))
    q = np.empty((len(phi), 4))
    np.cos(half, out=q[:, 0])
    # sinc is sin(pi x) / (pi x), 1 at zero
    q[:, 1:] = phi * (0.5 * np.sinc(half / np.pi))[:, None]
    return q


def _products(p: Array, q: Array) -> Array:
    """Return the products of quaternions row by row, shape (k, 4)."""
    return np.asarray((p[:, :, None] * q[:, None, :]).reshape(-1, 16) @ _PRODUCT)


def _matrices(q: Array) -> Array:
    """Return the direction cosine matrices, shape (k, 3, 3)."""
    return np.asarray(((q[:, :, None] * q[:, None, :]).reshape(-1, 16) @ _MATRIX).reshape(-1, 3, 3))


def _left(q: Array) -> Array:
    """Return the matrix M with which rows p become q p = p M, shape (4, 4)."""
    w, x, y, z = q.tolist()
    return np.array([[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]])
