import re

from ekf_companion.core import state as layout
from ekf_companion.nav.measurements import WIDTH
from ekf_companion.nav.state import COLUMNS
from tests.core.interpreted import FOLDER


def numbers() -> dict[str, int]:
    return {name: value for name, value in vars(layout).items() if name.isupper()}


def test_the_compiler_is_told_the_same_numbers():
    text = (FOLDER / "state.pxd").read_text()
    told = {name: int(value) for name, value in re.findall(r"^    (\w+) = (\d+)$", text, re.M)}
    assert told == numbers()


def test_a_row_holds_a_measurement_and_an_estimate_its_columns():
    assert layout.ROW == layout.ROW_V + WIDTH
    assert len(COLUMNS) - 1 == layout.OUT
    assert COLUMNS[1 + layout.OUT_STATUS] == "status"
    assert COLUMNS[1 + layout.OUT_SD] == "sd_pos_n"


def test_nothing_in_a_block_overlaps():
    sizes = {
        "X_Q": 4, "X_VEL": 3, "X_POS": 3, "X_BG": 3, "X_BA": 3, "X_GYRO": 3, "X_ACCEL": 3,
        "X_ACC_N": 3, "X_T_HEADING": 3, "X_T_USED": layout.AIDS, "X_RATIO": layout.AIDS,
        "X_COUNT": layout.AIDS * layout.WHYS, "X_NOISE_G": 3, "X_NOISE_A": 3, "X_BLOCK_SUM": 6,
        "X_BLOCK1": 6, "X_BLOCK2": 6, "X_WHITE": 3, "X_T_REFUSED": layout.AIDS,
        "X_LEVEL": layout.L_SIZE, "X_COV": layout.N * layout.N, "X_SLOW": 3, "X_IRON": 3,
        "X_DELTA": 7,
        "X_NIS_SUM": layout.AIDS, "X_NIS_N": layout.AIDS, "X_RUN": 3 * layout.C_SIZE, "X_LEAN": 3,
        "X_FRESH": layout.N, "X_LAST_FIX": 3, "X_BANK": layout.B_SIZE,
    }  # fmt: skip
    places = sorted((value, name) for name, value in numbers().items() if name.startswith("X_"))
    ends = [value + sizes.get(name, 1) for value, name in places]
    assert all(end <= start for end, (start, _) in zip(ends, places[1:], strict=False))
    assert ends[-1] == layout.BLOCK


def test_nothing_in_the_scratch_overlaps():
    n = layout.N
    sizes = {
        "W_H": 3 * n, "W_C": 3 * n, "W_Z": 3, "W_R": 9, "W_L": 9, "W_Y": 3, "W_DX": n, "W_C_NB": 9,
        "W_DV": 3, "W_ROW": n, "W_ROW2": n, "W_S9": 18, "W_Q": 6,
        "W_MEAN": 6, "W_RATE": 3, "W_FORCE": 3, "W_RATE_SLOPE": 3, "W_FORCE_SLOPE": 3, "W_FIX": 12,
    }  # fmt: skip
    places = sorted((value, name) for name, value in numbers().items() if name.startswith("W_"))
    ends = [value + sizes[name] for value, name in places]
    assert ends == [start for start, _ in places[1:]] + [layout.SCRATCH]


def test_a_tape_begins_behind_the_scratch_and_a_record_holds_a_block_and_a_transition():
    assert [layout.TAPE_COUNT, layout.TAPE] == [layout.SCRATCH, layout.SCRATCH + 1]
    assert [layout.T_LINK, layout.T_IS_SAMPLE, layout.T_BLOCK] == [0, 1, 2]
    assert layout.T_PHI == layout.T_BLOCK + layout.BLOCK
    assert layout.T_PHI + layout.N**2 == layout.RECORD
