import ctypes

import numpy as np
import pytest

from ekf_companion.core.memory import enums, parameters, scratch, state
from ekf_companion.core.memory.declare import pxd
from ekf_companion.core.memory.overlay import as_estimate
from ekf_companion.core.memory.state import BLOCK, State
from ekf_companion.core.order import timeline
from ekf_companion.nav.measurements import WIDTH
from ekf_companion.nav.state import COLUMNS
from tests.core.interpreted import FOLDER


@pytest.mark.parametrize("module", [enums, state, parameters, scratch])
def test_the_compiler_was_given_what_is_declared(module):
    name = module.__name__.rpartition(".")[2]
    assert (FOLDER / "memory" / f"{name}.pxd").read_text(encoding="utf-8") == pxd(module)
    assert timeline.COMPILED_BLOCK == BLOCK


def test_an_enumeration_has_one_number_each_from_zero_and_no_other():
    for prefix, kind in enums.ENUMS.items():
        first = 1 if prefix == "AZIMUTH" else 0
        numbers = list(range(first, first + len(kind)))
        if prefix == "REASON":  # a set of them is one number
            numbers = [1 << number for number in numbers]
        assert [int(member) for member in kind] == numbers
        with pytest.raises(AttributeError):
            getattr(enums, f"{prefix}_NOTHING_SUCH")
    assert enums.MODE_LEVEL == 1
    assert (len(enums.Aid), len(enums.Verdict)) == (enums.AIDS, enums.VERDICTS)


def test_all_of_a_state_is_doubles_without_a_gap():
    dtype = np.dtype(State)

    def doubles(one: np.dtype) -> int:
        if one.subdtype is not None:
            inner, shape = one.subdtype
            return doubles(inner) * int(np.prod(shape))
        if one.fields is None:
            assert one == np.float64
            return 1
        return sum(doubles(inner) for inner, _ in one.fields.values())

    assert doubles(dtype) == BLOCK
    assert ctypes.sizeof(State) == 8 * BLOCK
    ends = [(State.P.offset + State.P.size) // 8, BLOCK]
    assert ends[0] == ends[1]


def test_a_row_holds_a_measurement_and_an_estimate_its_columns():
    assert scratch.ROW == 2 + WIDTH
    assert len(COLUMNS) - 1 == scratch.OUT
    numbers = np.arange(scratch.OUT, dtype=float)
    estimate = as_estimate(numbers)
    assert COLUMNS[1 + int(estimate.status)] == "status"
    assert COLUMNS[1 + int(estimate.std_pos[0])] == "sd_pos_n"
    assert COLUMNS[1 + int(estimate.std_euler[2])] == "sd_yaw"
