"""A lidar in a room of known walls: thousands of point-to-plane rows in one update."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.gauss_newton import Correction, Form, Manifold, Rows, correct
from ekf_companion.filters.strapdown import ATT, POS, N, Nominal
from ekf_companion.nav import so3
from ekf_companion.nav.arrays import Array

WALLS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
"""Normals, out of the room."""
REACH = np.array([4.0, 4.0, 3.0, 3.0, 1.5, 1.5])
"""m from the middle."""
POINT_STD = 0.02
"""m, across the wall."""
COLUMNS = np.r_[ATT, POS]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Measured points, and the walls that they lie on."""

    points_b: Array
    """m, shape (n, 3)."""
    walls: npt.NDArray[np.intp]
    """Shape (n,)."""

    @classmethod
    def of(cls, truth: Nominal, count: int, rng: np.random.Generator) -> Scan:
        """Measure some points in random directions from a true pose."""
        rays = rng.standard_normal((count, 3))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            ways = (REACH - WALLS @ truth.pos_n) / (rays @ WALLS.T)
        ways[ways <= 0.0] = np.inf
        walls = ways.argmin(axis=1)
        far = ways.min(axis=1) + POINT_STD * rng.standard_normal(count) / np.abs(
            (rays * WALLS[walls]).sum(axis=1)
        )
        points_n = truth.pos_n + rays * far[:, None]
        return cls((points_n - truth.pos_n) @ so3.to_matrix(truth.q_nb), walls)

    def rows(self, state: Nominal) -> Rows:
        """Return how far the points are from their walls if a state is right, as rows to fuse."""
        C_nb, normals = so3.to_matrix(state.q_nb), WALLS[self.walls]
        points_n = self.points_b @ C_nb.T + state.pos_n
        z = REACH[self.walls] - (normals * points_n).sum(axis=1)
        H = np.hstack([-np.cross(normals @ C_nb, self.points_b), normals])
        return Rows(z, H, np.full(len(z), POINT_STD**2), COLUMNS)


def _jacobian(x: Nominal, y: Nominal) -> Array:
    J = np.eye(N)
    J[ATT, ATT] = so3.right_jacobian_inverse(x.minus(y)[ATT])
    return J


MANIFOLD = Manifold(plus=Nominal.plus, minus=Nominal.minus, jacobian=_jacobian)
PRIOR_STD = np.repeat([0.5, 1.0, 0.5, 0.01, 0.1], 3)
"""Attitude (rad), velocity, position (m), biases."""


def start(rng: np.random.Generator) -> tuple[Nominal, Nominal, Array]:
    """Draw the true state and a prior: state and covariance."""
    truth = Nominal(
        q_nb=so3.exp(rng.uniform(-1.0, 1.0, 3)),
        vel_n=rng.uniform(-1.0, 1.0, 3),
        pos_n=rng.uniform(-1.0, 1.0, 3),
    )
    return truth, truth.plus(PRIOR_STD * rng.standard_normal(N)), np.diag(PRIOR_STD**2)


def update(
    prior: Nominal, P: Array, scan: Scan, form: Form = "auto", max_iterations: int = 20
) -> Correction[Nominal]:
    """Correct a prior by a scan."""
    return correct(prior, P, scan.rows, MANIFOLD, form=form, max_iterations=max_iterations)
