"""The step that no motion explains, against matrices of NumPy."""

import numpy as np
import pytest

from ekf_companion.core.output.jump import unexplained_step
from ekf_companion.nav import so3
from tests.core import interpreted

DT = 0.04
AHEAD = 0.01


def drawn(seed):
    """Return two estimates, the samples between them, and one before, all unrelated."""
    rng = np.random.default_rng(seed)

    def estimate():
        q = so3.normalise(rng.normal(size=4))
        return tuple(np.concatenate((rng.normal(size=3), q, rng.normal(size=3))).tolist())

    samples = [tuple(rng.normal(size=6).tolist()) for _ in range(8)]
    return estimate(), estimate(), samples, tuple(rng.normal(size=6).tolist())


@pytest.mark.parametrize("seed", range(5))
def test_it_is_what_mean_rate_and_mean_force_do_not_explain(seed):
    last, now, samples, before = drawn(seed)
    rate, force = np.split(np.mean(samples, axis=0), 2)
    first, end = np.split(np.array(before), 2), np.split(np.array(samples[-1]), 2)
    C, D = so3.to_matrix(np.array(last[3:7])), so3.to_matrix(np.array(now[3:7]))
    turned = C @ so3.to_matrix(so3.exp(rate * DT + AHEAD * (end[0] - first[0])))
    gain = DT * (0.5 * (C + turned) @ force + [0.0, 0.0, 9.81])
    gain += AHEAD * (turned @ end[1] - C @ first[1])
    pos, vel = np.subtract(now, last)[:3], np.subtract(now, last)[7:]
    error = D @ turned.T
    expected = [*(pos - DT * np.mean([last[7:], now[7:]], axis=0)), *(vel - gain)]
    step = unexplained_step(last, now, samples, DT, before, AHEAD)
    assert step == pytest.approx([*expected, np.arctan2(error[1, 0], error[0, 0])], abs=1e-12)


def test_without_a_turn_the_attitude_stays():
    still = (0.0, 0.0, 0.0, 0.6, 0.0, 0.0, 0.8, 0.0, 0.0, 0.0)
    samples = [(0.0, 0.0, 0.0, 0.0, 0.0, -9.81)]
    step = unexplained_step(still, still, samples, DT, samples[0], AHEAD)
    assert step == pytest.approx([0.0] * 7, abs=1e-15)


def test_interpreted_it_is_the_same():
    interpreted_step = interpreted.load().jump.unexplained_step
    for seed in range(5):
        last, now, samples, before = drawn(seed)
        compiled = unexplained_step(last, now, samples, DT, before, AHEAD)
        assert interpreted_step(last, now, samples, DT, before, AHEAD) == compiled
