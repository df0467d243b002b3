"""The step that no motion explains, against matrices of NumPy."""

import numpy as np
import pytest

from ekf_companion.core.step import unexplained_step
from ekf_companion.nav import so3
from tests.core import interpreted

DT = 0.04


def drawn(seed):
    """Return two estimates, and the samples between them, that have nothing to do with another."""
    rng = np.random.default_rng(seed)

    def estimate():
        q = so3.normalise(rng.normal(size=4))
        return tuple(np.concatenate((rng.normal(size=3), q, rng.normal(size=3))).tolist())

    samples = [tuple(rng.normal(size=6).tolist()) for _ in range(8)]
    return estimate(), estimate(), samples


@pytest.mark.parametrize("seed", range(5))
def test_it_is_what_mean_rate_and_mean_force_do_not_explain(seed):
    last, now, samples = drawn(seed)
    rate, force = np.split(np.mean(samples, axis=0), 2)
    C, D = so3.to_matrix(np.array(last[3:7])), so3.to_matrix(np.array(now[3:7]))
    turned = C @ so3.to_matrix(so3.exp(rate * DT))
    accel_n = 0.5 * (C + turned) @ force + [0.0, 0.0, 9.81]
    pos, vel = np.subtract(now, last)[:3], np.subtract(now, last)[7:]
    error = D @ turned.T
    expected = [*(pos - DT * np.mean([last[7:], now[7:]], axis=0)), *(vel - DT * accel_n)]
    step = unexplained_step(last, now, samples, DT)
    assert step == pytest.approx([*expected, np.arctan2(error[1, 0], error[0, 0])], abs=1e-12)


def test_without_a_turn_the_attitude_stays():
    still = (0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0)
    samples = [(0.0, 0.0, 0.0, 0.0, 0.0, -9.81)]
    assert unexplained_step(still, still, samples, DT) == pytest.approx([0.0] * 7, abs=1e-15)


def test_interpreted_it_is_the_same():
    interpreted_step = interpreted.load().step.unexplained_step
    for seed in range(5):
        assert interpreted_step(*drawn(seed), DT) == unexplained_step(*drawn(seed), DT)
