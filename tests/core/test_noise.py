"""The white noise of the inertial samples, learnt from their differences."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import ImuRow
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load

LOOP = 1.0 / 300.0
"""s: ArduPlane's loop."""


def learnt(spans: np.ndarray, std: float) -> float:
    """Return the density that is learnt of samples with white noise, (m/s^2)^2 s."""
    x, imu, noise = State(), ImuRow(), load().noise
    rng = np.random.default_rng(1)
    for n, span in enumerate(spans):
        x.samples = n + 1.0
        imu.accel[:] = std * rng.standard_normal(3)
        noise.learn_noise(x, imu, float(span))
    return float(np.mean(x.noise[3:6]))


@pytest.mark.parametrize(
    "pattern",
    [
        pytest.param([1], id="all of them"),
        pytest.param([1, 1, 1, 1, 2], id="250 of 300"),
        pytest.param([1, 2], id="200 of 300"),
    ],
)
def test_it_is_learnt_of_samples_of_which_the_autopilot_leaves_some_out(pattern):
    spans = LOOP * np.resize(pattern, 6000)
    assert learnt(spans, 1.0) == pytest.approx(np.mean(spans), rel=0.35)  # 2 s of blocks: 15 %


def test_a_hole_begins_anew_and_is_no_noise():
    spans = LOOP * np.resize([1] * 19 + [8], 6000)
    assert learnt(spans, 1.0) == pytest.approx(LOOP, rel=0.35)
