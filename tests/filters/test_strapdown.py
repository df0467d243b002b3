from dataclasses import replace

import numpy as np
import pytest

from ekf_companion.filters.strapdown import (
    Earth,
    Interval,
    N,
    Noise,
    Nominal,
    covariance_in_n,
    integrate_strapdown,
    transition,
)
from ekf_companion.nav import so3
from ekf_companion.nav.earth import LocalFrame
from tests.filters.differences import central, some_state

EARTH = Earth.at(LocalFrame(0.83, 0.15, 488.0))


def over(dt=0.01, seed=2):
    rng = np.random.default_rng(seed)
    gyro, accel = rng.uniform(-1.0, 1.0, (2, 3)), rng.uniform(-12.0, 12.0, (2, 3))
    return Interval(dt=dt, gyro0=gyro[0], gyro1=gyro[1], accel0=accel[0], accel1=accel[1])


def test_minus_undoes_plus():
    dx = np.linspace(-1.0, 1.0, N)
    np.testing.assert_allclose(some_state().plus(dx).minus(some_state()), dx, atol=1e-12)


@pytest.mark.parametrize("down_n", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8)])
def test_the_transition_is_the_derivative_of_the_motion(down_n):
    state, earth = some_state(), replace(EARTH, down_n=np.array(down_n))
    after = integrate_strapdown(state, over(), earth)
    seen = central(lambda dx: integrate_strapdown(state.plus(dx), over(), earth).minus(after), N)
    Phi = transition(state, over(), earth)
    # Coriolis is left out: 1.5e-4 1/s times 0.01 s; the turn of the midpoint counts to second order
    np.testing.assert_allclose(Phi, seen, atol=4e-6)
    assert np.abs(Phi - np.eye(N)).max() > 0.05


def test_the_midpoint_rule_is_of_second_order():
    def gyro(t):
        return np.array([0.5 * np.sin(3.0 * t), 0.4, 0.3 * np.cos(2.0 * t)])

    def accel(t):
        return np.array([2.0 * np.cos(2.0 * t), np.sin(t), -9.8])

    def flown(n):
        state, dt = some_state(), 1.0 / n
        for k in range(n):
            a, b = k * dt, (k + 1) * dt
            state = integrate_strapdown(
                state,
                Interval(dt=dt, gyro0=gyro(a), gyro1=gyro(b), accel0=accel(a), accel1=accel(b)),
                EARTH,
            )
        return state

    fine = flown(3200)
    coarse, half = (np.abs(flown(n).minus(fine)).max() for n in (25, 50))
    assert half < 2e-3
    assert coarse / half == pytest.approx(4.0, rel=0.15)


def test_a_sensor_at_rest_stays_where_it_is():
    q_nb = so3.from_euler(0.1, -0.2, 2.0)
    C_nb = so3.to_matrix(q_nb)
    fall = np.array([0.0, 0.0, EARTH.gravity])
    gyro, accel = C_nb.T @ EARTH.rate_n, -C_nb.T @ fall
    start = Nominal(q_nb=q_nb, vel_n=np.zeros(3), pos_n=np.zeros(3))
    end = integrate_strapdown(
        start, Interval(dt=1.0, gyro0=gyro, gyro1=gyro, accel0=accel, accel1=accel), EARTH
    )
    np.testing.assert_allclose(end.minus(start), 0.0, atol=1e-9)


def test_noise_over_two_intervals_is_that_over_both():
    noise = Noise(gyro=1e-3, accel=1e-2, gyro_walk=1e-4, accel_walk=1e-3)
    whole, half = noise.covariance(0.02), noise.covariance(0.01)
    Phi = np.eye(N)
    Phi[6:9, 3:6] = 0.01 * np.eye(3)
    np.testing.assert_allclose(Phi @ half @ Phi.T + half, whole, rtol=1e-12, atol=1e-20)
    assert (np.linalg.eigvalsh(whole) > 0.0).all()


def test_a_covariance_of_the_attitude_is_turned_into_n():
    q_nb = so3.from_euler(0.0, 0.0, np.pi / 2)
    P = np.diag([1.0, 4.0, 9.0, *np.ones(12)])
    np.testing.assert_allclose(np.diag(covariance_in_n(P, q_nb))[:3], [4.0, 1.0, 9.0])
