"""Vectors and matrices of three in plain floats are those of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from ekf_companion.nav import matrix3


def test_products_are_those_of_numpy():
    rng = np.random.default_rng(1)
    A, B, v = rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), rng.normal(size=3)
    assert matrix3.apply(A.tolist(), v.tolist()) == pytest.approx(A @ v)
    product = matrix3.multiply_transposed(A.tolist(), B.tolist())
    assert np.array(product) == pytest.approx(A @ B.T)
