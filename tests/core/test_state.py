import ctypes

import numpy as np
import pytest

from ekf_companion.core.memory import constants, enums, parameters, scratch, state
from ekf_companion.core.memory.declare import pxd
from ekf_companion.core.memory.overlay import as_estimate, clear_estimated, errors
from ekf_companion.core.memory.state import BLOCK, ESTIMATED, State
from ekf_companion.core.order import timeline
from ekf_companion.nav.measurements import WIDTH
from ekf_companion.nav.state import COLUMNS
from tests.core.interpreted import FOLDER


@pytest.mark.parametrize("module", [constants, enums, state, parameters, scratch])
def test_the_compiler_was_given_what_is_declared(module):
    name = module.__name__.rpartition(".")[2]
    assert (FOLDER / "memory" / f"{name}.pxd").read_text(encoding="utf-8") == pxd(module)
    assert timeline.COMPILED_BLOCK == BLOCK


def test_an_enumeration_has_one_number_each_from_zero_and_no_other():
    for prefix, kind in enums.ENUMS.items():
        first = 1 if prefix == "AZIMUTH" else 0
        numbers = list(range(first, first + len(kind)))
        if prefix in ("FLAG", "REASON"):  # a set of them is one number
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


def test_errors_lie_in_the_state_as_in_the_covariance():
    names = ("vel_n", "pos_n", "gyro_bias", "accel_bias", "baro_offset", "gnss_delay")
    names += ("heading_offset", "gnss_offset", "hard_iron", "gnss_vel_offset")
    places = (enums.E_VEL, enums.E_POS, enums.E_BG, enums.E_BA, enums.E_BARO, enums.E_DELAY)
    places += (enums.E_HEADING, enums.E_GNSS, enums.E_IRON, enums.E_GNSS_VEL)
    x = State()
    for name, place in zip(names, places, strict=True):
        errors(x)[place - enums.E_VEL] = place
        field = getattr(x, name)
        assert (field if isinstance(field, float) else field[0]) == place
    assert len(errors(x)) == enums.N - enums.E_VEL


def test_what_is_estimated_is_cleared_and_nothing_else():
    x = State.from_buffer(np.ones(BLOCK))
    clear_estimated(x)
    cleared = np.frombuffer(x, np.float64) == 0.0
    assert cleared[:ESTIMATED].all()
    assert not cleared[ESTIMATED:].any()
    assert (x.P[2][2], x.has_yaw, x.t, x.count[1][1]) == (0.0, 0.0, 1.0, 1.0)


def test_a_row_holds_a_measurement_and_an_estimate_its_columns():
    assert scratch.ROW == 2 + WIDTH
    assert len(COLUMNS) - 1 == scratch.OUT
    numbers = np.arange(scratch.OUT, dtype=float)
    estimate = as_estimate(numbers)
    assert COLUMNS[1 + int(estimate.status)] == "status"
    assert COLUMNS[1 + int(estimate.std_pos[0])] == "sd_pos_n"
    assert COLUMNS[1 + int(estimate.std_euler[2])] == "sd_yaw"
