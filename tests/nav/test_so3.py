import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ekf_companion.nav import so3
from tests.filters.differences import central

vectors = st.lists(st.floats(-1.8, 1.8), min_size=3, max_size=3).map(np.array)
"""Rotation vectors shorter than half a turn."""


def scipy_of(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


@given(vectors)
def test_log_undoes_exp(phi):
    np.testing.assert_allclose(so3.log(so3.exp(phi)), phi, atol=1e-12)


@given(vectors, vectors)
def test_products_turn_as_matrices_do(a, b):
    p, q = so3.exp(a), so3.exp(b)
    product = so3.to_matrix(so3.multiply(p, q))
    np.testing.assert_allclose(product, so3.to_matrix(p) @ so3.to_matrix(q), atol=1e-12)
    np.testing.assert_allclose(so3.to_matrix(q), scipy_of(q).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("short", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.5, np.pi - 1e-9, np.pi])
def test_a_matrix_gives_its_rotation_up_to_half_a_turn(short):
    rng = np.random.default_rng(2)
    axis = rng.standard_normal((200, 3))
    axis[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    phi = (np.pi - short) * axis
    C = scipy_of(so3.exp(phi)).as_matrix()
    q = so3.from_matrix(C)
    assert (q[:, 0] >= 0.0).all()
    np.testing.assert_allclose(so3.to_matrix(q), C, atol=1e-15 * 4)
    found = so3.log(q)
    # At half a turn itself either axis is right
    same = np.sign(np.einsum("ni,ni->n", found, axis))[:, None] if short < 1e-12 else 1.0
    np.testing.assert_allclose(found, same * phi, atol=3e-15)
    for row in range(len(C)):
        assert so3.from_matrix(C[row]).tobytes() == q[row].tobytes()


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_euler_angles_come_back_and_mean_yaw_then_pitch_then_roll(roll, pitch, yaw):
    q = so3.from_euler(roll, pitch, yaw)
    np.testing.assert_allclose(so3.to_euler(q), [roll, pitch, yaw], atol=1e-9)
    oracle = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    np.testing.assert_allclose(so3.to_matrix(q), oracle, atol=1e-12)


def test_all_of_it_works_over_any_leading_shape():
    phi = np.random.default_rng(1).normal(0.0, 1.0, (4, 5, 3))
    q = so3.exp(phi)
    assert so3.to_matrix(q).shape == (4, 5, 3, 3)
    turned = so3.rotate(q, phi)
    np.testing.assert_allclose(turned, phi, atol=1e-12)  # a rotation keeps its own axis
    np.testing.assert_allclose(so3.multiply(q, so3.conjugate(q))[..., 0], 1.0, atol=1e-12)


@pytest.mark.parametrize("angle", [-10.0, -np.pi, 0.0, np.pi, 7.0])
def test_wrapped_angles_are_the_same_angle_within_half_a_turn(angle):
    wrapped = float(so3.wrap(angle))
    assert -np.pi <= wrapped < np.pi
    assert np.isclose(np.cos(wrapped - angle), 1.0)


def test_the_smallest_rotations_lose_nothing():
    tiny = np.array([1e-12, -2e-12, 3e-13])
    np.testing.assert_allclose(so3.log(so3.exp(tiny)), tiny, rtol=1e-12)


@pytest.mark.parametrize("size", [1e-6, 0.3, 2.0, 3.1])
def test_the_right_jacobian_and_its_inverse_agree_with_differences(size):
    v = np.random.default_rng(4).standard_normal(3)
    phi = size * v / np.linalg.norm(v)
    inverse = so3.right_jacobian_inverse(phi)
    seen = central(lambda d: so3.log(so3.multiply(so3.exp(phi), so3.exp(d))), 3)
    np.testing.assert_allclose(inverse, seen, atol=1e-8)  # step 1e-5
    seen = central(lambda d: so3.log(so3.multiply(so3.exp(-phi), so3.exp(phi + d))), 3)
    np.testing.assert_allclose(np.linalg.inv(inverse), seen, atol=1e-8)


@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e-3, 1.0, 4.0])
def test_one_rotation_alone_gives_the_bits_of_one_among_many(size):
    """What is written out for one, as it is needed at each sample, computes the same."""
    rng = np.random.default_rng(3)
    p, q = rng.standard_normal((2, 200, 4))
    phi = size * rng.standard_normal((200, 3))
    angles = rng.uniform(-4.0, 4.0, (200, 3))
    many = (
        so3.multiply(p, q),
        so3.normalise(p),
        so3.exp(phi),
        so3.log(so3.exp(phi)),
        so3.from_euler(*angles.T),
    )
    for row in range(len(p)):
        alone = (
            so3.multiply(p[row], q[row]),
            so3.normalise(p[row]),
            so3.exp(phi[row]),
            so3.log(so3.exp(phi[row])),
            so3.from_euler(*angles[row]),
        )
        for one, found in zip(many, alone, strict=True):
            assert one[row].tobytes() == found.tobytes()


def test_a_quaternion_of_no_length_and_one_that_is_not_known_stay_unknown():
    assert np.isnan(so3.normalise(np.zeros(4))).all()
    assert np.isnan(so3.normalise(np.full(4, np.nan))).all()
    assert np.isnan(so3.exp(np.array([np.nan, 0.0, 0.0]))).any()
