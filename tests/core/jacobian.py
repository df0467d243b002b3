"""The Jacobian of an observation against central differences through plus."""

from collections.abc import Callable

import numpy as np

from ekf_companion.core.memory.enums import E_BA, E_BG, E_VEL, N
from ekf_companion.core.memory.parameters import Parameters
from ekf_companion.core.memory.scratch import Observation
from ekf_companion.core.memory.state import State
from tests.core.states import plus, some_parameters

STEP = 1e-6
Observe = Callable[[State, Parameters, Observation], object]


def check(observe: Observe, x: State, tolerance: float) -> None:
    """Compare H with the slope of the innovation; the attitude's part within a tolerance."""
    k, o = some_parameters(), Observation()
    observe(x, k, o)
    rows = o.rows
    H = np.array(o.H)[:rows]

    slope = np.zeros((rows, N))
    for i in range(N):
        z = []
        for sign in (1.0, -1.0):
            observe(plus(x, sign * STEP * np.eye(N)[i]), k, o)
            z.append(np.array(o.z)[:rows])
        slope[:, i] = -(z[0] - z[1]) / (2.0 * STEP)  # innovation is measured minus predicted

    np.testing.assert_allclose(H[:, :E_VEL], slope[:, :E_VEL], atol=tolerance)
    rest = [i for i in range(E_VEL, N) if not (tolerance > 1e-3 and E_BG <= i < E_BA)]
    np.testing.assert_allclose(H[:, rest], slope[:, rest], rtol=1e-5, atol=1e-4)  # metres at 1e6
