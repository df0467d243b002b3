"""Airspeed, wheels and how the vehicle moves, from every format that has them."""

import numpy as np
import pytest

from ekf_companion.logs import csv, dataflash, ulog
from ekf_companion.nav.measurements import Kind, VehicleType
from tests.logs.test_dataflash import Writer as DataFlashWriter
from tests.logs.test_dataflash import of_kind
from tests.logs.test_ulog import COMBINED
from tests.logs.test_ulog import Writer as ULogWriter

IMU = (0.0, 0.0, 0.0, 0.1, 0.0, -9.8)


def dataflash_log(path, *definitions, rows=100):
    """Write a log of samples and of other messages: name, format, columns, values by the row."""
    log = DataFlashWriter()
    log.define(1, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    for number, (name, characters, columns, _) in enumerate(definitions, 2):
        log.define(number, name, characters, columns)
    for n in range(rows):
        us = 1_000_000 + 10_000 * n
        log.row("IMU", us, 0, *IMU[:3], 0.1 * (n % 2), *IMU[4:])
        for name, _, _, values in definitions:
            if (row := values(n)) is not None:
                log.row(name, us, *row)
    path.write_bytes(log.data)
    return path


ARSP = "TimeUS,I,Airspeed,DiffPress,Temp,RawPress,Offset,U,H,Hp,Pri"
ARSP_FORMAT = "QBffcffBBfB"


def arsp(instance, speed, used=1, healthy=1):
    return instance, speed, 250.0, 2500, 250.0, 1.0, used, healthy, 0.99, 0


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (lambda n: arsp(0, 20.0 + n), 20.0 + np.arange(100)),
        (lambda n: arsp(n % 2, 20.0, used=n % 2), np.full(50, 20.0)),
        (lambda n: arsp(n % 2, 20.0 + n % 2), np.full(50, 20.0)),
        (lambda n: arsp(0, 20.0, healthy=int(n > 50)), np.full(49, 20.0)),
        (lambda n: arsp(0, np.nan), []),
    ],
    ids=["one", "the second is used", "two", "at times unhealthy", "no numbers"],
)
def test_of_arsp_the_sensor_that_is_used_and_healthy_counts(values, expected, tmp_path):
    path = dataflash_log(tmp_path / "air.bin", ("ARSP", ARSP_FORMAT, ARSP, values))
    found = of_kind(dataflash.read(path), Kind.AIRSPEED).values
    assert found[:, 0] == pytest.approx(expected)
    assert (found[:, 2] == 1.0).all()  # indicated


def test_an_old_arsp_without_use_and_health_counts(tmp_path):
    old = ("ARSP", "Qffcff", "TimeUS,Airspeed,DiffPress,Temp,RawPress,Offset")
    path = dataflash_log(tmp_path / "air.bin", (*old, lambda n: (20.0, 1.0, 2500, 1.0, 1.0)))
    assert len(of_kind(dataflash.read(path), Kind.AIRSPEED)) == 100


WENC = ("WENC", "Qfbfb", "TimeUS,Dist0,Qual0,Dist1,Qual1")


@pytest.mark.parametrize("both", [True, False], ids=["two wheels", "one wheel"])
def test_the_distances_of_wenc_become_speeds_at_their_own_times(both, tmp_path):
    def values(n):
        way = 0.05 * 0.01 * n * n
        return way, 100, way if both else 0.0, 100

    found = of_kind(
        dataflash.read(dataflash_log(tmp_path / "wheels.bin", (*WENC, values))), Kind.WHEEL
    )
    t = (found.t_ns - 1_000_000_000) * 1e-9
    assert found.values[:, 0] == pytest.approx(10.0 * t, abs=0.01)  # float32 of a way of 5 m
    assert len(found) == 98


FIRMWARES = [
    (b"ArduPlane V4.6.0", 0.0, VehicleType.FIXED_WING),
    (b"ArduPlane V4.6.0", 1.0, VehicleType.OTHER),
    (b"ArduCopter V4.6.0", 0.0, VehicleType.ROTARY),
    (b"ArduRover V4.6.0", 0.0, VehicleType.GROUND),
    (b"ArduSub V4.6.0", 0.0, VehicleType.UNKNOWN),
]


