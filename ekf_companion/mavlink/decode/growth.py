"""How far a source may have drifted from pose to pose, by the growth of its covariance.

What it states is how far it may be off since its begin, which says nothing of the last second; by
how much that has grown does. What is not held along a tunnel or over a plain grows there.
"""

from __future__ import annotations

import math

import numpy as np

from ekf_companion.nav.arrays import Array

Factor = tuple[float, float, float, float, float, float]
_LOWER = np.tril_indices(3)
_ANEW = 0.5
"""Share of a covariance below which it has begun anew: what is noise in it changes by less."""


class Growth:
    """The covariance of one source. What has shrunk does not count again when it grows back."""

    def __init__(self) -> None:
        self._counted: tuple[Array, float] | None = None
        self._counter: int | None = None

    def since(
        self, way: Array, turn: float, counter: int | None
    ) -> tuple[Factor | None, float | None]:
        """Return the Cholesky factor of the drift of the place, row by row, and the sigma of yaw's.

        None: it states no growth.

        Args:
            way: Covariance of the place in its frame, m^2, shape (3, 3).
            turn: Variance of yaw, rad^2.
            counter: Another number says that a new frame has begun.
        """
        before, is_same = self._counted, counter == self._counter
        self._counter = counter
        if before is None or not is_same or np.trace(way) < _ANEW * np.trace(before[0]):
            self._counted = way, turn
            return None, None
        values, axes = np.linalg.eigh(way - before[0])
        root = axes * np.sqrt(np.maximum(values, 0.0))
        grown = max(turn - before[1], 0.0)
        self._counted = before[0] + root @ root.T, before[1] + grown
        upper = np.asarray(np.linalg.qr(root.T, mode="r"))
        xx, yx, yy, zx, zy, zz = upper.T[_LOWER].tolist()
        factor = (xx, yx, yy, zx, zy, zz) if values[-1] > 0.0 else None
        return factor, math.sqrt(grown) if grown > 0.0 else None
