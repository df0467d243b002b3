import numpy as np
import pytest

from ekf_companion.core.settings.from_settings import chi_square_quantile
from ekf_companion.core.settings.settings import GateSettings
from ekf_companion.filters.gate import Decision, Gate

S = np.diag([4.0, 4.0, 9.0])
SECOND = 1_000_000_000
WILD = np.array([100.0, 0.0, 0.0])


@pytest.mark.parametrize("dof", [1, 2, 3])
def test_the_gate_stands_at_the_quantile_of_its_probability(dof):
    gate = Gate(GateSettings(probability=0.99))
    edge = np.sqrt(chi_square_quantile(0.99, dof))
    z = np.zeros(dof)
    for share, decision in ((0.999, Decision.FUSED), (1.001, Decision.REFUSED)):
        z[0] = share * edge
        assert gate.test("position", 0, z, np.eye(dof)) is decision
    assert gate.counts == {"position": (1, 1)}


def test_after_the_time_out_one_resets_and_the_clock_begins_anew():
    gate = Gate(GateSettings(timeout_position=7.0))
    decisions = [gate.test("position", t * SECOND, WILD, S) for t in range(11)]
    assert decisions == [Decision.REFUSED] * 8 + [Decision.RESET] + [Decision.REFUSED] * 2
    assert gate.test("position", 11 * SECOND, np.zeros(3), S) is Decision.FUSED
    assert gate.test("position", 12 * SECOND, WILD, S) is Decision.REFUSED
    assert gate.counts == {"position": (2, 11)}
    assert gate.resets == {"position": 1}


def test_the_clock_counts_from_the_last_that_was_accepted():
    gate = Gate(GateSettings(timeout_position=7.0))
    assert gate.test("position", 0, np.zeros(3), S) is Decision.FUSED
    # After an outage the first fix is the one that resets
    assert gate.test("position", 8 * SECOND, WILD, S) is Decision.RESET


def test_each_aid_has_an_account_and_a_patience_of_its_own():
    gate = Gate(GateSettings(timeout_position=7.0, timeout_velocity=1.0))
    for t in range(3):
        gate.test("position", t * SECOND, WILD, S)
        gate.test("velocity", t * SECOND, WILD, S)
    assert gate.counts == {"position": (0, 3), "velocity": (1, 2)}
