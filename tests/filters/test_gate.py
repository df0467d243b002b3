import numpy as np
import pytest

from ekf_companion.core.from_settings import chi_square_quantile
from ekf_companion.core.settings import GateSettings
from ekf_companion.filters.gate import Gate, Trust

S = np.diag([4.0, 4.0, 9.0])
SECOND = 1_000_000_000
WILD = np.array([100.0, 0.0, 0.0])


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_the_gate_stands_at_the_quantile_of_its_probability(dof):
    gate = Gate(GateSettings(probability=0.99))
    edge = np.sqrt(chi_square_quantile(0.99, dof))
    z = np.zeros(dof)
    for share, trust in ((0.999, Trust.FUSED), (1.001, Trust.REFUSED)):
        z[0] = share * edge
        assert gate.admits("position", 0, z, np.eye(dof)) is trust
    assert gate.counts == {"position": (1, 1)}


def test_after_the_time_out_one_resets_and_the_clock_begins_anew():
    gate = Gate(GateSettings(timeout_position=7.0))
    verdicts = [gate.admits("position", t * SECOND, WILD, S) for t in range(11)]
    assert verdicts == [Trust.REFUSED] * 8 + [Trust.RESET] + [Trust.REFUSED] * 2
    assert gate.admits("position", 11 * SECOND, np.zeros(3), S) is Trust.FUSED
    assert gate.admits("position", 12 * SECOND, WILD, S) is Trust.REFUSED
    assert gate.counts == {"position": (2, 11)}
    assert gate.resets == {"position": 1}


def test_the_clock_counts_from_the_last_that_was_accepted():
    gate = Gate(GateSettings(timeout_position=7.0))
    assert gate.admits("position", 0, np.zeros(3), S) is Trust.FUSED
    # After an outage the first fix is the one that resets
    assert gate.admits("position", 8 * SECOND, WILD, S) is Trust.RESET


def test_each_aid_has_an_account_and_a_patience_of_its_own():
    gate = Gate(GateSettings(timeout_position=7.0, timeout_velocity=1.0))
    for t in range(3):
        gate.admits("position", t * SECOND, WILD, S)
        gate.admits("velocity", t * SECOND, WILD, S)
    assert gate.counts == {"position": (0, 3), "velocity": (1, 2)}
