"""An observation begins empty, whatever was in it, and timing errors add to its noise."""

import numpy as np
import pytest

from ekf_companion.core.memory.scratch import Observation
from tests.core.interpreted import load
from tests.core.states import array


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_it_begins_empty(rows):
    o = Observation(rows=3, shows_delay=1)
    array(o.H)[:], array(o.R)[:] = 7.0, 7.0
    load().observation.clear(o, rows, 0.25)
    assert (o.rows, o.shows_delay) == (rows, 0)
    assert not array(o.H)[:rows].any()
    np.testing.assert_array_equal(array(o.R)[:rows, :rows], 0.25 * np.eye(rows))


def test_a_timing_error_makes_the_rows_uncertain_together():
    o, rate = Observation(), [3.0, -4.0]
    load().observation.clear(o, 2, 1.0)
    load().observation.add_timing_noise(o, 0.1**2, rate)
    expected = np.eye(2) + 0.01 * np.outer(rate, rate)
    np.testing.assert_allclose(array(o.R)[:2, :2], expected)
