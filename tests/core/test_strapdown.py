"""The strapdown equations against the vocabulary, closed forms and finer steps."""

import itertools

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Motion
from ekf_companion.core.memory.state import State
from ekf_companion.nav import earth, so3
from tests.core.interpreted import load
from tests.core.states import a_state, array, minus, sampled, some_parameters


def test_gravity_and_earth_rate_agree_with_the_vocabulary():
    strapdown = load().strapdown
    lat, alt, dt = 0.7, 1000.0, 0.01
    x, k, m = State(), some_parameters(), Motion()
    x.q_nb[0] = 1.0
    strapdown.set_origin(x, lat, 0.2, alt)
    north, east = earth.LocalFrame(lat, 0.2, alt).scale
    assert (x.origin.scale_n, x.origin.scale_e) == pytest.approx((north, east), rel=1e-14)
    strapdown.integrate_strapdown(x, k, m, dt)
    assert x.vel_n[2] / dt == pytest.approx(float(earth.gravity(lat, alt)), rel=1e-12)
    # a body that does not turn in inertial space turns against the Earth
    turned = so3.log(np.array(x.q_nb)) / dt
    np.testing.assert_allclose(turned, -earth.earth_rate_n(lat), atol=1e-12)


@pytest.mark.parametrize("kind", ["cone", "scull"])
def test_two_samples_in_a_row_show_coning_and_sculling(kind):
    """A body that cones, or swings in time with its acceleration, sampled as means at 100 Hz."""
    dt, n, w0, fine = 0.01, 300, 2.0 * np.pi * 8.0, 50
    t = (np.arange(n * fine) + 0.5) * dt / fine
    zero = np.zeros_like(t)
    rate = np.stack([0.8 * np.sin(w0 * t), 0.8 * np.cos(w0 * t) * (kind == "cone"), zero], axis=-1)
    force = np.stack([zero, 6.0 * np.sin(w0 * t) * (kind == "scull"), zero - 9.8], axis=-1)

    def fly(samples: np.ndarray, period: float, has_slope: bool) -> State:
        x, k, m = State(), some_parameters(), Motion()
        x.q_nb[0] = 1.0
        for before, now in itertools.pairwise(samples):
            sampled(m, now)
            slope = (now - before) / period * has_slope
            m.rate_slope[:], m.force_slope[:] = slope[:3], slope[3:]
            load().strapdown.integrate_strapdown(x, k, m, period)
        return x

    exact = np.concatenate([rate, force], axis=-1)
    means = exact.reshape(n, fine, 6).mean(axis=1)
    truth = fly(np.concatenate([exact[fine - 1 : fine], exact[fine:]]), dt / fine, True)
    plain = minus(fly(means, dt, False), truth)
    better = minus(fly(means, dt, True), truth)
    part = slice(0, 3) if kind == "cone" else slice(3, 6)
    assert np.abs(better[part]).max() < 0.1 * np.abs(plain[part]).max()


def test_the_turning_force_is_integrated_in_closed_form():
    """A steady turn and force for 0.1 s, against a thousand steps of the midpoint rule."""
    rate, force, dt, steps = np.array([3.0, -2.0, 1.0]), np.array([4.0, 5.0, -9.0]), 0.1, 1000
    x, m = State(), Motion()
    load().strapdown.integrate_increments(x, sampled(m, (*rate, *force)), dt)
    middle = (np.arange(steps) + 0.5) * dt / steps
    turned = np.array([so3.rotate(so3.exp(rate * at), force) for at in middle])
    np.testing.assert_allclose(m.dv_b, turned.mean(axis=0) * dt, rtol=1e-7)
    left = dt - middle
    np.testing.assert_allclose(m.dp_b, (turned * left[:, None]).sum(axis=0) * dt / steps, rtol=1e-6)
    np.testing.assert_allclose(m.turn_b, rate * dt, rtol=1e-15)


def test_what_is_pending_is_the_sum_of_the_motions_and_is_forgotten_whole():
    x, k, m = a_state(4), some_parameters(), Motion()
    dv_n, C_nb_dt = np.zeros(3), np.zeros((3, 3))
    for dt in (0.004, 0.006, 0.01):
        load().strapdown.integrate_strapdown(x, k, sampled(m), dt)
        dv_n += np.array(m.dv_n)
        C_nb_dt += np.array(m.C_nb) * dt
    assert x.pending.dt == pytest.approx(0.02)
    np.testing.assert_allclose(x.pending.dv_n, dv_n)
    np.testing.assert_allclose(np.array(x.pending.C_nb_dt), C_nb_dt)
    load().strapdown.forget_pending(x)
    assert not any(x.pending.dv_n)
    assert not array(x.pending.C_nb_dt).any()
    assert x.pending.dt == 0.0
