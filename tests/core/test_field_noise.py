"""The magnetometer's noise, learnt from its azimuths."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import E_ATT, E_HEADING, N
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load

STATED = 0.04
"""One sigma of an azimuth as configured, rad."""
RATE = 10
"""Azimuths a second."""
SECONDS = 120
"""Of each flight."""


def learnt(errors: np.ndarray) -> float:
    """Return the share of the stated variance that azimuths with these errors (rad) have."""
    x, magnetic_field = State(), load().magnetic_field
    yaw = E_ATT + 2
    x.P[yaw][yaw] = np.radians(0.2) ** 2
    x.P[E_HEADING][E_HEADING] = np.radians(0.5) ** 2
    magnetic_field.forget_noise(x)
    for n, error in enumerate(errors):
        o = Observation()
        load().observation.clear(o, 1, STATED**2)
        o.z[0] = error
        o.H[0][yaw] = o.H[0][E_HEADING] = 1.0
        x.t = n * 1e9 / RATE
        magnetic_field.innovate_azimuth(x, o)
        assert o.R[0][0] > 0.0
        assert np.isfinite([o.PHt[0][j] for j in range(N)]).all()
    return x.field_noise.share


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_white_noise_is_found(seed, ratio):
    white = ratio * STATED * np.random.default_rng(seed).standard_normal(SECONDS * RATE)
    assert learnt(white) == pytest.approx(ratio**2, rel=0.6, abs=0.1)


def test_an_error_that_stays_is_no_noise():
    white = 0.2 * STATED * np.random.default_rng(4).standard_normal(SECONDS * RATE)
    assert learnt(0.5 + white) == pytest.approx(learnt(white), abs=1e-6)


def test_errors_that_last_a_second_count_as_more_noise():
    rng = np.random.default_rng(5)
    each_second = np.repeat(0.5 * STATED * rng.standard_normal(SECONDS), RATE)
    assert learnt(each_second) > 4.0 * learnt(0.5 * STATED * rng.standard_normal(SECONDS * RATE))


def test_a_pause_begins_anew():
    x, magnetic_field = State(), load().magnetic_field
    magnetic_field.forget_noise(x)
    for n in range(40):
        o = Observation()
        load().observation.clear(o, 1, STATED**2)
        o.H[0][E_ATT + 2] = 1.0
        # the azimuths before and after the pause have nothing to do with each other
        o.z[0] = 0.0 if n < 20 else 1.0
        x.t = n * 1e8 + (0.0 if n < 20 else 5e9)
        magnetic_field.innovate_azimuth(x, o)
    assert x.field_noise.share <= 1.0
