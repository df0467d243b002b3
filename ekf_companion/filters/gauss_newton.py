"""The measurement update as a least-squares problem on a manifold, solved by Gauss-Newton.

The cost of a state x with prior y is the square of (x minus y) in units of P, and of measured minus
predicted in units of R. With J the Jacobian of (x plus d) minus y by d, the prior relative to the
iterate has the covariance A = J^-1 P J^-T and the distance e = J^-1 (x minus y), and a step is

    d = -e + K (z + H e),    K = A H' (H A H' + R)^-1 = (H' R^-1 H + A^-1)^-1 H' R^-1.

Rows are whitened first, so R is the identity below. Neither form inverts P: with P = L L' the
second is K = L (I + L' H' H L)^-1 L' H', which costs n k^2 for n rows and forms nothing n by n.
A step that would increase the cost is halved.

Source: Bell and Cathey 1993, "The iterated Kalman filter update as a Gauss-Newton method"; Xu and
Zhang 2021, "FAST-LIO", arXiv 2010.08196, equations 14 to 20; Qin et al. 2020, "LINS",
arXiv 1907.02233.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from ekf_companion.nav.arrays import Array

Form = Literal["auto", "innovation", "information"]
S = TypeVar("S")

MAX_ITERATIONS = 20
SETTLED = 1e-3
"""Share of one sigma in every state below which a step is the last."""
HALVINGS = 12


class Rows(NamedTuple):
    """Measurements linearised at a state."""

    z: Array
    """Measured less predicted, shape (n,)."""
    H: Array
    """Jacobian of the prediction by the error states in ``columns``, shape (n, m)."""
    R: Array
    """Variances, shape (n,), or a covariance, shape (n, n)."""
    columns: npt.NDArray[np.intp] | None = None
    """Error states that the rows depend on, shape (m,); None: all."""


@dataclass(frozen=True, slots=True)
class Manifold(Generic[S]):
    """Addition and difference of states."""

    plus: Callable[[S, Array], S]
    """Adds an error state, shape (k,), to a state."""
    minus: Callable[[S, S], Array]
    """Returns the error state from the second state to the first."""
    jacobian: Callable[[S, S], Array]
    """Returns the derivative of (first plus d) minus second by d at 0, shape (k, k)."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Correction(Generic[S]):
    """The state of least cost."""

    state: S
    P: Array
    """Covariance of its error state, shape (k, k)."""
    cost: float
    """At the last evaluation; of a linear problem, the NIS."""
    evaluations: int
    """Number of linearisations."""
    is_settled: bool
    """Whether the last step was below :data:`SETTLED`."""


class _Point(NamedTuple):
    """Whitened rows at an iterate, and its cost."""

    z: Array
    H: Array
    columns: npt.NDArray[np.intp] | None
    gap: Array
    """From the prior, shape (k,)."""
    cost: float


def correct(
    state: S,
    P: Array,
    rows: Callable[[S], Rows],
    manifold: Manifold[S],
    *,
    form: Form = "auto",
    max_iterations: int = MAX_ITERATIONS,
) -> Correction[S]:
    """Find the state of least cost from a prior and the covariance of its error state, (k, k).

    ``rows`` linearises the measurements at a state, once per iteration and halving. One iteration
    is the update of an extended Kalman filter.
    """
    L = factor(P)
    prior, evaluations = state, 1
    here = _whitened(rows(prior), L, np.zeros(len(P)))
    for iteration in range(1, max_iterations + 1):
        # The prior relative to the iterate
        J = manifold.jacobian(state, prior) if here.gap.any() else np.eye(len(P))
        A_half = np.asarray(np.linalg.solve(J, L), dtype=np.float64)
        e = np.linalg.solve(J, here.gap)
        # The step of least cost of the linearised problem
        seen = e if here.columns is None else e[here.columns]
        gained, P_here = gain(A_half, here.H, here.z + here.H @ seen, here.columns, form)
        dx = gained - e
        is_settled = bool((np.abs(dx) <= SETTLED * np.sqrt(np.diag(P_here))).all())
        if is_settled or iteration == max_iterations:
            break
        # Halve it until the cost decreases
        for _ in range(HALVINGS):
            there = manifold.plus(state, dx)
            ahead = _whitened(rows(there), L, manifold.minus(there, prior))
            evaluations += 1
            if ahead.cost <= here.cost:
                break
            dx = 0.5 * dx
        else:
            # Rounding hides any further descent
            dx = np.zeros(len(P))
            break
        state, here = there, ahead
    final = manifold.plus(state, dx)
    return Correction(
        state=final,
        P=reset(P_here, manifold.jacobian(final, state)),
        cost=here.cost,
        evaluations=evaluations,
        is_settled=is_settled,
    )


def gain(
    L: Array,
    H: Array,
    y: Array,
    columns: npt.NDArray[np.intp] | None = None,
    form: Form = "auto",
) -> tuple[Array, Array]:
    """Return the gain times y, and the covariance after the update, for rows of unit variance.

    The covariance before it is P = L L', shape (k, k). H, shape (n, m), is by the error states in
    ``columns``, None: all. y has the shape (n,) or (n, p): the identity returns the gain itself.
    The form ``auto`` is by the information if n > k.
    """
    k = len(L)
    part = L if columns is None else L[columns]
    if form == "innovation" or (form == "auto" and len(H) <= k):
        G = H @ part
        W = np.linalg.solve(G @ G.T + np.eye(len(H)), G).T
        # Joseph in the units of L: (I - W G)(I - W G)' + W W'
        rest = np.eye(k) - W @ G
        return L @ (W @ y), _square(L @ np.hstack([rest, W]))
    # Only the k by k information and k sums of the rows are needed
    M = np.linalg.cholesky(np.eye(k) + part.T @ (H.T @ H) @ part)
    X = np.linalg.solve(M, L.T)
    sums = H.T @ y
    return X.T @ (X @ sums if columns is None else X[:, columns] @ sums), _square(X.T)


def reset(P: Array, J: Array) -> Array:
    """Return a covariance about another state, by the manifold's Jacobian J, shape (k, k)."""
    G = np.linalg.inv(J)
    after = G @ P @ G.T
    return np.asarray(0.5 * (after + after.T))


def factor(P: Array) -> Array:
    """Return L with P = L L'; the row of a state without variance is zero."""
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError:
        return nearest_factor(P, 0.0)


def nearest_factor(P: Array, least: float) -> Array:
    """Return the factor of the nearest P whose correlations have no smaller eigenvalue."""
    size = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    unit = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(P / np.outer(unit, unit))
    return np.asarray(unit[:, None] * vectors * np.sqrt(np.maximum(values, least)))


def _whitened(rows: Rows, L: Array, gap: Array) -> _Point:
    """Whiten rows, and add up their cost and that of the gap to the prior."""
    z, H = rows.z, rows.H
    if rows.R.ndim == 1:
        weight = 1.0 / np.sqrt(rows.R)
        z, H = z * weight, H * weight[:, None]
    else:
        half = np.linalg.cholesky(rows.R)
        z, H = np.linalg.solve(half, z), np.linalg.solve(half, H)
    cost = float(z @ z)
    if gap.any():
        try:
            w = np.linalg.solve(L, gap)
        except np.linalg.LinAlgError:
            w = np.linalg.lstsq(L, gap, rcond=None)[0]
        cost += float(w @ w)
    return _Point(z, H, rows.columns, gap, cost)


def _square(half: Array) -> Array:
    P = half @ half.T
    return np.asarray(0.5 * (P + P.T))
