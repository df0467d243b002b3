"""Fit of an ellipsoid to a field of constant strength, measured by a magnetometer near iron.

The vehicle adds a constant (hard iron) and stretches and shears the rest (soft iron), so what
should lie on a sphere lies on an ellipsoid: ``|S (m - h)| = F``. S is symmetric: the strength does
not show a rotation of the whole.

Source: Vasconcelos et al. 2011, IEEE Trans. AES 47, 2 (ellipsoid fit, maximum likelihood); Huber
1964 (outliers).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ekf_companion.nav.arrays import Array, Indices

CELLS = 100
"""Number of directions, some 20 degrees each: however long one is held, it counts once."""
LIKELY_HARD = 1.0
"""Prior sigma of the hard iron, gauss: keeps an axis that was not measured near 0."""
LIKELY_SOFT = 0.05
"""Prior sigma of an element of the soft iron; one that is not fitted keeps it."""
LEAST_NOISE = 0.005
"""Least variation of the field about a vehicle, gauss."""
KNEE = 2.0
"""Sigmas beyond which an innovation counts by its size, not by its square (Huber)."""
STEPS = 50
SYMMETRIC = np.array([[0, 0], [1, 1], [2, 2], [0, 1], [0, 2], [1, 2]])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Fit:
    """Iron and its uncertainty."""

    hard: Array
    """gauss, shape (3,)."""
    soft: Array
    """Shape (3, 3)."""
    hard_std: Array
    """One sigma by axis, gauss, shape (3,)."""
    soft_std: float
    """Largest one sigma of a fitted element; 0: none was fitted."""
    rms: float
    """RMS error of the corrected strength, gauss; each direction counts once."""

    def apply(self, mag_b: Array) -> Array:
        """Return the field without the iron, shape (n, 3), gauss."""
        return np.asarray((mag_b - self.hard) @ self.soft.T)


def sphere(points: Array, weight: Array | None = None) -> tuple[Array, float]:
    """Return centre and radius of the sphere, or circle, nearest to points, shape (n, m).

    Source: Kasa 1976, IEEE Trans. IM 25, 1 (linear least squares).
    """
    middle = points.mean(axis=0)
    arms = points - middle
    root = np.ones(len(arms)) if weight is None else np.sqrt(weight)
    rows = np.column_stack([2.0 * arms, np.ones(len(arms))]) * root[:, None]
    terms = np.linalg.lstsq(rows, np.sum(arms**2, axis=1) * root, rcond=None)[0]
    return middle + terms[:-1], float(np.sqrt(max(terms[-1] + terms[:-1] @ terms[:-1], 0.0)))


def directions(arms: Array) -> Indices:
    """Return the cell of the sphere that each vector, shape (n, 3), points to, 0 to CELLS - 1.

    A cell is what is nearest to a point of a Fibonacci lattice (Gonzalez 2010).
    """
    i = np.arange(CELLS)
    z = 1.0 - (2.0 * i + 1.0) / CELLS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    lattice = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    return np.asarray(np.argmax(arms @ lattice.T, axis=1), dtype=np.int64)


def weights(arms: Array) -> Array:
    """Return weights by which every direction that occurs counts once."""
    cell = directions(arms)
    return 1.0 / np.bincount(cell, minlength=CELLS)[cell]


def spread(field_b: Array, strength: float) -> float:
    """Return the RMS error of the strength of fields, shape (n, 3), gauss."""
    off = np.linalg.norm(field_b, axis=1) - strength
    return float(np.sqrt(np.average(off**2, weights=weights(field_b))))


def fit(mag_b: Array, strength: float, *, is_soft: bool, start: Array) -> Fit:
    """Fit the iron to measured fields by Gauss-Newton steps, outliers counting less.

    Args:
        mag_b: gauss, shape (n, 3).
        strength: Of the Earth's field, gauss.
        is_soft: Fit the soft iron too; else it is the identity, uncertain as before.
        start: Initial hard iron, gauss.
    """
    share = weights(mag_b - start)
    size = 9 if is_soft else 3
    sigmas = np.concatenate([np.full(3, LIKELY_HARD), np.full(6, LIKELY_SOFT)])
    terms = np.concatenate([start, np.zeros(6)])
    for _ in range(STEPS):
        innovation, jacobian = _model(terms, mag_b, strength)
        size_of = np.abs(innovation)
        noise = max(1.4826 * _weighted_median(size_of, share), LEAST_NOISE)
        weight = share / noise**2 / np.maximum(size_of / (KNEE * noise), 1.0)
        fitted, rest = jacobian[:, :size], jacobian[:, size:]
        own = np.linalg.inv((fitted.T * weight) @ fitted + np.diag(sigmas[:size] ** -2.0))
        step = own @ ((fitted.T * weight) @ innovation + terms[:size] / sigmas[:size] ** 2)
        terms[:size] -= step
        if np.abs(step).max() < 1e-7:
            break
    # What is not fitted adds its uncertainty (Schmidt 1966)
    gain = own @ (fitted.T * weight) @ rest
    std = np.sqrt(np.diag(own + (gain * sigmas[size:] ** 2) @ gain.T))
    hard, soft = _unpack(terms)
    return Fit(
        hard=hard,
        soft=soft,
        hard_std=std[:3],
        soft_std=float(std[3:].max(initial=0.0)),
        rms=spread((mag_b - hard) @ soft, strength),
    )


def _unpack(terms: Array) -> tuple[Array, Array]:
    """Return hard and soft iron of three or nine numbers."""
    soft = np.eye(3)
    for term, (i, j) in zip(terms[3:], SYMMETRIC, strict=False):
        soft[i, j] = soft[j, i] = soft[i, j] + term
    return terms[:3].copy(), soft


def _model(terms: Array, mag_b: Array, strength: float) -> tuple[Array, Array]:
    """Return the error of the corrected strength, and its slopes by all nine numbers."""
    hard, soft = _unpack(terms)
    arms = mag_b - hard
    fields = arms @ soft
    size = np.linalg.norm(fields, axis=1)
    units = fields / size[:, None]
    jacobian = np.empty((len(arms), 9))
    jacobian[:, :3] = -units @ soft
    for column, (i, j) in enumerate(SYMMETRIC, 3):
        jacobian[:, column] = units[:, i] * arms[:, j]
        if i != j:
            jacobian[:, column] += units[:, j] * arms[:, i]
    return size - strength, jacobian


def _weighted_median(values: Array, weight: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(total, 0.5 * total[-1])]])
