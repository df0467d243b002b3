"""A lidar in a room of known walls: thousands of point-to-plane rows in one update.

python -m benchmarks.room
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ekf_companion.filters.gauss_newton import Correction, Form, Manifold, Rows, correct
from ekf_companion.filters.strapdown import ATT, POS, N, Nominal
from ekf_companion.nav import so3

Array = npt.NDArray[np.float64]

WALLS = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
"""Normals, out of the room."""
REACH = np.array([4.0, 4.0, 3.0, 3.0, 1.5, 1.5])
"""m from the middle."""
POINT_STD = 0.02
"""m, across the wall."""
COLUMNS = np.r_[ATT, POS]


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Points seen from somewhere in the room, and the walls that they lie on."""

    points_b: Array
    """m, shape (n, 3)."""
    walls: npt.NDArray[np.intp]
    """Shape (n,)."""

    @classmethod
    def of(cls, truth: Nominal, count: int, rng: np.random.Generator) -> Scan:
        """Look around from a pose."""
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
        """Give how far the points, seen from a state, are from their walls."""
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
    """Draw where the vehicle is, and a prior: state and covariance."""
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


def main() -> None:
    """Print the tables."""
    print("| rows | information, ms | innovation, ms | ratio |\n|---|---|---|---|")
    for count in (100, 300, 1000, 3000, 5000):
        rng = np.random.default_rng(1)
        truth, prior, P = start(rng)
        scan, took = Scan.of(truth, count, rng), []
        for form in ("information", "innovation"):
            begin = time.perf_counter()
            found = update(prior, P, scan, form, max_iterations=3)
            took.append((time.perf_counter() - begin) / found.evaluations * 1e3)
        print(f"| {count} | {took[0]:.2f} | {took[1]:.1f} | {took[1] / took[0]:.0f} |", flush=True)
    for label, most in (("linear", 1), ("iterated", 20)):
        gaps, nees, evaluations = [], [], []
        for seed in range(100):
            rng = np.random.default_rng(seed)
            truth, prior, P = start(rng)
            found = update(prior, P, Scan.of(truth, 5000, rng), max_iterations=most)
            gap = truth.minus(found.state)[COLUMNS]
            part = found.P[np.ix_(COLUMNS, COLUMNS)]
            gaps.append([np.linalg.norm(gap[:3]), np.linalg.norm(gap[3:])])
            nees.append(gap @ np.linalg.solve(part, gap) / 6.0)
            evaluations.append(found.evaluations)
        turn, way = np.median(gaps, axis=0)
        print(
            f"{label}: median error {np.degrees(turn):.4f} deg, {1e3 * way:.2f} mm, "
            f"mean NEES / dof {np.mean(nees):.3g}, {np.mean(evaluations):.1f} evaluations"
        )


if __name__ == "__main__":
    main()
