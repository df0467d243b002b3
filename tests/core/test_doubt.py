"""How far the inertial samples are doubted, by how the receiver's innovations follow each other."""

import numpy as np
import pytest

from ekf_companion.core.memory.enums import AID_VELOCITY
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Fix, Observation
from ekf_companion.core.memory.state import State
from tests.core.interpreted import load

FIXES = 1000
"""Five a second."""
FIRST = 0.001
"""Doubt to begin with: that of a filter which has converged."""
MANOEUVRE = 2.0
"""Mean square of the change of acceleration, (m/s^2)^2."""


def doubts(innovations: np.ndarray, change: float) -> np.ndarray:
    """Return the doubt after each of whitened innovations, shape (n, 3)."""
    x, k, fix, o, doubt = State(), Parameters(), Fix(), Observation(), load().doubt
    doubt.restart(x)
    x.doubt, x.gain.change = FIRST, change
    k.gate[:] = [24.0, 28.0, 31.0]
    fix.stated_var[AID_VELOCITY], o.rows = 4.0, 3  # it states twice its noise
    found = []
    for n, y in enumerate(innovations):
        x.t = n * 2e8
        o.y[:], o.z[:] = y, y
        doubt.learn_doubt(x, k, fix, o, float(y @ y), False)
        found.append(x.doubt)
    return np.array(found)


@pytest.mark.parametrize("seed", range(5))
def test_white_innovations_leave_no_doubt(seed):
    white = 0.8 * np.random.default_rng(seed).standard_normal((FIXES, 3))
    assert np.median(doubts(white, MANOEUVRE)[100:]) < 0.0001


@pytest.mark.parametrize("seed", range(5))
def test_innovations_that_stay_to_one_side_raise_it_within_seconds(seed):
    rng = np.random.default_rng(seed)
    follow = np.zeros((FIXES, 3))
    for n in range(1, FIXES):
        follow[n] = 0.9 * follow[n - 1] + np.sqrt(1 - 0.9**2) * rng.standard_normal(3)
    white = 0.8 * rng.standard_normal((200, 3))
    found = doubts(np.concatenate([white, follow]), MANOEUVRE)
    assert found[200:300].max() > 0.1


def test_the_samples_of_a_vehicle_that_does_not_manoeuvre_are_not_proven():
    white = 0.3 * np.random.default_rng(1).standard_normal((FIXES, 3))
    assert doubts(white, 0.0)[-1] > 5.0 * doubts(white, MANOEUVRE)[-1]
