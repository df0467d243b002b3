"""Parameters of a DataFlash log: one answer, whether its rows are in memory or stored."""

import numpy as np
import pytest

from ekf_companion.logs import dataflash
from ekf_companion.logs.dataflash_columns import parameter, parameters
from ekf_companion.logs.stored_rows import StoredRows
from tests.logs.test_dataflash import Writer

ROWS = [
    (b"AHRS_TRIM_X", 0.1),
    (b"EK3_IMU_MASK", 7.0),
    (b"AHRS_TRIM_X", 0.2),
    (b"BAD", np.nan),
    (b"BAD", 1.0),
    (b"ENDLESS", np.inf),
]


def tables(rows, name="S16", value="<f4"):
    table = np.array(rows, dtype=[("Name", name), ("Value", value)])
    stored = StoredRows(table.dtype)
    stored.append(table)
    return {"PARM": table}, {"PARM": stored}


@pytest.mark.parametrize("found", tables(ROWS), ids=["in memory", "stored"])
def test_the_first_value_of_a_parameter_is_what_was_flown_with(found):
    assert parameter(found, "AHRS_TRIM_X") == pytest.approx(0.1)
    assert parameter(found, "EK3_IMU_MASK") == 7.0
    assert parameter(found, "BAD") is None
    assert parameter(found, "ENDLESS") is None
    assert parameter(found, "NONE") is None
    assert {*parameters(found)} == {"AHRS_TRIM_X", "EK3_IMU_MASK", "BAD", "ENDLESS"}


@pytest.mark.parametrize("found", tables([(1, 2.0)], name="<i4"), ids=["in memory", "stored"])
def test_names_that_damage_made_numbers_name_no_parameter(found):
    assert parameters(found) == parameters({}) == {}
    assert parameters({"PARM": np.zeros(1, [("Value", "<f4")])}) == {}


def test_a_parameter_that_is_changed_later_is_the_same_for_all_readers(tmp_path):
    log = Writer()
    log.define(1, "IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define(7, "PARM", "QNf", "TimeUS,Name,Value")
    for name, value in ((b"GPS_DELAY_MS", 120.0), (b"AHRS_TRIM_X", 0.1)):
        log.row("PARM", 0, name, value)
    for index in range(50):
        log.row("IMU", 10_000 * index, 0, 0, 0, 0, 0, -9.8)
    for name in (b"GPS_DELAY_MS", b"AHRS_TRIM_X"):
        log.row("PARM", 500_000, name, 0.0)
    path = tmp_path / "flight.bin"
    path.write_bytes(log.data)
    recording = dataflash.read(path)
    assert recording.gnss_delay == pytest.approx(0.12)
    assert recording.onboard.parameters["GPS_DELAY_MS"] == 120.0
    assert any("AHRS_TRIM" in note for note in recording.notes)