@pytest.mark.parametrize(("firmware", "q_enable", "expected"), FIRMWARES)
def test_a_dataflash_log_names_how_its_vehicle_moves(firmware, q_enable, expected, tmp_path):
    path = dataflash_log(
        tmp_path / "who.bin",
        ("MSG", "QZ", "TimeUS,Message", lambda n: (firmware,) if n == 0 else None),
        ("PARM", "QNf", "TimeUS,Name,Value", lambda n: (b"Q_ENABLE", q_enable) if not n else None),
        ("ARM", "QB", "TimeUS,ArmState", lambda n: (1,) if n == 20 else None),
    )
    (state,) = of_kind(dataflash.read(path), Kind.VEHICLE).values
    assert state[4] == float(expected)


def ulog_log(path, *topics, rows=50):
    """Write a log of samples and of other topics: name, fields, values by the row."""
    log = ULogWriter([COMBINED, *((name, fields) for name, fields, _ in topics)])
    for n in range(rows):
        us = 1_000_000 + 10_000 * n
        log.row(0, us, *IMU[:3], 0.1 * (n % 2), *IMU[4:])
        for index, (_, _, values) in enumerate(topics, 1):
            log.row(index, us, *values(n))
    path.write_bytes(log.data)
    return path


STAMP = ("uint64_t", "timestamp")
TRUE = ("float", "true_airspeed_m_s")
SENSOR = ("airspeed", [STAMP, TRUE], lambda n: (18.0,))


@pytest.mark.parametrize(
    ("field", "number", "expected"),
    [
        (("int8_t", "airspeed_source"), 1, 20.0),
        (("int8_t", "airspeed_source"), 0, 18.0),
        (("int8_t", "airspeed_source"), 4, 18.0),
        (("int8_t", "selected_airspeed_index"), 1, 20.0),
        (("int8_t", "selected_airspeed_index"), -1, 18.0),
    ],
)
def test_an_airspeed_that_px4_made_up_is_none(field, number, expected, tmp_path):
    """Ground speed less wind, or one made of throttle: then the sensor's own counts."""
    validated = ("airspeed_validated", [STAMP, TRUE, field], lambda n: (20.0, number))
    found = of_kind(ulog.read(ulog_log(tmp_path / "air.ulg", validated, SENSOR)), Kind.AIRSPEED)
    assert found.values[:, 0] == pytest.approx(np.full(50, expected))
    assert (found.values[:, 2] == 0.0).all()  # true


@pytest.mark.parametrize(("number", "expected"), [*enumerate((0, 2, 1, 3, 4, 4))])
def test_a_ulog_names_how_its_vehicle_moves(number, expected, tmp_path):
    fields = [STAMP, ("uint8_t", "arming_state"), ("uint8_t", "vehicle_type")]
    path = ulog_log(tmp_path / "who.ulg", ("vehicle_status", fields, lambda n: (2, number)))
    (state,) = of_kind(ulog.read(path), Kind.VEHICLE).values
    assert state[4] == expected


@pytest.mark.parametrize(
    ("column", "kind", "scale"),
    [
        ("airspeed_mps", Kind.AIRSPEED, 1.0),
        ("airspeed_kn", Kind.AIRSPEED, 1852.0 / 3600.0),
        ("wheel_speed_kmph", Kind.WHEEL, 1.0 / 3.6),
    ],
)
def test_a_csv_names_its_column_with_its_unit(column, kind, scale, tmp_path):
    names = [f"{a}_{b}_{u}" for a, u in (("gyro", "rps"), ("accel", "mps2")) for b in "xyz"]
    lines = [",".join(["time_us", *names, column])]
    lines += [f"{1_000_000 + 10_000 * n},{','.join(map(str, IMU))},{20.0 + n}" for n in range(20)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    found = of_kind(csv.read(path), kind)
    assert found.values[:, 0] == pytest.approx(scale * (20.0 + np.arange(20)))
    assert np.isnan(found.values[:, 1]).all()
