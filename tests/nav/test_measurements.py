import numpy as np

from ekf_companion.nav.measurements import (
    WIDTH,
    AirspeedSample,
    AnchorSample,
    BaroSample,
    Events,
    FlowSample,
    GnssFix,
    GnssFlag,
    HeadingSample,
    HeadingSource,
    ImuSample,
    Kind,
    MagSample,
    PoseSample,
    RangeSample,
    Restart,
    VehicleState,
    VelocitySample,
    WheelSample,
    merge,
)

SAMPLES = [
    Restart(),
    ImuSample(t_ns=5, gyro_x=1, gyro_y=2, gyro_z=3, accel_x=4, accel_y=5, accel_z=6),
    GnssFix(t_ns=4, lat=0.1, lon=0.2, alt=3.0, std_h=1.0, std_v=2.0, flags=GnssFlag.SUSPECT),
    HeadingSample(t_ns=3, heading=1.0, std=0.1, source=HeadingSource.AUTOPILOT),
    MagSample(t_ns=2, mag_x=0.1, mag_y=0.2, mag_z=0.3),
    BaroSample(t_ns=1, alt=100.0),
    RangeSample(t_ns=7, range=2.5),
    AirspeedSample(t_ns=8, airspeed=21.0, is_indicated=True),
    WheelSample(t_ns=9, speed=-1.5, std=0.2),
    PoseSample(t_ns=7, x=1.0, y=2.0, z=3.0, yaw=0.5, counter=2),
    VelocitySample(t_ns=7, x=1.0, y=2.0, z=3.0, is_level=True),
    VehicleState(t_ns=6, is_armed=True),
    FlowSample(t_ns=8, flow_x=0.1, flow_y=-0.2),
    AnchorSample(t_ns=9, range=4.0, anchor=3),
]


def test_every_row_has_the_same_width_and_a_kind_of_its_own():
    rows = [sample.row() for sample in SAMPLES]
    assert {len(values) for _, _, values in rows} == {WIDTH}
    assert sorted(kind for _, kind, _ in rows) == sorted(Kind)


def test_what_is_not_known_is_nan_in_a_row():
    _, _, values = SAMPLES[2].row()
    assert np.isnan(values[3:6]).all()
    assert np.isnan(values[8])
    assert values[10] == GnssFlag.SUSPECT
    assert np.isnan(SAMPLES[6].row()[2][1])


def test_tables_merge_by_stamp_or_by_arrival_and_keep_ties_in_order():
    baro = Events.from_columns(np.array([10, 30]), Kind.BARO, [1.0, 2.0])
    mag = Events.from_columns(np.array([10, 20]), Kind.MAG, [3.0, 4.0], [0.0, 0.0], [0.0, 0.0])
    assert merge(baro, mag).values[:, 0].tolist() == [1.0, 3.0, 4.0, 2.0]
    late = merge(baro, mag, arrival_ns=[np.array([50, 60]), np.array([40, 70])])
    assert late.values[:, 0].tolist() == [3.0, 1.0, 2.0, 4.0]


def test_objects_and_columns_lay_the_same_rows():
    rows = Events.from_rows([SAMPLES[5].row(), SAMPLES[5].row()])
    columns = Events.from_columns(np.array([1, 1]), Kind.BARO, [100.0, 100.0])
    assert rows.values.tolist() == columns.values.tolist()
    assert len(rows) == 2
