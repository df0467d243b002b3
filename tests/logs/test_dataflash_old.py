"""Old ArduPilot logs: the barometer's height in CTUN, and rows that have no stamp."""

import numpy as np
import pytest

from ekf_companion.logs import dataflash
from ekf_companion.nav.measurements import Kind
from tests.logs.test_dataflash import Writer

IMU_NS = 20_000_000
OLD = ("hcef", "ThrIn,SonAlt,BarAlt,WPAlt")  # ArduCopter 3.1
TIMED = ("Ihhhffe", "TimeMS,ThrIn,AngBst,ThrOut,DAlt,Alt,BarAlt")  # 3.2
NEW = ("QffffffecB", "TimeUS,ThI,ABst,ThO,ThH,DAlt,Alt,BAlt,DSAlt,X")  # 3.6


def old_log(tuning=OLD, *, baro="", stamped=False, n=100):
    """Write a log: 50 Hz IMU with a stamp, 10 Hz of the rest; BarAlt climbs by 0.1 m a row."""
    log = Writer()
    log.define(1, "IMU", "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    time, name = ("I", "TimeMS,") if stamped else ("", "")
    log.define(2, "MAG", f"{time}hhh", f"{name}MagX,MagY,MagZ")
    log.define(3, "ATT", f"{time}ccC", f"{name}Roll,Pitch,Yaw")
    log.define(4, "CTUN", *tuning)
    log.define(5, "BARO", "If", "TimeMS,Alt")
    log.define(6, "BAR2", "If", "TimeMS,Alt")
    for index in range(n):
        ms = 5000 + 20 * index
        log.row("IMU", ms, 0, 0, 0, 0, 0, -9.8)
        if index % 5 == 0:
            own = (ms,) if stamped else ()
            log.row("MAG", *own, 200, index, 400)
            log.row("ATT", *own, 0, 0, 9000)
            climbed = 2 * index  # cm
            if tuning[0] == OLD[0]:
                log.row("CTUN", 500, 0, climbed, 0)
            elif tuning == TIMED:
                log.row("CTUN", ms, 0, 0, 0, 0, 0, climbed)
            else:
                log.row("CTUN", 1000 * ms, 0, 0, 0, 0, 0, 0, climbed, 0, 0)
            if baro:
                log.row(baro, ms, 77.0)
    return log.data


@pytest.fixture
def read(tmp_path):
    def write_and_read(data):
        path = tmp_path / "flight.bin"
        path.write_bytes(data)
        return dataflash.read(path)

    return write_and_read


def of_kind(recording, kind):
    return recording.events.take(recording.events.kind == kind)


@pytest.mark.parametrize(
    ("tuning", "column"),
    [(OLD, "BarAlt"), (TIMED, "BarAlt"), (NEW, "BAlt")],
    ids=["3.1", "3.2", "3.6"],
)
def test_without_baro_the_barometers_height_is_that_of_ctun(read, tuning, column):
    recording = read(old_log(tuning))
    heights = of_kind(recording, Kind.BARO)
    assert heights.values[:, 0] == pytest.approx(np.arange(20) * 0.1)
    # The row stands behind the sample of its time
    assert np.abs(heights.t_ns - (5_000_000_000 + 5 * IMU_NS * np.arange(20))).max() < IMU_NS
    assert f"BARO: the log holds none; the barometer's height is CTUN.{column}" in recording.notes


@pytest.mark.parametrize("baro", ["BARO", "BAR2"])
def test_with_a_barometer_that_of_ctun_is_not_used(read, baro):
    recording = read(old_log(baro=baro))
    assert (of_kind(recording, Kind.BARO).values[:, 0] == 77.0).all()
    assert not any("CTUN" in note for note in recording.notes)


def test_a_ctun_without_a_height_is_none(read):
    recording = read(old_log(("hcef", "ThrIn,SonAlt,DSAlt,WPAlt")))
    assert not len(of_kind(recording, Kind.BARO))


def test_rows_without_a_time_have_that_of_the_samples_around_them(read):
    recording, stamped = read(old_log()), read(old_log(TIMED, stamped=True))
    for kind in (Kind.MAG, Kind.HEADING):
        found, expected = of_kind(recording, kind), of_kind(stamped, kind)
        assert np.array_equal(found.values, expected.values, equal_nan=True)
        assert ((found.t_ns - expected.t_ns) >= 0).all()
        assert ((found.t_ns - expected.t_ns) < IMU_NS).all()
    assert any("the rows of ATT, MAG, BARO have no time" in note for note in recording.notes)
    assert not any("have no time" in note for note in stamped.notes)


def test_rows_before_and_behind_all_samples_have_the_time_of_the_nearest(read):
    early, late = Writer(), old_log()
    early.define(2, "MAG", "hhh", "MagX,MagY,MagZ")
    early.row("MAG", 1, 2, 3)
    fields = of_kind(read(early.data + late), Kind.MAG)
    assert fields.t_ns[0] == 5_000_000_000
