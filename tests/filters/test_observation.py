import numpy as np
import pytest

from ekf_companion.filters.observation import Azimuth, Position, Velocity, reset
from ekf_companion.filters.strapdown import ATT, N
from ekf_companion.nav import so3
from tests.filters.differences import central, some_state
from tests.filters.sighting import Sighting

LEVER = np.array([0.4, -0.3, -1.1])
FIELD = np.array([0.215, 0.013, 0.433])
AIDS = [
    Position(pos_n=np.array([1.0, 2.0, -3.0]), std=np.array([1.0, 1.0, 2.0]), lever_b=LEVER),
    Velocity(vel_n=np.array([1.0, 2.0, -3.0]), std=0.2, swing_b=LEVER),
    Velocity(vel_n=np.array([1.0, 2.0]), std=0.2, swing_b=LEVER),
    Azimuth(seen_b=np.array([0.2, 0.1, 0.4]), azimuth=0.3, std=0.05),
    Sighting(seen_b=np.array([0.2, 0.1, 0.4]), known_n=FIELD, std=0.01),
]


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    "aid", AIDS, ids=lambda aid: f"{type(aid).__name__}{len(aid.covariance())}"
)
def test_the_jacobian_is_the_derivative_of_what_is_predicted(aid, seed):
    state = some_state(seed)
    seen = -central(lambda dx: aid.innovation(state.plus(dx)), N)
    np.testing.assert_allclose(aid.jacobian(state), seen, atol=1e-8)  # step 1e-5
    assert np.abs(aid.jacobian(state)[:, ATT]).max() > 0.1
    assert aid.covariance().shape == (len(seen), len(seen))


def test_an_antenna_on_a_lever_is_where_it_was_measured():
    state = some_state()
    C_nb = so3.to_matrix(state.q_nb)
    at = Position(pos_n=state.pos_n + C_nb @ LEVER, std=np.ones(3), lever_b=LEVER)
    np.testing.assert_allclose(at.innovation(state), 0.0, atol=1e-12)


def test_an_azimuth_is_compared_the_short_way():
    state = some_state()
    seen_n = so3.to_matrix(state.q_nb) @ np.array([1.0, 0.0, 0.0])
    azimuth = float(np.arctan2(seen_n[1], seen_n[0])) + 2.0 * np.pi - 0.1
    aid = Azimuth(seen_b=np.array([1.0, 0.0, 0.0]), azimuth=azimuth, std=0.1)
    assert aid.innovation(state)[0] == pytest.approx(-0.1)


def test_about_a_state_an_azimuth_says_the_same_of_it_without_the_noise_in_its_jacobian():
    state = some_state()
    C_nb = so3.to_matrix(state.q_nb)
    noise = 0.05 * np.array([-FIELD[1], FIELD[0], 0.0])
    declination = float(np.arctan2(FIELD[1], FIELD[0]))
    exact, noisy = (
        Azimuth(seen_b=C_nb.T @ field, azimuth=declination, std=0.1)
        for field in (FIELD, FIELD + noise)
    )
    about = noisy.about(state)
    np.testing.assert_allclose(about.innovation(state), noisy.innovation(state), atol=1e-12)
    clean = exact.jacobian(state)
    assert np.abs(noisy.jacobian(state) - clean).max() > 0.05
    np.testing.assert_allclose(about.jacobian(state), clean, atol=0.005)  # its length: 5 % squared


@pytest.mark.parametrize("aid", AIDS[:4], ids=lambda aid: aid.aid + str(len(aid.covariance())))
def test_after_a_reset_an_aid_is_fulfilled_and_nothing_else_has_moved(aid):
    state = some_state()
    K, _ = reset(aid, state, 7.0)
    dx = K @ aid.innovation(state)
    moved = state.plus(dx)
    np.testing.assert_allclose(aid.innovation(moved), 0.0, atol=1e-12)
    block = {"position": slice(6, 9), "velocity": slice(3, 6), "heading": ATT}[aid.aid]
    assert np.abs(np.delete(dx, block)).max() == 0.0
    down = [so3.to_matrix(one.q_nb)[2] for one in (state, moved)]
    np.testing.assert_allclose(down[0], down[1], atol=1e-12)


def test_a_field_along_the_vertical_shows_no_azimuth_and_divides_by_nothing():
    state = some_state()
    down_b = so3.to_matrix(state.q_nb)[2]
    for seen_b in (down_b, 0.0 * down_b):
        aid = Azimuth(seen_b=seen_b, azimuth=0.3, std=0.05)
        assert not aid.is_usable(state)
        assert np.isfinite(aid.jacobian(state)).all()
    assert AIDS[3].is_usable(state)


def test_the_reset_of_a_velocity_inflates_the_attitude():
    state = some_state()
    tilt, seconds = 0.2, 7.0
    vel_n = state.vel_n + np.array([tilt * 9.80665 * seconds, 0.0, 0.0])
    gone = Velocity(vel_n=vel_n, std=0.2, swing_b=np.zeros(3))
    _, inflation = reset(gone, state, seconds)
    np.testing.assert_allclose(np.sqrt(np.diag(inflation)[ATT]), tilt, rtol=1e-9)
    assert np.abs(np.diag(inflation)[3:]).max() == 0.0
    assert np.abs(reset(AIDS[0], state, seconds)[1]).max() == 0.0
